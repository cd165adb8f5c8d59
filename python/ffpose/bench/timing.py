"""Interleaved timing: rivals take turns in one run, so that a machine's drift hits them alike."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Seconds a call: the median and the quartiles over `rounds` turns of `inner` calls each."""

    median: float
    lower: float
    upper: float
    rounds: int
    inner: int


def interleave(
    rivals: Mapping[str, Callable[[], object]],
    seconds: float = 0.5,
    rounds: int = 15,
    warmup_seconds: float = 0.05,
) -> dict[str, Timing]:
    """Times rivals in turn, A B A B …, and gives each its median seconds a call.

    Args:
        rivals: what to time, by name; each is called without arguments.
        seconds: time to spend on each rival, warm-up not counted.
        rounds: turns of each rival; at least 3.
        warmup_seconds: time to spend on each rival first; its last call sizes the turns.

    Returns:
        One `Timing` for each rival, under its name.

    Raises:
        ValueError: with no rival or fewer than 3 rounds.
    """
    if not rivals or rounds < 3:
        raise ValueError(
            f"expected at least 1 rival and 3 rounds, got {len(rivals)} rivals and {rounds} rounds"
        )
    inner = {
        name: max(1, int(seconds / rounds / _warm_up(call, warmup_seconds)))
        for name, call in rivals.items()
    }
    samples: dict[str, list[float]] = {name: [] for name in rivals}
    collecting = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, call in rivals.items():
                samples[name].append(_time_calls(call, inner[name]))
    finally:
        if collecting:
            gc.enable()
    return {name: _summarise(values, inner[name]) for name, values in samples.items()}


def _warm_up(call: Callable[[], object], seconds: float) -> float:
    """Calls until `seconds` are over (at least twice) and returns the fastest call's time."""
    end = time.perf_counter() + seconds
    fastest = _time_calls(call, 1)
    while True:
        fastest = min(fastest, _time_calls(call, 1))
        if time.perf_counter() >= end:
            return fastest


def _time_calls(call: Callable[[], object], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count


def _summarise(values: list[float], inner: int) -> Timing:
    lower, median, upper = statistics.quantiles(values, n=4, method="inclusive")
    return Timing(median, lower, upper, len(values), inner)
