"""Printing the tables of a filter benchmark."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.table import Table

from ffpose.bench.filter.cases import COMPILED, MATRICES, OURS, SCIPY, TORCH
from ffpose.bench.filter.children import Opening
from ffpose.bench.filter.figures import geometric_mean, operations, traffic
from ffpose.bench.filter.results import (
    Comparison,
    GroupMean,
    gains_of_threads,
    group_means,
    half_over_single,
    in_tables,
    over_copy,
    overheads,
)
from ffpose.bench.output import in_threads, make_console, make_table
from ffpose.bench.timing import Timing

Pair = tuple[Comparison, float]
"""A case and what is said of it."""

Worst = Callable[..., Pair]
"""Which of several pairs is the worst: `min` or `max`."""

LEGEND = (
    "ratio: torch.fft's time over ours, by medians [quartiles] of interleaved runs, float32; each"
    " side with the allocator that suits it better",
    "forward+backward: both gradients of a weight that changes before every call",
    "GFLOP/s: nominal, 2.5 N log2 N for a real transform of N points; GB/s: inputs and results"
    " once each; peaks: of a matrix product, and of a copy of 64 MiB",
)


def print_tables(
    openings: Sequence[Opening], comparisons: Sequence[Comparison], notes: Sequence[str]
) -> None:
    """Print tables of all cases, other rivals, limits, overhead, and means of the groups."""
    console = make_console()
    for isa, threads in dict.fromkeys((each.isa, each.case.threads) for each in comparisons):
        chosen = [one for one in comparisons if (one.isa, one.case.threads) == (isa, threads)]
        console.print(_cases(chosen, _heading(openings, isa, threads)))
    for table in (_rivals(comparisons), _limits(comparisons), _overheads(comparisons)):
        if table.row_count:
            console.print(table)
    console.print(_means(group_means(comparisons)))
    for line in (*LEGEND, *notes):
        console.print(f"- {line}", markup=False)


def _heading(openings: Sequence[Opening], isa: str, threads: int) -> str:
    opening = next(each for each in openings if each.setting.isa == isa)
    about = opening.environment
    peak = next(each for each in opening.peaks if each.threads == threads)
    mkl = f", MKL's {about['mkl_code']} code" if about["mkl_code"] else ""
    return (
        f"{isa}, {in_threads(threads)}: ffpose {about['ffpose']}, torch {about['torch']}"
        f" ({about['torch_cpu_capability']}{mkl}), {about['processor']}; peaks"
        f" {peak.flops / 1e9:.0f} GFLOP/s, {peak.copy_bytes / 1e9:.1f} GB/s"
    )


def _cases(comparisons: Sequence[Comparison], heading: str) -> Table:
    table = make_table(heading, "case", "work")
    for name in ("ffpose µs", "torch.fft µs", "ratio", "GFLOP/s", "GB/s"):
        table.add_column(name, justify="right")
    for one in in_tables(comparisons):
        seconds = one.best(OURS).median
        table.add_row(
            f"{one.case.size_label}, batch {one.case.batch}",
            one.case.work,
            _microseconds(one.best(OURS)),
            _microseconds(one.best(TORCH)),
            f"{one.ratio():.2f}",
            f"{operations(one.case) / seconds / 1e9:.1f}",
            f"{traffic(one.case) / seconds / 1e9:.1f}",
        )
    return table


def _rivals(comparisons: Sequence[Comparison]) -> Table:
    """Return the table of every rival's time over ours."""
    rivals = (TORCH, COMPILED, SCIPY, MATRICES)
    table = make_table("all rivals: their time over ours", "case")
    for name in rivals:
        table.add_column(name, justify="right")
    for one in comparisons:
        if {COMPILED, SCIPY, MATRICES} & set(one.names):
            cells = [f"{one.ratio(name):.2f}" if name in one.names else "" for name in rivals]
            table.add_row(one.case.label, *cells)
    return table


def _limits(comparisons: Sequence[Comparison]) -> Table:
    table = make_table("near the limit", "what", "geometric mean", "worst", "of")
    gains = gains_of_threads(comparisons)
    over, half = over_copy(comparisons), half_over_single(comparisons)
    limits: list[tuple[str, Sequence[Pair], Worst]] = [
        ("filter's time over a copy of x, batch 32 grid forward", over, max),
        ("bfloat16's time over float32's, batch 32", half, max),
    ]
    for threads in sorted({one.case.threads for one, _ in gains}):
        of_them = [pair for pair in gains if pair[0].case.threads == threads]
        limits.append((f"gain by {threads} threads, work over 200 µs", of_them, min))
    for what, pairs, worst in limits:
        if pairs:
            one, value = worst(pairs, key=lambda pair: pair[1])
            mean = geometric_mean(each for _, each in pairs)
            table.add_row(what, f"{mean:.2f}", f"{value:.2f}", one.case.label)
    return table


def _overheads(comparisons: Sequence[Comparison]) -> Table:
    table = make_table("one call of grid 7×7×32, µs", "work")
    for name in ("ffpose", "of it arithmetic", "torch.fft", "ratio"):
        table.add_column(name, justify="right")
    for each in overheads(comparisons):
        microseconds = [1e6 * value for value in (each.call, each.arithmetic, each.torch_call)]
        cells = [f"{value:.1f}" for value in microseconds]
        table.add_row(each.work, *cells, f"{each.torch_call / each.call:.2f}")
    return table


def _means(means: Sequence[GroupMean]) -> Table:
    table = make_table("ratio to torch.fft", "instructions", "group", "work")
    for name in ("geometric mean", "worst"):
        table.add_column(name, justify="right")
    table.add_column("of")
    for each in means:
        setting = f"{each.isa}, {in_threads(each.threads)}"
        worst = f"{each.worst.case.size_label}, batch {each.worst.case.batch}"
        figures = f"{each.mean:.2f}", f"{each.worst.ratio():.2f}"
        table.add_row(setting, each.group, each.work, *figures, worst)
    return table


def _microseconds(timing: Timing) -> str:
    median, lower, upper = (1e6 * value for value in (timing.median, timing.lower, timing.upper))
    digits = 1 if median < 100 else 0
    return f"{median:.{digits}f} \\[{lower:.{digits}f}–{upper:.{digits}f}]"
