"""Plot of a benchmark: speedup over torch.fft by size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ffpose.bench.filter.cases import BATCHES
from ffpose.bench.filter.results import Comparison, in_tables
from ffpose.errors import require
from ffpose.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = dict(zip(BATCHES, ("#1b4f9c", "#3fa7d6", "#f08a24"), strict=True))
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
    figure = require("matplotlib.figure", "pose").Figure(
        figsize=(9.5, 1.7 + 0.26 * len(labels)), layout="constrained", facecolor="white"
    )
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
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png")


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
    axes.grid(visible=True, color="#e6e8ec", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
