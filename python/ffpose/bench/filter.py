"""``ffpose bench filter``: the spectral filter against torch.fft.

torch.fft transforms channels-last data as ours, and data with the channels first, along contiguous
axes; the faster of the two is its *best layout*. All take turns in one process, so ratios are more
reliable than microseconds. A ratio above 1 means that ffpose is faster.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import geometric_mean
from typing import Literal

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from ffpose._internal.info import collect
from ffpose._internal.machine import cores, processor
from ffpose.bench.timing import (
    OURS,
    Latency,
    draw_bars,
    expect_place,
    percentiles,
    take_turns,
    timed,
)
from ffpose.inference.in_torch import torch_threads
from ffpose.ops import spectral_filter

Kind = Literal["grid", "tokens", "sequence"]
Work = Literal["forward", "forward+backward"]
Filter = Callable[[Tensor, Tensor], Tensor]

WORKS: tuple[Work, ...] = ("forward", "forward+backward")
LAST, FIRST = "torch.fft", "torch.fft, channels first"

DIMS: dict[Kind, tuple[int, ...]] = {"grid": (-3, -2), "tokens": (-2, -1), "sequence": (-2,)}
"""Transformed dimensions of each kind: ``(H, W, C)``, ``(X, Y)``, ``(L, C)``."""

DIMS_FIRST: dict[Kind, tuple[int, ...]] = {**DIMS, "grid": (-2, -1), "sequence": (-1,)}
"""The same where channels come first: ``(C, H, W)``, ``(X, Y)``, ``(C, L)``."""

FEW: tuple[tuple[Kind, tuple[int, ...]], ...] = (
    ("grid", (14, 14, 256)),
    ("tokens", (196, 256)),
    ("sequence", (50, 64)),
)
"""The sizes of ``--quick``, one of each kind."""

SIZES: tuple[tuple[Kind, tuple[int, ...]], ...] = (
    *FEW,
    ("grid", (7, 7, 512)),
    ("grid", (28, 28, 256)),
    ("grid", (56, 56, 64)),
    ("grid", (31, 31, 64)),
    ("tokens", (784, 128)),
    ("tokens", (197, 256)),
    ("sequence", (512, 128)),
)
BATCHES = (1, 8)


@dataclass(frozen=True)
class Result:
    """Timings of one size, by contender.

    Attributes:
        kind: ``"grid"``, ``"tokens"`` or ``"sequence"``.
        size: Of one image or sequence.
        batch: Number of images or sequences.
        work: What is timed; ``"forward+backward"`` gives both gradients.
        threads: Number of threads of torch.
        latencies: Of a call.
    """

    kind: Kind
    size: tuple[int, ...]
    batch: int
    work: Work
    threads: int
    latencies: dict[str, Latency]

    @property
    def label(self) -> str:
        """Kind and size in words."""
        return f"{self.kind} {'×'.join(map(str, self.size))}"

    def ratio(self, *rivals: str) -> float:
        """Return our speedup over the fastest of these contenders."""
        fastest = min(self.latencies[name].p50 for name in rivals if name in self.latencies)
        return fastest / self.latencies[OURS].p50


def run(as_json: bool = False, plot: Path | None = None, quick: bool = False) -> None:
    """Time the filter, and print a table, or all timings as JSON, on standard output.

    Args:
        as_json: Print one JSON document in place of the table.
        plot: PNG file to draw.
        quick: Three sizes, one thread, in seconds.

    Raises:
        FileNotFoundError: The folder of ``plot`` does not exist.
    """
    expect_place(plot)
    results = list(measure(quick))
    if as_json:
        means = {work: list(_means(results, work)) for work in WORKS}
        document = {"environment": {**collect(), "torch": torch.__version__}, "ratio": means}
        print(json.dumps({**document, "results": [asdict(each) for each in results]}, indent=2))
    else:
        Console().print(_table(results))
        for work in WORKS:
            ours, best = _means(results, work)
            print(f"{work}: {ours:.2f} times as fast as torch.fft, {best:.2f} in its best layout")
    if plot is not None:
        bars = {
            f"{each.label}, batch {each.batch}, {each.work}": each.ratio(LAST, FIRST)
            for each in results
            if each.threads == 1
        }
        draw_bars(plot, bars, "times as fast as torch.fft in its best layout, one thread")


def measure(quick: bool) -> Iterator[Result]:
    """Time all sizes in sequence."""
    seconds = 0.1 if quick else 0.25
    for threads in (1,) if quick else sorted({1, cores()}):
        with torch_threads(threads):
            for kind, size in FEW if quick else SIZES:
                for batch in BATCHES:
                    for work in WORKS:
                        samples = take_turns(_contenders(kind, size, batch, work), seconds)
                        found = {name: percentiles(times) for name, times in samples.items()}
                        yield Result(kind, size, batch, work, threads, found)


def _contenders(
    kind: Kind, size: tuple[int, ...], batch: int, work: Work
) -> dict[str, Callable[[], float]]:
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(batch, *size, generator=generator)
    spectrum = list(size)
    spectrum[DIMS[kind][-1]] = size[DIMS[kind][-1]] // 2 + 1
    weight = torch.randn(*spectrum, 2, generator=generator)
    found = {
        OURS: _contender(our_filter(kind), x, weight, work),
        LAST: _contender(torch_filter(DIMS[kind]), x, weight, work),
    }
    if kind != "tokens":
        first = x.movedim(-1, 1).contiguous(), weight.movedim(-2, 0).contiguous()
        found[FIRST] = _contender(torch_filter(DIMS_FIRST[kind]), *first, work)
    return found


def _contender(function: Filter, x: Tensor, weight: Tensor, work: Work) -> Callable[[], float]:
    x, weight = x.clone(), weight.clone()
    if work == "forward":
        return timed(lambda: function(x, weight))
    grad = torch.ones_like(x)
    x.requires_grad_()
    weight.requires_grad_()
    return timed(
        lambda: torch.autograd.grad(function(x, weight), (x, weight), grad),
        # As an optimizer's step would: a weight prepared for the last call is out of date.
        prepare=lambda: weight.data.neg_(),
    )


def our_filter(kind: Kind) -> Filter:
    """Return our filter; a sequence is a grid with one row, as in `ffpose.nn.SequenceFilter`."""
    if kind == "sequence":
        return lambda x, weight: spectral_filter(
            x.unsqueeze(-3), weight.unsqueeze(0), "grid"
        ).squeeze(-3)
    return lambda x, weight: spectral_filter(x, weight, kind)


def torch_filter(dim: tuple[int, ...]) -> Filter:
    """Return the filter in torch.fft over these dimensions: ``irfft2(rfft2(x) * W)``, or 1-D."""

    def plain(x: Tensor, weight: Tensor) -> Tensor:
        # A network in the layout channels_last has its weights of four axes in that layout too.
        spectrum = torch.fft.rfftn(x, dim=dim) * torch.view_as_complex(weight.contiguous())
        y: Tensor = torch.fft.irfftn(spectrum, s=[x.shape[d] for d in dim], dim=dim)
        return y

    return plain


def _means(results: Sequence[Result], work: Work) -> tuple[float, float]:
    """Return the mean ratios to torch.fft on data that lie as ours, and in its best layout."""
    chosen = [each for each in results if each.work == work]
    return (
        geometric_mean(each.ratio(LAST) for each in chosen),
        geometric_mean(each.ratio(LAST, FIRST) for each in chosen),
    )


def _table(results: Sequence[Result]) -> Table:
    table = Table(title=f"ffpose bench filter: float32, {processor()}", title_justify="left")
    for name in ("size", "batch", "threads", "work"):
        table.add_column(name)
    for name in ("ffpose µs", "torch.fft µs", "ratio", "best layout"):
        table.add_column(name, justify="right")
    for each in results:
        table.add_row(
            *(each.label, str(each.batch), str(each.threads), each.work),
            *(f"{1e6 * each.latencies[name].p50:.1f}" for name in (OURS, LAST)),
            f"{each.ratio(LAST):.2f}",
            f"{each.ratio(LAST, FIRST):.2f}",
        )
    return table
