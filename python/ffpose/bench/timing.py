"""Timing of contenders that take turns, so that drift of the machine affects them alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from timeit import Timer

import numpy as np

FEWEST_TURNS, MOST_TURNS = 3, 50

TURN = 4
"""Timed calls in a row; the call before them is not timed, as the threads of the contender before
may still wait actively for work, and as caches hold that contender's data."""


@dataclass(frozen=True)
class Latency:
    """Percentiles of the seconds of a call, over `calls` calls."""

    p50: float
    p95: float
    p99: float
    calls: int


def percentiles(seconds: list[float]) -> Latency:
    """Return the percentiles of at least one sample, with linear interpolation."""
    p50, p95, p99 = np.percentile(seconds, (50, 95, 99)).tolist()
    return Latency(p50, p95, p99, len(seconds))


def take_turns(contenders: Mapping[str, Timer], seconds: float) -> dict[str, Latency]:
    """Time single calls of contenders in turn, each for so many seconds on average."""
    for timer in contenders.values():
        timer.timeit(1)  # memory and plans of the first call
    once = sum(timer.timeit(1) for timer in contenders.values())
    turns = int(seconds * len(contenders) / ((TURN + 1) * once))
    samples: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(max(FEWEST_TURNS, min(MOST_TURNS, turns))):
        for name, timer in contenders.items():
            timer.timeit(1)
            samples[name] += timer.repeat(TURN, 1)
    return {name: percentiles(times) for name, times in samples.items()}
