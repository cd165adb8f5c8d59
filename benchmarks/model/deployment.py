"""`python -m benchmarks model NETWORK`: a network in torch and in the runtimes that take its graph.

Latency of the network alone, of image file to pose by stages, and of a new process to its first
pose with its peak memory. The contenders of a case take turns in this process
(`ffpose.bench.timing`), so that other load on the machine affects them alike: ratios are more
reliable than milliseconds. A runtime that is not installed is a note.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from timeit import Timer

from benchmarks.model.contenders import (
    CUSTOM,
    GRAPH_OF,
    INT8,
    OPENVINO,
    PLAIN,
    TORCH,
    Graph,
    GraphKind,
    contenders,
    differences,
    write_graphs,
)
from benchmarks.model.operators import operator_shares
from benchmarks.model.pipeline import (
    ColdStart,
    Pipeline,
    Start,
    measure_stages,
    measure_starts,
    write_image,
)
from benchmarks.model.plan import DeploymentPlan, make_plan
from benchmarks.model.report import draw, make_document, print_results
from benchmarks.model.subjects import Subject, subject
from benchmarks.output import in_threads, make_progress, print_document
from ffpose._internal.files import expect_place
from ffpose._internal.zoo import resolve
from ffpose.bench.timing import Latency, take_turns
from ffpose.inference.in_torch import torch_threads
from ffpose.models.base import BaseNetwork
from ffpose.onnx.pose_graph import doubt_growth


@dataclass(frozen=True)
class CaseResult:
    """Latencies of the network alone, by contender, and differences from the baseline's outputs."""

    batch: int
    threads: int
    latencies: Mapping[str, Latency]
    differences: Mapping[str, float | None]


@dataclass(frozen=True)
class DeploymentResults:
    """All that is measured of one network.

    Attributes:
        network: Its name.
        baseline: The contender that ratios are to.
        cases: Of the network alone.
        stages: By number of threads and contender, latencies of the stages from file to pose.
        starts: By contender, cold starts; empty for a network that gives no pose.
        operators: By contender in ONNX Runtime, the share of each operator in the time of its
            nodes, batch 1, one thread.
        notes: For the reader, on what is left out or unusual.
    """

    network: str
    baseline: str
    cases: Sequence[CaseResult]
    stages: Mapping[int, Mapping[str, Mapping[str, Latency]]]
    starts: Mapping[str, ColdStart]
    operators: Mapping[str, Mapping[str, float]]
    notes: Sequence[str]


def run(
    network: str,
    as_json: bool = False,
    plot: Path | None = None,
    quick: bool = False,
    *,
    batches: Sequence[int] | None = None,
    threads: Sequence[int] | None = None,
    **fields: int,
) -> None:
    """Measure a network, and print the tables, or all latencies as JSON, on standard output.

    Args:
        network: ``"gfnet"``, a preset, or weights (`benchmarks.model.subjects.subject`).
        as_json: Print one JSON document in place of the tables.
        plot: File for a plot of the latencies, PNG.
        quick: Batch 1, one thread, the contenders that start fast, and short timings.
        batches: Images a batch; None for 1 and 8.
        threads: Numbers of threads; None for 1, 2 and all.
        **fields: Fields of the network to change: ``looks`` and ``candidates``.

    Raises:
        FileNotFoundError: No such network, or no folder for the plot.
        MissingExtraError: What the export needs is not installed.
        ValueError: A batch or a number of threads is below one, or a field cannot be changed.
        RuntimeError: A contender computes something else.
    """
    expect_place(plot)
    for name, values in (("batch", batches), ("threads", threads)):
        if values is not None and min(values, default=0) < 1:
            raise ValueError(f"{name}: expected numbers of at least 1, got {list(values)}")
    results = measure(network, lambda one: make_plan(one, quick, batches, threads), **fields)
    if as_json:
        print_document(make_document(results))
    else:
        print_results(results)
    if plot is not None:
        draw(results, plot)


