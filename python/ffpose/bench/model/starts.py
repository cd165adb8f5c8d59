"""Cold start: a new process, from its start to its first pose, and its peak memory."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ffpose.bench.model.start import Runtime


@dataclass(frozen=True)
class Start:
    """Arguments of `ffpose.bench.model.start`: a runtime's name, and the file it opens."""

    runtime: Runtime
    file: Path


@dataclass(frozen=True)
class ColdStart:
    """Medians over `runs` processes.

    Attributes:
        seconds: From start to first pose; the files are in the system's cache.
        peak_bytes: Largest resident size.
        runs: Number of processes.
    """

    seconds: float
    peak_bytes: float
    runs: int


def measure_starts(
    starts: Mapping[str, Start], image: Path, threads: int, runs: int
) -> dict[str, ColdStart]:
    """Start processes in turn, after one of each that fills the system's cache.

    Raises:
        RuntimeError: A process failed; the message holds its last line of output.
    """
    samples: dict[str, list[tuple[float, int]]] = {name: [] for name in starts}
    for run in range(runs + 1):
        for name, start in starts.items():
            sample = _once(name, start, image, threads)
            if run > 0:
                samples[name].append(sample)
    return {name: _medians(values) for name, values in samples.items()}


def _once(name: str, start: Start, image: Path, threads: int) -> tuple[float, int]:
    """Return seconds to the first pose, and peak bytes, of one process."""
    words = [start.runtime, str(start.file), str(image), str(threads)]
    begin = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "ffpose.bench.model.start", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdout is not None
        line = child.stdout.readline()
        seconds = time.perf_counter() - begin
        _, errors = child.communicate()
    if child.returncode != 0:
        last = (errors.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"the process of {name} failed: {last}")
    return seconds, json.loads(line)["peak"]


def _medians(samples: Sequence[tuple[float, int]]) -> ColdStart:
    seconds, peaks = zip(*samples, strict=True)
    return ColdStart(statistics.median(seconds), statistics.median(peaks), len(samples))
