"""Cases of `python -m benchmarks filter`: sizes, batches, work, threads and contenders.

A plan has the cases for each instruction set, and notes on what cannot be measured here.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

from ffpose._internal.machine import cores
from ffpose.arrays import instruction_set
from ffpose.bench.filter import FIRST, LAST, OURS, SIZES, Kind

Work = Literal["forward", "forward+backward", "recorded"]
Sizes = tuple[tuple[Kind, tuple[int, ...]], ...]

HALF = "ffpose bfloat16"
TORCH = LAST
CHANNELS_FIRST = FIRST
"""torch.fft where it is quicker: ``(..., C, H, W)``, contiguous along the transformed axes."""
COMPILED = "torch.compile"
SCIPY = "scipy.fft"
MATRICES = "matrices"
COPY = "copy"

FEW: Sizes = tuple((kind, sizes[0]) for kind, sizes in SIZES.items())
"""The sizes of ``--quick``, one of each kind."""
GRID: Sizes = tuple(
    ("grid", size)
    for size in ((7, 7, 512), (14, 14, 256), (14, 14, 384), (28, 28, 256), (56, 56, 64))
)
TOKENS: Sizes = tuple(("tokens", size) for size in ((196, 128), (196, 256), (784, 128), (784, 256)))
OTHER: Sizes = (
    ("grid", (10, 10, 96)),
    ("grid", (13, 17, 100)),
    ("grid", (28, 28, 20)),
    ("grid", (31, 31, 64)),
    ("grid", (40, 28, 112)),
    ("grid", (64, 64, 32)),
    ("grid", (67, 67, 32)),
    ("grid", (96, 96, 3)),
    ("grid", (100, 100, 16)),
    ("tokens", (197, 256)),
    ("tokens", (100, 100)),
    ("tokens", (256, 256)),
    ("tokens", (300, 96)),
    ("sequence", (50, 64)),
    ("sequence", (96, 512)),
    ("sequence", (197, 32)),
    ("sequence", (200, 64)),
    ("sequence", (512, 128)),
    ("sequence", (720, 21)),
    ("sequence", (1024, 12)),
)
FEW_CHANNELS: Sizes = (
    ("sequence", (96, 7)),
    ("sequence", (336, 7)),
    ("sequence", (720, 7)),
    ("sequence", (1024, 3)),
    ("sequence", (1024, 5)),
    ("sequence", (512, 1)),
    ("tokens", (1000, 2)),
)
"""Fewer channels, or columns, than a vector has lanes; seven are common in time series."""
FEW_ROWS: Sizes = (
    ("tokens", (8, 256)),
    ("grid", (8, 256, 4)),
)
"""Fewer rows than a square of vectors, and no codelet or channels that fill vectors."""
FEW_TOKENS: Sizes = tuple(("tokens", size) for size in ((1, 96), (7, 7), (14, 14), (100, 5)))
"""So few points, and no codelets, that several images are filtered together."""
OVERHEAD_SIZE = (7, 7, 32)
"""Size at which the overhead of a call exceeds its arithmetic."""
OVERHEAD_BATCHES = (1, 33)
"""Two batch sizes whose difference gives the time of one image's arithmetic."""

LARGEST_MATRIX = 256
"""Largest side measured by matrix products; beyond it the matrices are larger than the data."""

BATCHES = (1, 8, 32)
LARGEST_BATCH = max(BATCHES)
MANY = 64
"""Batch of few tokens, which fills the vectors of every instruction set."""