def measure(
    network: str, plan_of: Callable[[Subject], DeploymentPlan], **fields: int
) -> DeploymentResults:
    """Measure a network, with progress on standard error; errors as `run`.

    Args:
        network: As `run`.
        plan_of: Gives the plan of the network.
        **fields: As `run`.
    """
    with tempfile.TemporaryDirectory(prefix="ffpose-bench-") as folder:
        measured = subject(network, Path(folder), **fields)
        return _measure(network, measured, plan_of(measured), Path(folder))


def _measure(
    network: str, measured: Subject, plan: DeploymentPlan, folder: Path
) -> DeploymentResults:
    cases = list(product(plan.threads, plan.batches))
    with make_progress() as progress:
        task = progress.add_task("exporting", total=len(cases) + len(plan.threads) + 2)
        kinds = list(dict.fromkeys(GRAPH_OF[name] for name in plan.names if name in GRAPH_OF))
        graphs = write_graphs(
            measured.model,
            measured.images(2),
            folder,
            kinds,
            entries=measured.entries,
            output_names=measured.outputs,
        )
        results, stages = [], {}
        for count, batch in cases:
            words = f"{network}, batch {batch}, {in_threads(count)}"
            progress.update(task, advance=1, description=words)
            with torch_threads(count):
                results.append(_measure_case(measured, graphs, plan, batch, count))
        for count in plan.threads if measured.weights is not None else ():
            words = f"image file to pose, {in_threads(count)}"
            progress.update(task, advance=1, description=words)
            with torch_threads(count):
                stages[count] = _measure_stages(measured, graphs, plan, folder, count)
        progress.update(task, advance=1, description="new processes")
        starts = _measure_starts(measured, graphs, plan, folder)
        operators = {
            name: operator_shares(graphs[GRAPH_OF[name]], measured.images(1).numpy(), folder, 1)
            for name in (CUSTOM, PLAIN, INT8)
            if name in plan.names
        }
    return DeploymentResults(network, plan.names[0], results, stages, starts, operators, plan.notes)


def _measure_case(
    measured: Subject,
    graphs: Mapping[GraphKind, Graph],
    plan: DeploymentPlan,
    batch: int,
    threads: int,
) -> CaseResult:
    calls = contenders(measured, graphs, plan.names, batch, threads)
    model = measured.model
    doubt = doubt_growth(model.config) if isinstance(model, BaseNetwork) else (0.0, 0.0)
    apart = differences(calls, plan.names[0], doubt)
    latencies = take_turns({name: Timer(call) for name, call in calls.items()}, plan.seconds)
    return CaseResult(batch, threads, latencies, apart)


def _measure_stages(
    measured: Subject,
    graphs: Mapping[GraphKind, Graph],
    plan: DeploymentPlan,
    folder: Path,
    threads: int,
) -> dict[str, dict[str, Latency]]:
    assert measured.weights is not None
    image = folder / "image.png"
    write_image(image)
    pipelines = {TORCH: Pipeline.of(measured.weights)}
    if (runtime := _runtime(plan)) is not None:
        pipelines[runtime] = Pipeline.of(graphs[GRAPH_OF[runtime]].path, threads)
    return measure_stages(pipelines, image, plan.seconds)


def _measure_starts(
    measured: Subject, graphs: Mapping[GraphKind, Graph], plan: DeploymentPlan, folder: Path
) -> dict[str, ColdStart]:
    if measured.weights is None or plan.starts == 0:
        return {}
    starts = {TORCH: Start("torch", resolve(measured.weights))}
    if (runtime := _runtime(plan)) is not None:
        starts[runtime] = Start("onnxruntime", graphs[GRAPH_OF[runtime]].path)
    if OPENVINO in plan.names:
        starts[OPENVINO] = Start("openvino", graphs["matmul"].path)
    return measure_starts(starts, folder / "image.png", max(plan.threads), plan.starts)


def _runtime(plan: DeploymentPlan) -> str | None:
    """Return the contender that is deployed: the first of ONNX Runtime's; None without any."""
    return next((name for name in (CUSTOM, PLAIN) if name in plan.names), None)
