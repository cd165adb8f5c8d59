"""Selection of the cases for each instruction set, and notes on what cannot be measured."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ffpose.arrays import instruction_set
from ffpose.bench.filter.cases import (
    BATCHES,
    COMPILED,
    COPY,
    FEW,
    FEW_CHANNELS,
    GRID,
    HALF,
    LARGEST_BATCH,
    MATRICES,
    OTHER,
    SCIPY,
    TOKENS,
    Case,
    overhead_cases,
    sweep,
)
from ffpose.bench.filter.matrices import fits
from ffpose.bench.machine import cores

SLOWER: Mapping[str, tuple[str, ...]] = {
    "avx512": ("avx512", "avx2", "scalar"),
    "avx2": ("avx2", "scalar"),
    "neon": ("neon", "scalar"),
    "scalar": ("scalar",),
}
"""All instruction sets of a machine, by its best one."""


@dataclass(frozen=True)
class Plan:
    """Plan of a filter benchmark.

    Attributes:
        cases: Cases by instruction set, the machine's best first.
        seconds: Time for each contender of a case.
        notes: Notes for the reader on what is left out or unusual.
    """

    cases: Mapping[str, Sequence[Case]]
    seconds: float
    notes: tuple[str, ...]


def make_plan(quick: bool) -> Plan:
    """Plan all cases, or the few of ``--quick``."""
    rivals, notes = available_rivals(quick)
    best = instruction_set()
    if quick:
        cases = [*with_rivals(sweep(FEW, (1, 8), 1), rivals), *overhead_cases()]
        return Plan({best: cases}, 0.1, (*notes, "quick: few sizes, one thread"))
    sizes = GRID + TOKENS + OTHER + FEW_CHANNELS
    cases = [*with_rivals(sweep(sizes, BATCHES, 1), rivals), *overhead_cases()]
    for threads in sorted({2, cores()} if cores() > 1 else ()):
        cases += sweep(GRID + TOKENS, BATCHES, threads)
    if cores() == 1:
        notes = (*notes, "one core: two threads are not measured")
    by_isa = {best: cases}
    isas = (best,) if "FFPOSE_ISA" in os.environ else SLOWER[best]
    for isa in isas[1:]:
        is_scalar = isa == "scalar"
        by_isa[isa] = sweep(GRID + TOKENS, (1,), 1) if is_scalar else sweep(sizes, BATCHES, 1)
    if "scalar" in by_isa and best != "scalar":
        notes = (*notes, "scalar: against torch.fft with all its instruction sets")
    return Plan(by_isa, 0.25, notes)


def available_rivals(quick: bool) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return the measurable rivals besides torch.fft, and notes on why others are not."""
    found, notes = {MATRICES}, []
    if importlib.util.find_spec("scipy") is not None:
        found.add(SCIPY)
    else:
        notes.append(f"{SCIPY} is not measured: SciPy is not installed")
    if quick:
        notes.append(f"{COMPILED} is not measured: it takes too long to compile")
    elif shutil.which(os.environ.get("CXX", "g++")) is not None:
        found.add(COMPILED)
        notes.append(f"{COMPILED}: batch 1 alone, as each size is compiled anew")
    else:
        notes.append(f"{COMPILED} is not measured: it needs a C++ compiler, and g++ is not found")
    return frozenset(found), tuple(notes)


def with_rivals(cases: Sequence[Case], rivals: frozenset[str]) -> list[Case]:
    """Return ``cases``, each with all contenders that support it."""
    return [replace(case, contenders=case.contenders + _more(case, rivals)) for case in cases]


def _more(case: Case, rivals: frozenset[str]) -> tuple[str, ...]:
    forward, one_of_few = case.work == "forward", (case.kind, case.size) in FEW
    in_tables = (case.kind, case.size) in GRID + TOKENS
    wanted = {
        SCIPY: one_of_few and forward and SCIPY in rivals,
        MATRICES: one_of_few and fits(case.plane),
        COMPILED: one_of_few and case.batch == 1 and COMPILED in rivals,
        HALF: in_tables and case.batch == LARGEST_BATCH,
        COPY: in_tables and case.batch == LARGEST_BATCH and forward and case.kind == "grid",
    }
    return tuple(name for name, takes_part in wanted.items() if takes_part)
