"""Plot of a deployment's benchmark: latency by contender."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ffpose.bench.machine import environment
from ffpose.bench.model.contenders import WITHOUT
from ffpose.bench.output import in_threads
from ffpose.errors import require
from ffpose.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ffpose.bench.model.deployment import CaseResult, DeploymentResults

COLOR, PALE = "#1b4f9c", "#b9c6dc"


def draw(results: DeploymentResults, path: Path) -> None:
    """Plot p50 as bars, with a line up to p99, one panel a case, as a PNG.

    Args:
        results: Of one network.
        path: File to write.
    """
    names = list(results.cases[0].latencies)
    columns = min(2, len(results.cases))
    rows = -(-len(results.cases) // columns)
    figure = require("matplotlib.figure", "pose").Figure(
        figsize=(3 + 4 * columns, 0.8 + rows * (0.8 + 0.28 * len(names))),
        layout="constrained",
        facecolor="white",
    )
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).flatten()
    for axes, case in zip(panels, results.cases, strict=False):
        _draw_panel(axes, case)
    for axes in panels[len(results.cases) :]:
        axes.set_visible(False)
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    about = environment()["processor"]
    figure.suptitle(f"{results.network}: ms, p50 (bar) to p99 (line)\n{about}", fontsize=10)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png")


def _draw_panel(axes: Axes, case: CaseResult) -> None:
    names = list(case.latencies)
    medians = [1e3 * each.p50 for each in case.latencies.values()]
    above = [1e3 * (each.p99 - each.p50) for each in case.latencies.values()]
    axes.barh(
        range(len(names)),
        medians,
        xerr=[[0.0] * len(names), above],
        color=[PALE if name == WITHOUT else COLOR for name in names],
        error_kw={"elinewidth": 1, "ecolor": "#555555"},
        height=0.66,
    )
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for place, (value, more) in enumerate(zip(medians, above, strict=True)):
        axes.annotate(
            f"{value:.1f}",
            (value + more, place),
            xytext=(3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set_xlim(0, 1.12 * max(map(sum, zip(medians, above, strict=True))))
    axes.set_title(f"batch {case.batch}, {in_threads(case.threads)}", fontsize=10, loc="left")
    axes.grid(visible=True, axis="x", color="#e6e8ec", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
