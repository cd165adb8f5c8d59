"""`ffpose bench filter`: the spectral filter against what a PyTorch user would write instead.

The rivals are torch.fft, torch.fft compiled, SciPy's fft and matrix products. All contenders of a
case take turns in one process (`ffpose.bench.timing`); each instruction set and each way of keeping
memory has a process of its own (`ffpose.bench.children`). A ratio above 1 means that ffpose is
faster.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from ffpose.bench.children import ALLOCATORS, Opening, Setting, run_child
from ffpose.bench.document import make_document
from ffpose.bench.measure import Measurement
from ffpose.bench.output import expect_places, make_progress, write_document
from ffpose.bench.plan import Plan, make_plan
from ffpose.bench.plot import draw
from ffpose.bench.results import bring_together
from ffpose.bench.tables import print_tables
from ffpose.bench.worker import Request


def run(json_path: Path | None = None, plot: Path | None = None, quick: bool = False) -> None:
    """Measure all cases, print the tables to standard output, and write what is asked for.

    Args:
        json_path: Where to write every timing as JSON.
        plot: Where to draw the ratios, as a PNG.
        quick: Few sizes and short timings, for a first look in under a minute.

    Raises:
        OSError: A file cannot be written; its folder is checked before anything is measured.
        RuntimeError: A measuring process failed, or a rival computes something else.
    """
    expect_places(json_path, plot)
    plan = make_plan(quick)
    openings: list[Opening] = []
    comparisons = bring_together(_measured(plan, openings))
    print_tables(openings, comparisons, plan.notes)
    if json_path is not None:
        write_document(make_document(openings, comparisons, plan.notes), json_path)
    if plot is not None:
        about = openings[0].environment
        draw(comparisons, f"{about['processor']}, {openings[0].setting.isa}", plot)


def _measured(plan: Plan, openings: list[Opening]) -> Iterator[tuple[Setting, Measurement]]:
    """Run one child after the other, and show how far they are on standard error."""
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
