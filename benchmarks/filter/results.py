"""Comparisons merged from several processes, and what follows: means, operations, traffic."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import geometric_mean

from benchmarks.filter.cases import (
    CHANNELS_FIRST,
    COPY,
    HALF,
    OVERHEAD_BATCHES,
    OVERHEAD_SIZE,
    TORCH,
    Case,
    Work,
)
from benchmarks.filter.children import Setting
from benchmarks.filter.worker import Measurement
from benchmarks.timing import Timing
from ffpose.bench.filter import OURS

WORTH_TWO_THREADS = 200e-6
"""Least duration of a call, in seconds, for which a second thread should help."""


@dataclass(frozen=True)
class Comparison:
    """Timings of a case with one instruction set, by allocator, then by contender."""

    isa: str
    case: Case
    timings: Mapping[str, Mapping[str, Timing]]
    largest_difference: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contenders."""
        return self.case.contenders

    def best(self, name: str) -> Timing:
        """Return a contender's timing with its faster allocator."""
        return min((each[name] for each in self.timings.values()), key=lambda each: each.median)

    def ratio(self, rival: str = TORCH) -> float:
        """Return our speedup over a rival, each with its faster allocator."""
        return self.best(rival).median / self.best(OURS).median

    def best_layout_ratio(self) -> float:
        """Return our speedup over torch.fft on data that lie as suits it best."""
        layouts = {TORCH, CHANNELS_FIRST} & set(self.names)
        return min(self.ratio(name) for name in layouts)

    def default_ratio(self, rival: str = TORCH) -> float:
        """Return our speedup over a rival with the default allocator."""
        timings = self.timings["default"]
        return timings[rival].median / timings[OURS].median


@dataclass(frozen=True)
class GroupMean:
    """Geometric mean and minimum of the ratios to torch.fft in one group.

    Attributes:
        isa: Our instruction set.
        threads: Number of threads.
        group: `Case.group`.
        work: `Case.work`.
        mean: Geometric mean of the ratios to torch.fft on data that lie as ours.
        worst: The comparison of the smallest.
        best_layout_mean: The same, each case with the layout that suits torch.fft best.
        best_layout_worst: The comparison of the smallest of those.
    """

    isa: str
    threads: int
    group: str
    work: Work
    mean: float
    worst: Comparison
    best_layout_mean: float
    best_layout_worst: Comparison


@dataclass(frozen=True)
class Overhead:
    """Seconds of a call with one small image, of its arithmetic, and of torch.fft's call."""

    work: Work
    call: float
    arithmetic: float
    torch_call: float


def bring_together(measured: Iterable[tuple[Setting, Measurement]]) -> list[Comparison]:
    """Merge measurements into one comparison per instruction set and case, in order."""
    found: dict[tuple[str, Case], Comparison] = {}
    for setting, one in measured:
        key = setting.isa, one.case
        known = found.get(key) or Comparison(setting.isa, one.case, {}, 0.0)
        found[key] = replace(
            known,
            timings={**known.timings, setting.allocator: one.timings},
            largest_difference=max(known.largest_difference, one.largest_difference),
        )
    return list(found.values())


def in_tables(comparisons: Iterable[Comparison]) -> list[Comparison]:
    """Return the comparisons that enter the means: all except the overhead cases."""
    return [each for each in comparisons if each.case.size != OVERHEAD_SIZE]


def group_means(comparisons: Iterable[Comparison]) -> list[GroupMean]:
    """Return the mean for each instruction set, number of threads, group and work."""
    groups: dict[tuple[str, int, str, Work], list[Comparison]] = {}
    for each in in_tables(comparisons):
        key = each.isa, each.case.threads, each.case.group, each.case.work
        groups.setdefault(key, []).append(each)
    return [
        GroupMean(
            *key,
            geometric_mean(each.ratio() for each in group),
            min(group, key=Comparison.ratio),
            geometric_mean(each.best_layout_ratio() for each in group),
            min(group, key=Comparison.best_layout_ratio),
        )
        for key, group in groups.items()
    ]


def over_copy(comparisons: Iterable[Comparison]) -> list[tuple[Comparison, float]]:
    """Return the filter's time relative to a copy of x, where that was measured."""
    return [(each, 1 / each.ratio(COPY)) for each in comparisons if COPY in each.names]


def half_over_single(comparisons: Iterable[Comparison]) -> list[tuple[Comparison, float]]:
    """Return the time of bfloat16 relative to float32, where that was measured."""
    return [(each, each.ratio(HALF)) for each in comparisons if HALF in each.names]


def gains_of_threads(comparisons: Sequence[Comparison]) -> list[tuple[Comparison, float]]:
    """Return the speedup of each case with several threads over one thread.

    Cases shorter than `WORTH_TWO_THREADS` are left out.
    """
    alone = {(each.isa, each.case.label): each for each in comparisons if each.case.threads == 1}
    gains = []
    for each in comparisons:
        single = alone.get((each.isa, each.case.label))
        if each.case.threads > 1 and single is not None:
            seconds = single.best(OURS).median
            if seconds > WORTH_TWO_THREADS:
                gains.append((each, seconds / each.best(OURS).median))
    return gains


def overheads(comparisons: Iterable[Comparison]) -> list[Overhead]:
    """Return the overhead of small calls.

    Calls with one image and with many differ only in arithmetic, so their difference gives the
    arithmetic of one image.
    """
    small = {
        (each.case.work, each.case.batch): each
        for each in comparisons
        if each.case.size == OVERHEAD_SIZE
    }
    one, many = OVERHEAD_BATCHES
    found = []
    for (work, batch), each in small.items():
        if batch == one:
            call = each.best(OURS).median
            rest = small[work, many].best(OURS).median - call
            arithmetic = rest / (many - one)
            found.append(Overhead(work, call, arithmetic, each.best(TORCH).median))
    return found


FLOAT = 4


def operations(case: Case) -> float:
    """Return the nominal operations of a call, by the convention of FFT benchmarks.

    A transform of N real points counts as ``2.5 N log2 N``, regardless of the algorithm, and a
    complex product as 6. A forward is two transforms and one product for each element of the half
    spectrum; a backward is two more transforms (recomputation is not counted), one product for x,
    and one with a sum (8) for the weight.
    """
    rows, columns, channels = case.plane
    images = case.batch * channels
    points, spectrum = rows * columns, rows * (columns // 2 + 1)
    transform = 2.5 * points * math.log2(points) if points > 1 else 0.0
    if case.work == "forward+backward":
        return images * (4 * transform + (6 + 6 + 8) * spectrum)
    return images * (2 * transform + 6 * spectrum)


def traffic(case: Case) -> int:
    """Return the least bytes that a call moves: inputs read once, results written once.

    Forward: x, weight and y. Forward+backward: for the backward also the gradient, x and weight
    again, and both gradients.
    """
    rows, columns, channels = case.plane
    image = FLOAT * case.batch * rows * columns * channels
    weight = FLOAT * 2 * rows * (columns // 2 + 1) * channels
    if case.work == "forward+backward":
        return 5 * image + 3 * weight
    return 2 * image + weight
