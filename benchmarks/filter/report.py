"""Results of a filter benchmark as printed tables, as a JSON document, and as a plot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import geometric_mean
from typing import TYPE_CHECKING, Any

from rich.table import Table

from benchmarks.filter.cases import (
    BATCHES,
    CHANNELS_FIRST,
    COMPILED,
    COPY,
    MANY,
    MATRICES,
    SCIPY,
    TORCH,
)
from benchmarks.filter.children import Opening
from benchmarks.filter.results import (
    Comparison,
    GroupMean,
    gains_of_threads,
    group_means,
    half_over_single,
    in_tables,
    operations,
    over_copy,
    overheads,
    traffic,
)
from benchmarks.output import in_threads, make_console, make_table, print_notes
from benchmarks.timing import Timing
from ffpose._internal.figures import new_figure, save_figure, style_axes
from ffpose.bench.filter import OURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Pair = tuple[Comparison, float]
"""A case and what is said of it."""

Worst = Callable[..., Pair]
"""Which of several pairs is the worst: `min` or `max`."""

LEGEND = (
    "ratio: torch.fft's time over ours, by medians [quartiles] of interleaved runs, float32; each"
    " side with the allocator that suits it better",
    "best layout: over torch.fft on grids and sequences with channels last, as ours, or first"
    " (C, H, W), where it transforms contiguous axes: whichever is faster in a case",
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
    for table in (_rivals(comparisons, notes), _limits(comparisons), _overheads(comparisons)):
        if table.row_count:
            console.print(table)
    console.print(_means(group_means(comparisons)))
    print_notes(console, (*LEGEND, *notes))


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


def _rivals(comparisons: Sequence[Comparison], notes: Sequence[str]) -> Table:
    """Return the table of every rival's time over ours; a rival left out is said to be."""
    rivals = (TORCH, CHANNELS_FIRST, COMPILED, SCIPY, MATRICES)
    left_out = {name for name in rivals if any(note.startswith(f"{name} is not") for note in notes)}
    table = make_table("all rivals: their time over ours", "case")
    for name in rivals:
        table.add_column(name, justify="right")
    for one in comparisons:
        if {COMPILED, SCIPY, MATRICES} & set(one.names):
            cells = [
                f"{one.ratio(name):.2f}"
                if name in one.names
                else ("not measured" if name in left_out else "")
                for name in rivals
            ]
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
    for name in ("best layout, mean", "worst"):
        table.add_column(name, justify="right")
    for each in means:
        setting = f"{each.isa}, {in_threads(each.threads)}"
        worst = f"{each.worst.case.size_label}, batch {each.worst.case.batch}"
        figures = f"{each.mean:.2f}", f"{each.worst.ratio():.2f}"
        layout = f"{each.best_layout_mean:.2f}", f"{each.best_layout_worst.best_layout_ratio():.2f}"
        table.add_row(setting, each.group, each.work, *figures, worst, *layout)
    return table


def _microseconds(timing: Timing) -> str:
    median, lower, upper = (1e6 * value for value in (timing.median, timing.lower, timing.upper))
    digits = 1 if median < 100 else 0
    return f"{median:.{digits}f} \\[{lower:.{digits}f}–{upper:.{digits}f}]"


def make_document(
    openings: Sequence[Opening], comparisons: Sequence[Comparison], notes: Sequence[str]
) -> dict[str, Any]:
    """Return all measurements as a JSON document; times in seconds."""
    return {
        "notes": list(notes),
        "processes": [asdict(opening) for opening in openings],
        "geometric_means": [_mean(each) for each in group_means(comparisons)],
        "times_a_copy": _listed(over_copy(comparisons)),
        "bfloat16_over_float32": _listed(half_over_single(comparisons)),
        "gain_of_threads": _listed(gains_of_threads(comparisons)),
        "overheads": [asdict(each) for each in overheads(comparisons)],
        "results": [_result(each) for each in comparisons],
    }


def _mean(mean: GroupMean) -> dict[str, Any]:
    return {
        "isa": mean.isa,
        "threads": mean.threads,
        "group": mean.group,
        "work": mean.work,
        "geometric_mean_ratio": mean.mean,
        "worst_ratio": mean.worst.ratio(),
        "worst_case": mean.worst.case.label,
        "best_layout_geometric_mean_ratio": mean.best_layout_mean,
        "best_layout_worst_ratio": mean.best_layout_worst.best_layout_ratio(),
    }


def _listed(pairs: Sequence[tuple[Comparison, float]]) -> list[dict[str, Any]]:
    return [
        {"isa": one.isa, "case": one.case.label, "threads": one.case.threads, "value": value}
        for one, value in pairs
    ]


def _result(one: Comparison) -> dict[str, Any]:
    seconds = one.best(OURS).median
    rivals = [name for name in one.names if name not in (OURS, COPY)]
    return {
        "isa": one.isa,
        "case": asdict(one.case),
        "group": one.case.group,
        "ratio": {name: one.ratio(name) for name in rivals},
        "ratio_default_allocator": {name: one.default_ratio(name) for name in rivals},
        "flops": operations(one.case) / seconds,
        "bytes": traffic(one.case) / seconds,
        "largest_difference": one.largest_difference,
        "timings": {
            allocator: {name: asdict(timing) for name, timing in timings.items()}
            for allocator, timings in one.timings.items()
        },
    }


COLORS = dict(zip((*BATCHES, MANY), ("#1b4f9c", "#3fa7d6", "#f08a24", "#7a7a7a"), strict=True))
WORKS = ("forward", "forward+backward")
TICKS = (0.5, 1, 2, 3, 5, 7, 10, 15, 20, 30, 50)


def draw(comparisons: Sequence[Comparison], about: str, path: Path) -> None:
    """Plot the ratios of the first instruction set with one thread, as a PNG.

    Args:
        comparisons: All comparisons; those with other settings are left out.
        about: Description of the machine, for the title.
        path: File to write.
    """
    isa = comparisons[0].isa
    chosen = [o for o in in_tables(comparisons) if (o.isa, o.case.threads) == (isa, 1)]
    labels = list(dict.fromkeys(one.case.size_label for one in chosen))
    figure = new_figure(9.5, 1.7 + 0.26 * len(labels))
    panels = figure.subplots(1, len(WORKS), sharex=True, sharey=True)
    for axes, work in zip(panels, WORKS, strict=True):
        _draw_panel(axes, [one for one in chosen if one.case.work == work], labels)
        axes.set_title(work.replace("+", " + "), fontsize=11, loc="left")
    panels[0].set_yticks(range(len(labels)), labels, fontsize=9)
    panels[0].set_ylim(len(labels) - 0.5, -0.5)
    ratios = [one.ratio() for one in chosen]
    panels[0].set_xlim(min(0.9, 0.9 * min(ratios)), 1.15 * max(ratios))
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names), frameon=False)
    figure.suptitle(f"times as fast as torch.fft, one thread, float32\n{about}", fontsize=10)
    save_figure(figure, path, dpi=130, format="png")


def _draw_panel(axes: Axes, comparisons: Sequence[Comparison], labels: Sequence[str]) -> None:
    for batch in sorted({one.case.batch for one in comparisons}):
        points = [one for one in comparisons if one.case.batch == batch]
        axes.scatter(
            [one.ratio() for one in points],
            [labels.index(one.case.size_label) for one in points],
            color=COLORS[batch],
            label=f"batch {batch}",
            s=34,
            zorder=3,
        )
    axes.set_xscale("log")
    axes.axvline(1.0, color="#333333", linewidth=1)
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS], fontsize=8, minor=False)
    axes.minorticks_off()
    style_axes(axes)
