"""Timing of contenders that take turns, so that drift of the machine affects them alike.

`take_turns` gives samples of single calls, whose `percentiles` are latencies.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ffpose._internal.figures import new_figure, save_figure, style_axes

OURS = "ffpose"
"""Name of our contender in tables and documents."""

TURN = 4
"""Timed calls in a row; the call before them is not timed, as the threads of the contender before
may still wait actively for work, and as caches hold that contender's data."""

Sample = TypeVar("Sample")

FEWEST_TURNS = 3
MOST_TURNS = 50


def expect_place(path: Path | None) -> None:
    """Check, before anything is measured, that the folder of an output file exists.

    Raises:
        FileNotFoundError: The folder does not exist.
    """
    if path is not None and not path.parent.is_dir():
        raise FileNotFoundError(f"expected an existing folder for {path}, got {path.parent}")


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
    once = sum(timed(measure)() for measure in measures.values())
    turns = int(seconds * len(measures) / ((TURN + 1) * once))
    samples: dict[str, list[Sample]] = {name: [] for name in measures}
    with without_collection():
        for _ in range(max(FEWEST_TURNS, min(MOST_TURNS, turns))):
            for name, measure in measures.items():
                measure()
                samples[name] += [measure() for _ in range(TURN)]
    return samples


def timed(
    call: Callable[[], object], prepare: Callable[[], object] | None = None
) -> Callable[[], float]:
    """Return what runs ``call`` once and returns its seconds, after an untimed ``prepare``."""

    def run() -> float:
        if prepare is not None:
            prepare()
        start = time.perf_counter()
        call()
        return time.perf_counter() - start

    return run


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


def draw_bars(
    path: Path, bars: Mapping[str, float], title: str, ends: Sequence[float] = ()
) -> None:
    """Write a PNG file of named horizontal bars, each with a line up to its end if it has one."""
    figure = new_figure(7.0, 1.2 + 0.3 * len(bars))
    axes = figure.subplots()
    lengths = list(bars.values())
    above = [end - length for end, length in zip(ends, lengths, strict=True)] if ends else None
    axes.barh(list(bars), lengths, xerr=above and [[0.0] * len(bars), above])
    axes.invert_yaxis()
    axes.set_title(title)
    style_axes(axes, "x")
    save_figure(figure, path, format="png")
