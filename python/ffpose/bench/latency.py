"""Latency of single calls, as percentiles, of contenders that take turns."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ffpose.bench.timing import Contender, time_calls

TURN = 4
"""Timed calls in a row; the call before them is not timed, as the threads of the contender before
may still wait actively for work, and as caches hold that contender's data."""

Sample = TypeVar("Sample")

FEWEST_TURNS = 3
MOST_TURNS = 50


@dataclass(frozen=True)
class Latency:
    """Percentiles of the seconds of a call, over `calls` calls."""

    p50: float
    p95: float
    p99: float
    calls: int


def percentiles(seconds: list[float]) -> Latency:
    """Return the percentiles of at least one sample, with linear interpolation."""
    p50, p95, p99 = (float(value) for value in np.percentile(seconds, (50, 95, 99)))
    return Latency(p50, p95, p99, len(seconds))


def take_turns(
    measures: Mapping[str, Callable[[], Sample]], seconds: float
) -> dict[str, list[Sample]]:
    """Call contenders in turn, `TURN` times in a row each.

    Args:
        measures: By name, what runs a contender once and returns what it measured (`timed`).
        seconds: Time to spend on each, on average; more where `FEWEST_TURNS` take longer.

    Returns:
        What was measured, by name.

    Raises:
        ValueError: ``measures`` is empty.
    """
    if not measures:
        raise ValueError("expected at least 1 contender, got none")
    for measure in measures.values():
        measure()  # memory and plans of the first call
    once = sum(time_calls(Contender(measure), 1) for measure in measures.values())
    turns = int(seconds * len(measures) / ((TURN + 1) * once))
    samples: dict[str, list[Sample]] = {name: [] for name in measures}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(max(FEWEST_TURNS, min(MOST_TURNS, turns))):
            for name, measure in measures.items():
                measure()
                samples[name] += [measure() for _ in range(TURN)]
    finally:
        if collecting:
            gc.enable()
    return samples


def timed(call: Callable[[], object]) -> Callable[[], float]:
    """Return what runs ``call`` once and returns the seconds that it took."""
    return lambda: time_calls(Contender(call), 1)
