"""Measurements of several processes brought together, and what follows from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ffpose.bench.cases import COPY, HALF, OURS, OVERHEAD_BATCHES, OVERHEAD_SIZE, TORCH, Case, Work
from ffpose.bench.children import Setting
from ffpose.bench.figures import geometric_mean
from ffpose.bench.measure import Measurement
from ffpose.bench.timing import Timing

WORTH_TWO_THREADS = 200e-6
"""Seconds of work from which on a second thread should help."""


@dataclass(frozen=True)
class Comparison:
    """A case with one instruction set; its timings by allocator, then by contender."""

    isa: str
    case: Case
    timings: Mapping[str, Mapping[str, Timing]]
    largest_difference: float

    @property
    def names(self) -> tuple[str, ...]:
        """Those that took part."""
        return self.case.contenders

    def best(self, name: str) -> Timing:
        """Return a contender's timing with the allocator that suits it better."""
        return min((each[name] for each in self.timings.values()), key=lambda each: each.median)

    def ratio(self, rival: str = TORCH) -> float:
        """Return how many times faster than a rival ours is, each with its better allocator."""
        return self.best(rival).median / self.best(OURS).median

    def default_ratio(self, rival: str = TORCH) -> float:
        """Return how many times faster ours is where nobody chose an allocator."""
        timings = self.timings["default"]
        return timings[rival].median / timings[OURS].median


@dataclass(frozen=True)
class GroupMean:
    """The geometric mean of the ratios to torch.fft in one group, and the worst of them."""

    isa: str
    threads: int
    group: str
    work: Work
    mean: float
    worst: Comparison


@dataclass(frozen=True)
class Overhead:
    """A call of one small image: seconds of it, of its arithmetic, and of torch.fft's call."""

    work: Work
    call: float
    arithmetic: float
    torch_call: float


def bring_together(measured: Iterable[tuple[Setting, Measurement]]) -> list[Comparison]:
    """Return one comparison for each instruction set and case, in the order of measuring."""
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
    """Return those that count for the means: all but the calls that are measured for overhead."""
    return [each for each in comparisons if each.case.size != OVERHEAD_SIZE]


def group_means(comparisons: Iterable[Comparison]) -> list[GroupMean]:
    """Return the mean of each instruction set, number of threads, group and work."""
    groups: dict[tuple[str, int, str, Work], list[Comparison]] = {}
    for each in in_tables(comparisons):
        key = each.isa, each.case.threads, each.case.group, each.case.work
        groups.setdefault(key, []).append(each)
    return [
        GroupMean(*key, geometric_mean(each.ratio() for each in group), min(group, key=_ratio))
        for key, group in groups.items()
    ]


def _ratio(comparison: Comparison) -> float:
    return comparison.ratio()


def over_copy(comparisons: Iterable[Comparison]) -> list[tuple[Comparison, float]]:
    """Return how many times longer than a copy of x the filter takes, where that was measured."""
    return [(each, 1 / each.ratio(COPY)) for each in comparisons if COPY in each.names]


def half_over_single(comparisons: Iterable[Comparison]) -> list[tuple[Comparison, float]]:
    """Return how many times longer bfloat16 takes than float32, where that was measured."""
    return [(each, each.ratio(HALF)) for each in comparisons if HALF in each.names]


def gains_of_threads(comparisons: Sequence[Comparison]) -> list[tuple[Comparison, float]]:
    """Return how many times faster each case of several threads is than with one.

    Cases of less than `WORTH_TWO_THREADS` are left out.
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
    """Return what small calls cost.

    A call of one image and a call of many differ by arithmetic alone, which gives that of one.
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
