"""The data files of the pages, ``docs/figures/NAME.json``: what each holds, and how it is measured.

A file holds the document of one benchmark, as ``python -m benchmarks … --json`` prints it but for
single timings of the filter, which are many; before it stand the machine and how it was measured.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from timeit import Timer
from typing import Any

import torch
from torch import Tensor, nn

from benchmarks.filter import report as filter_report
from benchmarks.filter import run as filter_run
from benchmarks.filter.cases import GRID, TOKENS
from benchmarks.filter.cases import make_plan as filter_plan
from benchmarks.machine import environment
from benchmarks.model import attention, deployment
from benchmarks.model import plan as deployment_plan
from benchmarks.model import report as deployment_report
from benchmarks.model.contenders import COMPILED, COMPILED_ALONE, DFT, MATMUL, WITHOUT
from benchmarks.model.subjects import Subject, subject
from benchmarks.pages.vector_code import vector_code
from ffpose._internal.files import atomic_write
from ffpose.bench.timing import take_turns
from ffpose.errors import DataError
from ffpose.inference.in_torch import torch_threads

FOLDER = Path("docs/figures")
IMAGES = Path("docs/images")

WIDTH = 100
"""Longest lines of a data file, where they can be broken."""

FILTER_SECONDS = 0.03
"""Time for each contender of a case of the filter: the means are over many cases."""

NETWORK_SECONDS = 1.5
"""Time for each contender of a network."""

OPERATORS = 12
"""Operators of a graph whose shares of its time are kept, the largest first."""

COMPILERS = (COMPILED, COMPILED_ALONE)

VIEWS = tuple(product((1, 2), (1, 2)))
"""Looks and candidates of `soyuz` whose times are compared."""

Measured = dict[str, Any]


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        quick: The few cases of ``--quick``, with short timings.
        threads: Numbers of threads.
    """

    quick: bool
    threads: tuple[int, ...]


@dataclass(frozen=True)
class Figures:
    """A data file.

    Attributes:
        machine: Its name, as the pages print it.
        note: What the reader has to know of the measurement; may be empty.
        quick: Whether only the few cases of ``--quick`` were measured.
        threads: Numbers of threads.
        environment: `benchmarks.machine.environment`: versions, processor, instruction sets.
        results: The benchmark's document.
    """

    machine: str
    note: str
    quick: bool
    threads: tuple[int, ...]
    environment: Mapping[str, Any]
    results: Mapping[str, Any]


def read(name: str, root: Path) -> Figures:
    """Read the data file of that name below ``root``, the folder of the sources.

    Raises:
        ffpose.DataError: There is no such file, or it is none of these.
    """
    path = root / FOLDER / f"{name}.json"
    try:
        fields = json.loads(path.read_text())
        return Figures(**{**fields, "threads": tuple(fields["threads"])})
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise DataError(f"{path}: expected figures of {name}, got {error!r}") from error


def write(name: str, figures: Figures, root: Path) -> None:
    """Write a data file."""
    fields = asdict(figures)
    with atomic_write(root / FOLDER / f"{name}.json") as temporary:
        temporary.write_text(to_lines(fields) + "\n")


def to_lines(value: Any, indent: str = "") -> str:
    """Return JSON in lines of at most `WIDTH`, broken where things hold others.

    >>> print(to_lines({"a": [1, 2], "b": ["c" * 80]}))
    {
     "a": [1, 2],
     "b": ["cccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccc"]
    }
    """
    line = json.dumps(value, ensure_ascii=False)
    if len(indent + line) < WIDTH or not isinstance(value, dict | list | tuple):
        return line
    inner = indent + " "
    if isinstance(value, dict):
        lines = [f"{json.dumps(key)}: {to_lines(each, inner)}" for key, each in value.items()]
        start, end = "{}"
    else:
        lines = [to_lines(each, inner) for each in value]
        start, end = "[]"
    return f"{start}\n{inner}" + f",\n{inner}".join(lines) + f"\n{indent}{end}"


def measure(name: str, effort: Effort, machine: str, note: str, root: Path) -> Figures:
    """Measure what the data file of that name holds; pictures of it are drawn, too.

    Raises:
        RuntimeError: The contenders of a case compute different results.
    """
    results = to_digits(DOCUMENTS[name](effort, root))
    results.pop("environment", None)  # that of the file
    return Figures(machine, note, effort.quick, effort.threads, environment(), results)


