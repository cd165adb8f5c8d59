"""Printed tables of `ffpose bench model NETWORK`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from ffpose.bench.machine import environment
from ffpose.bench.model.contenders import WITHOUT
from ffpose.bench.model.stages import STAGES, TOTAL
from ffpose.bench.output import in_threads, make_console, make_table

if TYPE_CHECKING:
    from ffpose.bench.model.deployment import CaseResult, DeploymentResults

LEGEND = (
    "p50, p95, p99: of the latency of single calls, in turns with the other contenders; ratio: p50"
    " over the baseline's",
    "difference: largest, from the baseline's outputs; metres, quaternions, relative for the rest",
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
    for line in (*LEGEND, f"baseline: {results.baseline}", *results.notes):
        console.print(f"- {line}", markup=False)


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
