"""Timing of contenders that take turns, so that drift of the machine affects them alike.

`interleave` gives medians and quartiles of seconds per call, `take_turns` samples of single calls,
whose `percentiles` are latencies.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

OURS = "ffpose"
"""Name of our contender in tables and documents."""

FEWEST_ROUNDS = 5
MOST_ROUNDS = 15

WARM_UP = 0.05
"""Seconds of a contender's calls before it is timed."""

TURN = 4
"""Timed calls in a row; the call before them is not timed, as the threads of the contender before
may still wait actively for work, and as caches hold that contender's data."""

Sample = TypeVar("Sample")

FEWEST_TURNS = 3
MOST_TURNS = 50


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


def expect_place(path: Path | None) -> None:
    """Check, before anything is measured, that the folder of an output file exists.

    Raises:
        FileNotFoundError: The folder does not exist.
    """
    if path is not None and not path.parent.is_dir():
        raise FileNotFoundError(f"expected an existing folder for {path}, got {path.parent}")


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
    with _without_collection():
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
    with _without_collection():
        for _ in range(max(FEWEST_TURNS, min(MOST_TURNS, turns))):
            for name, measure in measures.items():
                measure()
                samples[name] += [measure() for _ in range(TURN)]
    return samples


def timed(call: Callable[[], object]) -> Callable[[], float]:
    """Return what runs ``call`` once and returns the seconds that it took."""
    return lambda: time_calls(Contender(call), 1)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch use ``count`` threads within the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Switch Python's garbage collection off within the block."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