def to_digits(value: Any, digits: int = 4) -> Any:
    """Return a JSON value whose fractions have this many significant digits.

    >>> to_digits({"a": [0.123456, 7, 1234.56]})
    {'a': [0.1235, 7, 1235.0]}
    """
    if isinstance(value, dict):
        return {key: to_digits(each, digits) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [to_digits(each, digits) for each in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def _filter(effort: Effort, root: Path) -> Measured:
    plan = filter_plan(effort.quick)
    best, *others = plan.cases
    cases = {best: [case for case in plan.cases[best] if case.threads in effort.threads]}
    cases |= {
        isa: [case for case in plan.cases[isa] if (case.kind, case.size) in GRID + TOKENS]
        for isa in others
        if isa != "scalar"
    }
    seconds = min(plan.seconds, FILTER_SECONDS)
    openings, comparisons = filter_run.measure(replace(plan, cases=cases, seconds=seconds))
    about = f"{openings[0].environment['processor']}, {best}"
    filter_report.draw(comparisons, about, root / IMAGES / "filter.png")
    document = filter_report.make_document(openings, comparisons, plan.notes)
    for result in document["results"]:
        for timings in ("timings", "ratio_default_allocator", "flops", "bytes"):
            del result[timings]
    return {**document, "vector_code": vector_code()}


def _network(
    effort: Effort,
    root: Path,
    *,
    name: str,
    without: Sequence[str] = (),
    starts: int = 0,
    plot: str | None = None,
) -> Measured:
    """Measure a network at batch 1.

    Args:
        effort: How much is measured.
        root: Folder of the sources.
        name: The network.
        without: Contenders that are left out.
        starts: New processes of each runtime.
        plot: File for a plot, in the folder of images.
    """

    def plan_of(measured: Subject) -> deployment_plan.DeploymentPlan:
        plan = deployment_plan.make_plan(measured, effort.quick, (1,), effort.threads)
        return replace(
            plan,
            names=[each for each in plan.names if each not in without],
            seconds=min(plan.seconds, NETWORK_SECONDS),
            starts=min(plan.starts, starts),
        )

    results = deployment.measure(name, plan_of)
    if plot is not None:
        deployment_report.draw(results, root / IMAGES / plot)
    document = deployment_report.make_document(results)
    for runtime, shares in document["operator_shares"].items():
        document["operator_shares"][runtime] = dict(list(shares.items())[:OPERATORS])
    return document


def _attention(effort: Effort, _: Path) -> Measured:
    quick = attention.make_plan(quick=True)
    cases = [
        replace(case, threads=threads) for threads, case in product(effort.threads, quick.cases)
    ]
    plan = replace(quick, cases=cases, notes=())
    return attention.make_document(list(attention.measure_all(plan)), plan.notes)


def _views(effort: Effort, _: Path) -> Measured:
    """Measure the shipped network in torch, on one thread, with fewer looks and candidates."""
    calls = {}
    for looks, candidates in VIEWS:
        with tempfile.TemporaryDirectory(prefix="ffpose-bench-") as folder:
            measured = subject("soyuz", Path(folder), looks=looks, candidates=candidates)
        calls[f"{looks} {candidates}"] = Timer(partial(_infer, measured.model, measured.images(1)))
    with torch_threads(1):
        found = take_turns(calls, 0.5 if effort.quick else NETWORK_SECONDS)
    return {"latencies": {name: asdict(latency) for name, latency in found.items()}}


def _infer(model: nn.Module, images: Tensor) -> None:
    with torch.inference_mode():
        model(images)


DOCUMENTS: Mapping[str, Callable[[Effort, Path], Measured]] = {
    "filter": _filter,
    "base": partial(_network, name="base", without=(COMPILED,), plot="deployment.png"),
    "small": partial(_network, name="small", without=(*COMPILERS, DFT, MATMUL, WITHOUT)),
    "soyuz": partial(_network, name="soyuz", without=COMPILERS, starts=3),
    "gfnet": partial(_network, name="gfnet", without=(COMPILED, DFT)),
    "attention": _attention,
    "views": _views,
}
"""What measures each data file, by its name."""
