"""Cases of `ffpose bench filter`: sizes, batches, work, threads, and contenders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

Kind = Literal["grid", "tokens", "sequence"]
Work = Literal["forward", "forward+backward", "recorded"]
Sizes = tuple[tuple[Kind, tuple[int, ...]], ...]

OURS = "ffpose"
HALF = "ffpose bfloat16"
TORCH = "torch.fft"
COMPILED = "torch.compile"
SCIPY = "scipy.fft"
MATRICES = "matrices"
COPY = "copy"

GRID: Sizes = tuple(
    ("grid", size)
    for size in ((7, 7, 512), (14, 14, 256), (14, 14, 384), (28, 28, 256), (56, 56, 64))
)
TOKENS: Sizes = tuple(("tokens", size) for size in ((196, 128), (196, 256), (784, 128), (784, 256)))
OTHER: Sizes = (
    ("grid", (10, 10, 96)),
    ("grid", (13, 17, 100)),
    ("grid", (31, 31, 64)),
    ("grid", (40, 28, 112)),
    ("grid", (64, 64, 32)),
    ("grid", (100, 100, 16)),
    ("tokens", (197, 256)),
    ("tokens", (100, 100)),
    ("tokens", (256, 256)),
    ("sequence", (50, 64)),
    ("sequence", (96, 512)),
    ("sequence", (200, 64)),
    ("sequence", (512, 128)),
)
FEW_CHANNELS: Sizes = (
    ("sequence", (96, 7)),
    ("sequence", (336, 7)),
    ("sequence", (720, 7)),
    ("sequence", (1024, 3)),
    ("sequence", (512, 1)),
    ("tokens", (1000, 2)),
)
"""Fewer channels, or columns, than a vector has lanes; seven are common in time series."""
FEW: Sizes = (("grid", (14, 14, 256)), ("tokens", (196, 256)), ("sequence", (50, 64)))
"""One size of each kind: all that ``--quick`` measures, and those with every rival."""

OVERHEAD_SIZE = (7, 7, 32)
"""Size at which the overhead of a call exceeds its arithmetic."""
OVERHEAD_BATCHES = (1, 33)
"""Two batch sizes whose difference gives the time of one image's arithmetic."""

BATCHES = (1, 8, 32)
LARGEST_BATCH = max(BATCHES)


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
    """Return cases of all sizes and batches, forward and forward+backward, against torch.fft."""
    works: tuple[Work, ...] = ("forward", "forward+backward")
    return [
        Case(kind, size, batch, work, threads)
        for kind, size in sizes
        for batch in batches
        for work in works
    ]


def overhead_cases() -> list[Case]:
    """Return cases dominated by overhead, without and with recording for a gradient."""
    works: tuple[Work, ...] = ("forward", "recorded")
    return [Case("grid", OVERHEAD_SIZE, n, work) for work in works for n in OVERHEAD_BATCHES]
