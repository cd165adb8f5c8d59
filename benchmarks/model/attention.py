"""`python -m benchmarks attention`: inference and training with ours and torch's attention and FFT.

One baseline runs the forward of `torch.nn.MultiheadAttention`, one plain
`scaled_dot_product_attention`, one filters by ``torch.fft``; in all else they are ours
(`benchmarks.model.networks`). The contenders of a case are timed in turn in this process
(`benchmarks.timing`), so that other load on the machine affects them alike: the ratio is more
reliable than the milliseconds. A ratio above 1 means that ffpose is faster than the baseline.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

from rich.table import Table

from benchmarks.machine import bfloat16_instructions, environment
from benchmarks.model.networks import (
    BASELINES,
    PRECISIONS,
    TASKS,
    NetworkCase,
    contender,
    largest_difference,
    networks,
    random_images,
)
from benchmarks.output import (
    in_threads,
    make_console,
    make_progress,
    make_table,
    print_document,
    print_notes,
)
from benchmarks.timing import Timing, interleave
from ffpose._internal.machine import cores
from ffpose.bench.filter import OURS
from ffpose.inference.in_torch import torch_threads

MODELS = ("base", "small", "tiny")
THREADS = (1, 2)
LEGEND = (
    "nn.MultiheadAttention, plain SDPA, torch.fft: the same network and weights with the forward of"
    " the first, attention by torch's scaled_dot_product_attention (ours too but in training with"
    " dropout), or filters by torch.fft; ratio: its time over ours, by medians [quartiles] of"
    " interleaved runs",
    "training step: forward, backward and AdamW; bfloat16: autocast; torch eager, random images",
)


@dataclass(frozen=True)
class NetworkPlan:
    """Plan of a network benchmark.

    Attributes:
        cases: Cases in the order of the tables.
        seconds: Time for each contender of a case.
        notes: Notes for the reader on what is left out or unusual.
    """

    cases: Sequence[NetworkCase]
    seconds: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class NetworkResult:
    """Timings of a case by contender, and the difference of their float32 poses."""

    case: NetworkCase
    timings: Mapping[str, Timing]
    largest_difference: float

    @property
    def ratios(self) -> dict[str, float]:
        """Speedups over the baselines."""
        ours = self.timings[OURS].median
        return {name: self.timings[name].median / ours for name in BASELINES}

    @property
    def images_per_second(self) -> float:
        """Throughput of ffpose."""
        return self.case.batch / self.timings[OURS].median


def run(as_json: bool = False, quick: bool = False) -> None:
    """Measure all cases, and print the tables, or all timings as JSON, on standard output.

    Args:
        as_json: Print one JSON document in place of the tables.
        quick: Only batch 1, one thread and float32, with short timings.

    Raises:
        RuntimeError: The contenders of a case compute different poses.
    """
    plan = make_plan(quick)
    results = list(measure_all(plan))
    if as_json:
        print_document(make_document(results, plan.notes))
    else:
        print_results(results, plan.notes)


def make_plan(quick: bool) -> NetworkPlan:
    """Plan all cases, or the few of ``--quick``."""
    if quick:
        cases = [NetworkCase(model, 1, task) for model, task in product(MODELS, TASKS)]
        return NetworkPlan(cases, 0.5, ("quick: batch 1, one thread, float32",))
    notes: tuple[str, ...] = ()
    if not bfloat16_instructions():
        notes = (*notes, "bfloat16: this processor has no instructions for it, torch emulates them")
    if cores() == 1:
        notes = (*notes, "one core: two threads are not measured")
    cases = [
        NetworkCase(model, batch, task, precision, threads)
        for threads, model, batch, task, precision in product(
            THREADS[: cores()], MODELS, (1, 8), TASKS, PRECISIONS
        )
    ]
    cases += [
        NetworkCase("base", 8, "training step", threads=threads, filter="grid")
        for threads in THREADS[: cores()]
    ]
    return NetworkPlan(cases, 2.0, notes)


def measure(case: NetworkCase, seconds: float) -> NetworkResult:
    """Measure ``case`` for about ``seconds`` per contender.

    Raises:
        RuntimeError: The contenders compute different poses.
    """
    with torch_threads(case.threads):
        models = networks(case.model, case.filter)
        images = random_images(models[OURS], case.batch)
        difference = largest_difference(models, images)
        taking_part = {name: contender(model, images, case) for name, model in models.items()}
        return NetworkResult(case, interleave(taking_part, seconds), difference)


def measure_all(plan: NetworkPlan) -> Iterator[NetworkResult]:
    """Measure the cases in sequence, with progress on standard error."""
    with make_progress() as progress:
        task = progress.add_task("starting", total=len(plan.cases))
        for case in plan.cases:
            progress.update(task, description=f"{case.label}, {in_threads(case.threads)}")
            yield measure(case, plan.seconds)
            progress.advance(task)


def print_results(results: Sequence[NetworkResult], notes: Sequence[str]) -> None:
    """Print a table for each number of threads, then notes on how to read them."""
    console = make_console()
    about = environment()
    for threads in dict.fromkeys(each.case.threads for each in results):
        heading = f"{in_threads(threads)}: ffpose {about['ffpose']}, torch {about['torch']}"
        chosen = [each for each in results if each.case.threads == threads]
        console.print(_table(chosen, f"{heading}, {about['processor']}"))
    print_notes(console, (*LEGEND, *notes))


def _table(results: Sequence[NetworkResult], heading: str) -> Table:
    table = make_table(heading, "network", "work", "precision")
    for name in ("ffpose ms", *(part for each in BASELINES for part in (f"{each} ms", "ratio"))):
        table.add_column(name, justify="right")
    table.add_column("images/s", justify="right")
    for each in results:
        case = each.case
        table.add_row(
            f"{case.name}, batch {case.batch}",
            case.task,
            case.precision,
            _milliseconds(each.timings[OURS]),
            *(
                cell
                for name, ratio in each.ratios.items()
                for cell in (_milliseconds(each.timings[name]), f"{ratio:.2f}")
            ),
            f"{each.images_per_second:.1f}",
        )
    return table


def _milliseconds(timing: Timing) -> str:
    median, lower, upper = (1e3 * value for value in (timing.median, timing.lower, timing.upper))
    return f"{median:.1f} \\[{lower:.1f}–{upper:.1f}]"


def make_document(results: Sequence[NetworkResult], notes: Sequence[str]) -> dict[str, Any]:
    """Return all measurements as a JSON document; times in seconds."""
    return {
        "notes": list(notes),
        "environment": environment(),
        "results": [
            {
                "case": asdict(each.case),
                "ratio": each.ratios,
                "images_per_second": each.images_per_second,
                "largest_difference": each.largest_difference,
                "timings": {name: asdict(timing) for name, timing in each.timings.items()},
            }
            for each in results
        ],
    }