@dataclass(frozen=True)
class Case:
    """A benchmark case on float32 ``x (batch, *size)``.

    Attributes:
        kind: ``"grid"`` with size (H, W, C), ``"tokens"`` (X, Y), ``"sequence"`` (L, C).
        size: Size of one image or sequence.
        batch: Number of images or sequences.
        work: ``"forward"`` without gradient; ``"forward+backward"``, with both gradients and a
            weight that has just changed; ``"recorded"``, a forward that records for a backward.
        threads: Number of threads of torch and of SciPy.
        contenders: Names of the contenders.
    """

    kind: Kind
    size: tuple[int, ...]
    batch: int
    work: Work = "forward"
    threads: int = 1
    contenders: tuple[str, ...] = (OURS, TORCH)

    @property
    def size_label(self) -> str:
        """Kind and size in words."""
        return f"{self.kind} {'×'.join(map(str, self.size))}"

    @property
    def label(self) -> str:
        """The case in words, without threads."""
        return f"{self.size_label}, batch {self.batch}, {self.work}"

    @property
    def group(self) -> str:
        """Group of cases over which a geometric mean is taken."""
        size = (self.kind, self.size)
        if size in GRID:
            return "grid, batch 1" if self.batch == 1 else "grid, batch 8 and 32"
        if size in FEW_CHANNELS:
            return "few channels"
        if size in FEW_ROWS:
            return "few rows"
        if size in FEW_TOKENS:
            return "few tokens"
        return "tokens" if size in TOKENS else "other sizes"

    @property
    def plane(self) -> tuple[int, int, int]:
        """Rows, columns and channels of the transform; a sequence is one row."""
        if self.kind == "tokens":
            return self.size[0], self.size[1], 1
        rows, columns, channels = (1, *self.size)[-3:]
        return rows, columns, channels

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Self:
        """Rebuild a case from JSON fields, which have lists for tuples."""
        of_tuples: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in fields.items()
        }
        return cls(**of_tuples)


def sweep(sizes: Sizes, batches: Sequence[int], threads: int) -> list[Case]:
    """Return cases of all sizes and batches, forward and forward+backward, against torch.fft.

    Channels come first too, where there are channels: tokens have one layout.
    """
    works: tuple[Work, ...] = ("forward", "forward+backward")
    layouts = dict.fromkeys(("grid", "sequence"), (OURS, TORCH, CHANNELS_FIRST))
    return [
        Case(kind, size, batch, work, threads, layouts.get(kind, (OURS, TORCH)))
        for kind, size in sizes
        for batch in batches
        for work in works
    ]


def overhead_cases() -> list[Case]:
    """Return cases dominated by overhead, without and with recording for a gradient."""
    works: tuple[Work, ...] = ("forward", "recorded")
    return [Case("grid", OVERHEAD_SIZE, n, work) for work in works for n in OVERHEAD_BATCHES]


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
    sizes = GRID + TOKENS + OTHER + FEW_CHANNELS + FEW_ROWS
    one_thread = sweep(sizes, BATCHES, 1) + sweep(FEW_TOKENS, (MANY,), 1)
    cases = [*with_rivals(one_thread, rivals), *overhead_cases()]
    for threads in sorted({2, cores()} if cores() > 1 else ()):
        cases += sweep(GRID + TOKENS, BATCHES, threads)
    if cores() == 1:
        notes = (*notes, "one core: two threads are not measured")
    by_isa = {best: cases}
    isas = (best,) if "FFPOSE_ISA" in os.environ else SLOWER[best]
    for isa in isas[1:]:
        is_scalar = isa == "scalar"
        by_isa[isa] = sweep(GRID + TOKENS, (1,), 1) if is_scalar else one_thread
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
        notes.append(
            f"{COMPILED}: channels first where there are channels; batch 1 alone, as each size is"
            " compiled anew"
        )
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
        MATRICES: one_of_few and max(case.plane[:2]) <= LARGEST_MATRIX,
        COMPILED: one_of_few and case.batch == 1 and COMPILED in rivals,
        HALF: in_tables and case.batch == LARGEST_BATCH,
        COPY: in_tables and case.batch == LARGEST_BATCH and forward and case.kind == "grid",
    }
    return tuple(name for name, takes_part in wanted.items() if takes_part)
