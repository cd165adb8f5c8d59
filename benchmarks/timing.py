"""Medians and quartiles of calls so short that many are timed together, of contenders in turn."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

FEWEST_ROUNDS = 5
MOST_ROUNDS = 15

WARM_UP = 0.05
"""Seconds of a contender's calls before it is timed."""


@dataclass(frozen=True)
class Contender:
    """A timed call, and the untimed preparation before each call."""

    call: Callable[[], object]
    prepare: Callable[[], object] | None = None


@dataclass(frozen=True)
class Timing:
    """Seconds per call: median and quartiles over `rounds` rounds of `inner` calls each."""

    median: float
    lower: float
    upper: float
    rounds: int
    inner: int


def interleave(
    contenders: Mapping[str, Contender], seconds: float, warmup_seconds: float = WARM_UP
) -> dict[str, Timing]:
    """Time contenders in turn, A B A B ….

    Args:
        contenders: Contenders by name.
        seconds: Time to spend on each, without warm-up; more where `FEWEST_ROUNDS` calls of the
            slowest contender take longer.
        warmup_seconds: Duration of each contender's warm-up, whose fastest call determines the
            number of calls per round.

    Returns:
        The `Timing` of each contender, by name.

    Raises:
        ValueError: ``contenders`` is empty.
    """
    if not contenders:
        raise ValueError("expected at least 1 contender, got none")
    fastest = {name: _warm_up(each, warmup_seconds) for name, each in contenders.items()}
    slowest = max(fastest.values())
    rounds = max(FEWEST_ROUNDS, min(MOST_ROUNDS, int(seconds / slowest)))
    inner = {name: max(1, int(seconds / rounds / each)) for name, each in fastest.items()}
    samples: dict[str, list[float]] = {name: [] for name in contenders}
    with without_collection():
        for _ in range(rounds):
            for name, contender in contenders.items():
                samples[name].append(time_calls(contender, inner[name]))
    return {name: summarize(values, inner[name]) for name, values in samples.items()}


def time_calls(contender: Contender, count: int) -> float:
    """Return the mean seconds per call over ``count`` calls."""
    if contender.prepare is None:
        start = time.perf_counter()
        for _ in range(count):
            contender.call()
        return (time.perf_counter() - start) / count
    total = 0.0
    for _ in range(count):
        contender.prepare()
        start = time.perf_counter()
        contender.call()
        total += time.perf_counter() - start
    return total / count


def summarize(values: Sequence[float], inner: int) -> Timing:
    """Return median and quartiles of at least two samples, with linear interpolation."""
    lower, median, upper = statistics.quantiles(values, n=4, method="inclusive")
    return Timing(median, lower, upper, len(values), inner)


def _warm_up(contender: Contender, seconds: float) -> float:
    """Call for ``seconds``, at least twice, and return the time of the fastest call."""
    end = time.perf_counter() + seconds
    fastest = time_calls(contender, 1)
    while True:
        fastest = min(fastest, time_calls(contender, 1))
        if time.perf_counter() >= end:
            return fastest


@contextmanager
def without_collection() -> Iterator[None]:
    """Switch Python's garbage collection off within the block."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
