"""`python -m benchmarks filter`: the spectral filter against what else computes it.

The rivals are torch.fft, compiled torch.fft, SciPy's fft and matrix products. All contenders of a
case are timed in turn in one process (`benchmarks.timing`); each instruction set and allocator
setting has a process of its own (`benchmarks.filter.children`). A ratio above 1 means that ffpose
is faster.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.filter.cases import Plan, make_plan
from benchmarks.filter.children import ALLOCATORS, Opening, Setting, run_child
from benchmarks.filter.report import draw, make_document, print_tables
from benchmarks.filter.results import Comparison, bring_together
from benchmarks.filter.worker import Measurement, Request
from benchmarks.output import make_progress, print_document
from ffpose._internal.files import expect_place


def run(as_json: bool = False, plot: Path | None = None, quick: bool = False) -> None:
    """Measure all cases, and print the tables, or all timings as JSON, on standard output.

    Args:
        as_json: Print one JSON document in place of the tables.
        plot: File for a plot of the ratios, PNG.
        quick: Few sizes and short timings, in under a minute.

    Raises:
        OSError: The plot cannot be written; its folder is checked before anything is measured.
        RuntimeError: A child process failed, or a rival's results differ.
    """
    expect_place(plot)
    plan = make_plan(quick)
    openings, comparisons = measure(plan)
    if as_json:
        print_document(make_document(openings, comparisons, plan.notes))
    else:
        print_tables(openings, comparisons, plan.notes)
    if plot is not None:
        about = openings[0].environment
        draw(comparisons, f"{about['processor']}, {openings[0].setting.isa}", plot)


def measure(plan: Plan) -> tuple[list[Opening], list[Comparison]]:
    """Measure all cases of a plan, with progress on standard error.

    Raises:
        RuntimeError: A child process failed, or a rival's results differ.
    """
    openings: list[Opening] = []
    comparisons = bring_together(_measured(plan, openings))
    return openings, comparisons


def _measured(plan: Plan, openings: list[Opening]) -> Iterator[tuple[Setting, Measurement]]:
    """Run the children in sequence, with progress on standard error."""
    settings = [Setting(isa, allocator) for isa in plan.cases for allocator in ALLOCATORS]
    total = sum(len(plan.cases[setting.isa]) for setting in settings)
    with make_progress() as progress, tempfile.TemporaryDirectory(prefix="ffpose-bench-") as caches:
        task = progress.add_task("starting", total=total)
        for setting in settings:
            request = Request(plan.cases[setting.isa], plan.seconds)
            for told in run_child(setting, request, caches):
                if isinstance(told, Opening):
                    openings.append(told)
                else:
                    words = f"{setting.isa}, allocator {setting.allocator}: {told.case.label}"
                    progress.update(task, advance=1, description=words)
                    yield setting, told
