"""`ffpose bench filter`: the spectral filter against torch.fft written as its users write it.

The rival is `irfft2(rfft2(x) * W)` on the same tensors, in the same process, call by call in turn
with ours (`ffpose.bench.timing`). A ratio above 1 means that ffpose is faster.
"""

from __future__ import annotations

import json
import math
import os
import platform
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

import ffpose
from ffpose.arrays import instruction_set
from ffpose.bench.timing import Timing, interleave
from ffpose.files import atomic_write
from ffpose.ops import Layout, spectral_filter

Sizes = dict[Layout, tuple[tuple[int, ...], ...]]

SIZES: Sizes = {
    "grid": ((7, 7, 512), (14, 14, 256), (14, 14, 384), (28, 28, 256), (56, 56, 64)),
    "tokens": ((196, 128), (196, 256), (784, 128), (784, 256)),
}
QUICK_SIZES: Sizes = {"grid": ((14, 14, 256), (28, 28, 256)), "tokens": ((196, 256),)}


@dataclass(frozen=True)
class Case:
    """One measurement: float32 `x` of shape `(batch, *size)`; `backward` adds both gradients."""

    layout: Layout
    size: tuple[int, ...]
    batch: int
    backward: bool
    threads: int

    @property
    def label(self) -> str:
        """The case in words, as the table prints it."""
        work = "forward+backward" if self.backward else "forward"
        return f"{self.layout} {'×'.join(map(str, self.size))}, batch {self.batch}, {work}"


@dataclass(frozen=True)
class Result:
    """The two timings of a case and the rival's largest deviation from ours."""

    case: Case
    ffpose: Timing
    torch_fft: Timing
    largest_difference: float

    @property
    def ratio(self) -> float:
        """How many times faster than torch.fft, by medians."""
        return self.torch_fft.median / self.ffpose.median


def torch_fft_filter(x: torch.Tensor, weight: torch.Tensor, layout: Layout) -> torch.Tensor:
    """The filter as a user of torch.fft writes it.

    Args:
        x: `(..., X, Y)` for tokens, `(..., H, W, C)` for grid; float32 or float64.
        weight: `(X, Y//2+1, 2)` or `(H, W//2+1, C, 2)`, the real view of the half spectrum.
        layout: "tokens" or "grid".

    Returns:
        `irfft2(rfft2(x) * W)`, of the shape of `x`.
    """
    dim = (-2, -1) if layout == "tokens" else (-3, -2)
    spectrum = torch.fft.rfft2(x, dim=dim) * torch.view_as_complex(weight)
    y: torch.Tensor = torch.fft.irfft2(spectrum, s=[x.shape[i] for i in dim], dim=dim)
    return y


def cases(quick: bool) -> list[Case]:
    """The cases of the full table, or the few of `--quick`."""
    sizes = QUICK_SIZES if quick else SIZES
    batches = (1,) if quick else (1, 8, 32)
    threads = (1,) if quick else tuple(sorted({1, min(2, os.cpu_count() or 1)}))
    return [
        Case(layout, size, batch, backward, count)
        for count in threads
        for layout in sizes
        for size in sizes[layout]
        for batch in batches
        for backward in (False, True)
    ]


