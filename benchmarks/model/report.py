"""Results of `python -m benchmarks model` as printed tables, as a JSON document, and as a plot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from benchmarks.machine import environment
from benchmarks.model.contenders import WITHOUT
from benchmarks.model.pipeline import STAGES, TOTAL
from benchmarks.output import in_threads, make_console, make_table, print_notes
from ffpose._internal.figures import new_figure, save_figure, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from benchmarks.model.deployment import CaseResult, DeploymentResults


OPERATORS_SHOWN = 12

LEGEND = (
    "p50, p95, p99: of the latency of single calls, in turns with the other contenders; ratio: p50"
    " over the baseline's",
    "difference: largest, from the baseline's outputs; meters, quaternions, relative for the rest",
    "int8: calibrated with random images, so its difference says nothing; ffpose evaluate does",
    "without filters: the same graph with its filters left out, which computes something else",
)


def print_results(results: DeploymentResults) -> None:
    """Print latencies, stages and cold starts, then notes on how to read them."""
    console = make_console()
    about = environment()
    console.print(
        f"{results.network}: ffpose {about['ffpose']}, torch {about['torch']}, ONNX Runtime"
        f" {about['onnxruntime']}, OpenVINO {about['openvino']}, {about['processor']}",
        markup=False,
    )
    for case in results.cases:
        _print_case(console, case, results.baseline)
    for threads in results.stages:
        _print_stages(console, results, threads)
    if results.starts:
        _print_starts(console, results)
    if results.operators:
        _print_operators(console, results.operators)
    print_notes(console, (*LEGEND, f"baseline: {results.baseline}", *results.notes))


def _print_case(console: Console, case: CaseResult, baseline: str) -> None:
    calls = case.latencies[baseline].calls
    heading = f"network, batch {case.batch}, {in_threads(case.threads)}: ms, {calls} calls each"
    table = make_table(heading, "contender")
    for name in ("p50", "p95", "p99", "ratio", "difference"):
        table.add_column(name, justify="right")
    for name, latency in case.latencies.items():
        apart = case.differences[name]
        table.add_row(
            name,
            *(f"{1e3 * value:.1f}" for value in (latency.p50, latency.p95, latency.p99)),
            f"{latency.p50 / case.latencies[baseline].p50:.2f}",
            "–" if apart is None else f"{apart:.0e}",
            style="dim" if name == WITHOUT else None,
        )
    console.print(table)


def _print_stages(console: Console, results: DeploymentResults, threads: int) -> None:
    table = make_table(
        f"image file to pose, {in_threads(threads)}: ms, p50 of each stage", "contender"
    )
    for name in (*STAGES, "total p50", "p95", "p99"):
        table.add_column(name, justify="right")
    for name, latencies in results.stages[threads].items():
        total = latencies[TOTAL]
        seconds = [*(latencies[stage].p50 for stage in STAGES), total.p50, total.p95, total.p99]
        table.add_row(name, *(f"{1e3 * value:.1f}" for value in seconds))
    console.print(table)


def _print_starts(console: Console, results: DeploymentResults) -> None:
    first = next(iter(results.starts.values()))
    heading = f"new process to its first pose, {first.runs} of each: medians"
    table = make_table(heading, "contender")
    for name in ("seconds", "ratio", "peak memory MB", "ratio"):
        table.add_column(name, justify="right")
    for name, start in results.starts.items():
        table.add_row(
            name,
            f"{start.seconds:.2f}",
            f"{start.seconds / first.seconds:.2f}",
            f"{start.peak_bytes / 1e6:.0f}",
            f"{start.peak_bytes / first.peak_bytes:.2f}",
        )
    console.print(table)


def _print_operators(console: Console, operators: Mapping[str, Mapping[str, float]]) -> None:
    table = make_table("share of the time of its nodes, batch 1, 1 thread: %", "operator")
    for contender in operators:
        table.add_column(contender, justify="right")
    totals = {
        name: sum(shares.get(name, 0.0) for shares in operators.values())
        for shares in operators.values()
        for name in shares
    }
    for name in sorted(totals, key=lambda name: -totals[name])[:OPERATORS_SHOWN]:
        cells = (100 * shares.get(name, 0.0) for shares in operators.values())
        table.add_row(name, *(f"{cell:.1f}" for cell in cells))
    console.print(table)


def make_document(results: DeploymentResults) -> dict[str, Any]:
    """Return all measurements of a deployment, with the ratios of p50 to the baseline's."""
    baseline = results.baseline
    return {
        "network": results.network,
        "baseline": baseline,
        "notes": list(results.notes),
        "environment": environment(),
        "results": [
            {
                "batch": case.batch,
                "threads": case.threads,
                "latencies": {name: asdict(each) for name, each in case.latencies.items()},
                "ratio": {
                    name: each.p50 / case.latencies[baseline].p50
                    for name, each in case.latencies.items()
                },
                "largest_difference": dict(case.differences),
            }
            for case in results.cases
        ],
        "image_file_to_pose": [
            {
                "threads": threads,
                "latencies": {
                    name: {stage: asdict(each) for stage, each in by_stage.items()}
                    for name, by_stage in by_name.items()
                },
            }
            for threads, by_name in results.stages.items()
        ],
        "cold_starts": {name: asdict(start) for name, start in results.starts.items()},
        "operator_shares": {name: dict(shares) for name, shares in results.operators.items()},
    }


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
    figure = new_figure(3 + 4 * columns, 0.8 + rows * (0.8 + 0.28 * len(names)))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).flatten()
    for axes, case in zip(panels, results.cases, strict=False):
        _draw_panel(axes, case)
    for axes in panels[len(results.cases) :]:
        axes.set_visible(False)
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    about = environment()["processor"]
    figure.suptitle(f"{results.network}: ms, p50 (bar) to p99 (line)\n{about}", fontsize=10)
    save_figure(figure, path, dpi=130, format="png")


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
    style_axes(axes, "x")
