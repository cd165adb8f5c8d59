"""``ffpose bench filter``: the spectral filter against torch.fft.

torch.fft transforms channels-last data as ours, and data with the channels first, along contiguous
axes; the faster of the two is its *best layout*. A ratio above 1 means that ffpose is faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from statistics import geometric_mean
from timeit import Timer
from typing import Any, Literal

import torch
from torch import Tensor

from ffpose._internal.figures import draw_bars
from ffpose._internal.files import expect_place
from ffpose._internal.machine import cores
from ffpose.bench.output import print_results
from ffpose.bench.timing import take_turns
from ffpose.inference.in_torch import torch_threads
from ffpose.ops import spectral_filter

Kind = Literal["grid", "tokens", "sequence"]
Filter = Callable[[Tensor, Tensor], Tensor]

OURS, LAST, FIRST = "ffpose", "torch.fft", "torch.fft, channels first"
WORKS = ("forward", "forward+backward")
BATCHES = (1, 8)
SIZES: dict[Kind, tuple[tuple[int, ...], ...]] = {
    "grid": ((14, 14, 256), (7, 7, 512), (28, 28, 256), (56, 56, 64), (31, 31, 64)),
    "tokens": ((196, 256), (784, 128), (197, 256)),
    "sequence": ((50, 64), (512, 128)),
}
"""Sizes of each kind, ``(H, W, C)``, ``(X, Y)`` and ``(L, C)``; ``--quick`` takes the first."""

DIMS: dict[Kind, tuple[int, ...]] = {"grid": (-3, -2), "tokens": (-2, -1), "sequence": (-2,)}
"""Transformed dimensions of each kind."""


def run(as_json: bool, plot: Path | None, quick: bool) -> None:
    """Time the filter, and print a table, or all timings as JSON, on standard output."""
    expect_place(plot)
    seconds, counts, most = (0.1, [1], 1) if quick else (0.25, sorted({1, cores()}), None)
    sizes = [(kind, size) for kind, several in SIZES.items() for size in several[:most]]
    results: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    for threads, (kind, size), batch, work in product(counts, sizes, BATCHES, WORKS):
        with torch_threads(threads):
            latencies = take_turns(_contenders(kind, size, batch, work), seconds)
        about = {"batch": batch, "threads": threads, "work": work}
        results.append({"kind": kind, "size": size, **about, "latencies": latencies})
        ours, *others = (latency.p50 for latency in latencies.values())
        name = {"size": f"{kind} {'×'.join(map(str, size))}"}
        times = {"ffpose µs": 1e6 * ours, "torch.fft µs": 1e6 * others[0]}
        ratios = {"ratio": others[0] / ours, "best layout": min(others) / ours}
        rows.append(name | about | times | ratios)
    means = {
        work: [geometric_mean(r[key] for r in rows if r["work"] == work) for key in ratios]
        for work in WORKS
    }
    print_results("ffpose bench filter: float32", rows, as_json, ratio=means, results=results)
    for work, (last, best) in {} if as_json else means.items():
        print(f"{work}: {last:.2f} times as fast as torch.fft, {best:.2f} in its best layout")
    if plot is not None:
        draw_bars(plot, "times as fast as torch.fft in its best layout", rows, 4, "best layout")


def _contenders(kind: Kind, size: tuple[int, ...], batch: int, work: str) -> dict[str, Timer]:
    x, dim = torch.randn(batch, *size), DIMS[kind]
    weight = torch.randn(*torch.fft.rfftn(x[0], dim=dim).shape, 2)
    found = {
        OURS: _timer(partial(our_filter, kind=kind), x, weight, work),
        LAST: _timer(partial(torch_filter, dim=dim), x, weight, work),
    }
    if kind != "tokens":
        filter = partial(torch_filter, dim=[place + 1 for place in dim])
        found[FIRST] = _timer(filter, x.movedim(-1, 1), weight.movedim(-2, 0), work)
    return found


def _timer(filter: Filter, x: Tensor, weight: Tensor, work: str) -> Timer:
    x, weight = (each.clone(memory_format=torch.contiguous_format) for each in (x, weight))
    if work == "forward":
        return Timer(lambda: filter(x, weight))
    inputs, grad = (x.requires_grad_(), weight.requires_grad_()), torch.ones_like(x)
    return Timer(
        lambda: torch.autograd.grad(filter(*inputs), inputs, grad),
        # As an optimizer's step would: a weight prepared for the last call is out of date.
        setup=lambda: weight.data.neg_(),
    )


def our_filter(x: Tensor, weight: Tensor, kind: Kind) -> Tensor:
    """Filter by ours; a sequence is a grid with one row, as in `ffpose.nn.SequenceFilter`."""
    if kind != "sequence":
        return spectral_filter(x, weight, kind)
    return spectral_filter(x.unsqueeze(-3), weight.unsqueeze(0), "grid").squeeze(-3)


def torch_filter(x: Tensor, weight: Tensor, dim: Sequence[int]) -> Tensor:
    """Filter by torch.fft over these dimensions: ``irfftn(rfftn(x) * W)``."""
    # A network in the layout channels_last has its weights of four axes in that layout too.
    spectrum = torch.fft.rfftn(x, dim=dim) * torch.view_as_complex(weight.contiguous())
    y: Tensor = torch.fft.irfftn(spectrum, s=[x.shape[d] for d in dim], dim=dim)
    return y