def measure(case: Case, seconds: float) -> Result:
    """Times one case with `case.threads` torch threads, `seconds` for each of the two."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(case.batch, *case.size, generator=generator)
    rows, columns = case.size[0], case.size[1] // 2 + 1
    weight = torch.randn(rows, columns, *case.size[2:], 2, generator=generator)
    before = torch.get_num_threads()
    torch.set_num_threads(case.threads)
    try:
        rivals = {
            "ffpose": _work(lambda: spectral_filter(x, weight, case.layout), case, x, weight),
            "torch.fft": _work(lambda: torch_fft_filter(x, weight, case.layout), case, x, weight),
        }
        with torch.no_grad():
            ours = spectral_filter(x, weight, case.layout)
            theirs = torch_fft_filter(x, weight, case.layout)
        timings = interleave(rivals, seconds)
    finally:
        torch.set_num_threads(before)
    difference = float((ours - theirs).abs().max() / theirs.abs().max())
    return Result(case, timings["ffpose"], timings["torch.fft"], difference)


def _work(
    forward: Callable[[], torch.Tensor], case: Case, x: torch.Tensor, weight: torch.Tensor
) -> Callable[[], object]:
    """What one timed call does: the forward pass alone, or with both gradients."""
    if not case.backward:
        return torch.no_grad()(forward)
    x.requires_grad_()
    weight.requires_grad_()
    grad = torch.ones_like(x)
    return lambda: torch.autograd.grad(forward(), (x, weight), grad)


def run(json_path: Path | None = None, plot: Path | None = None, quick: bool = False) -> None:
    """Measures all cases, prints the table to standard output, and writes what is asked for.

    Args:
        json_path: where to write every timing as JSON.
        plot: where to draw the ratios, as a PNG.
        quick: few sizes and short timings, for a first look in under a minute.

    Raises:
        OSError: if a file cannot be written; its folder is checked before anything is measured.
    """
    for path in (json_path, plot):
        if path is not None and not path.parent.is_dir():
            raise FileNotFoundError(f"expected an existing folder for {path}, got {path.parent}")
    results = list(_measured(cases(quick), 0.2 if quick else 0.5))
    _print_table(results)
    if json_path is not None:
        with atomic_write(json_path) as temporary:
            temporary.write_text(json.dumps(_document(results), indent=2) + "\n")
    if plot is not None:
        _draw(results, plot)


def _measured(todo: list[Case], seconds: float) -> Iterable[Result]:
    for number, case in enumerate(todo, 1):
        print(f"[{number}/{len(todo)}] {case.label}, threads: {case.threads}", file=sys.stderr)
        yield measure(case, seconds)


def geometric_mean(values: Iterable[float]) -> float:
    """The geometric mean of positive ratios.

    >>> geometric_mean([2.0, 8.0])
    4.0
    """
    logarithms = [math.log2(value) for value in values]
    return math.exp2(sum(logarithms) / len(logarithms))


def environment() -> dict[str, Any]:
    """What a reader needs to repeat the figures: versions, processor, instruction set."""
    return {
        "ffpose": ffpose.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processor": _processor(),
        "instruction_set": instruction_set(),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "mkl_enable_instructions": os.environ.get("MKL_ENABLE_INSTRUCTIONS", ""),
        "cores": os.cpu_count(),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def _groups(results: list[Result]) -> dict[str, list[Result]]:
    """Results by layout, kind of pass and threads: one geometric mean each."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        case = result.case
        work = "forward+backward" if case.backward else "forward"
        key = f"{case.layout}, {work}, {case.threads} thread{'s' if case.threads > 1 else ''}"
        groups.setdefault(key, []).append(result)
    return groups


def _document(results: list[Result]) -> dict[str, Any]:
    return {
        "environment": environment(),
        "results": [asdict(result) | {"ratio": result.ratio} for result in results],
        "geometric_mean_ratio": {
            key: geometric_mean(result.ratio for result in group)
            for key, group in _groups(results).items()
        },
    }


def _print_table(results: list[Result]) -> None:
    from rich.console import Console
    from rich.table import Table

    about = environment()
    table = Table(
        title="spectral filter, float32, medians of interleaved runs",
        caption=f"ffpose {about['ffpose']} ({about['instruction_set']}), torch {about['torch']} "
        f"({about['torch_cpu_capability']}), {about['processor']}",
    )
    table.add_column("case")
    for name in ("threads", "ffpose µs", "torch.fft µs", "ratio", "difference"):
        table.add_column(name, justify="right")
    for result in results:
        table.add_row(
            result.case.label,
            str(result.case.threads),
            f"{result.ffpose.median * 1e6:.1f}",
            f"{result.torch_fft.median * 1e6:.1f}",
            f"{result.ratio:.2f}",
            f"{result.largest_difference:.1e}",
        )
    console = Console(width=None if sys.stdout.isatty() else 110)
    console.print(table)
    for key, group in _groups(results).items():
        worst = min(group, key=lambda result: result.ratio)
        mean = geometric_mean(result.ratio for result in group)
        console.print(
            f"{key}: geometric mean {mean:.2f}, worst {worst.ratio:.2f} ({worst.case.label})"
        )


def _draw(results: list[Result], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 1.2 + 0.28 * len(results)), layout="constrained")
    axes = figure.add_subplot()
    labels = [f"{result.case.label}, {result.case.threads} thr." for result in results]
    colours = ["#d95f0e" if result.case.backward else "#2c7fb8" for result in results]
    axes.barh(labels, [result.ratio for result in results], color=colours)
    axes.axvline(1.0, color="black", linewidth=1)
    axes.invert_yaxis()
    axes.set_xlabel("times faster than torch.fft (1 = equal)")
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
