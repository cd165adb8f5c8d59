"""Latency from image file to pose by stages, and of a new process to its first pose."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from timeit import Timer
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.bench.timing import TURN, Latency, percentiles, take_turns
from ffpose.geometry import poses
from ffpose.imaging.images import read_rgb
from ffpose.inference.load import load
from ffpose.inference.source import Backend

ROOT = Path(__file__).parents[2]
"""The folder of the sources, where ``python -m benchmarks`` is found."""

STAGES = ("decode", "preprocessing", "network", "post")
TOTAL = "total"

IMAGE_SIZE = (960, 1280)
"""Rows and columns of the image file, as URSO's."""

NOISE = 3
"""Largest brightness that is added to a pixel of the image; noise sets how long PNG takes."""


@dataclass(frozen=True)
class Pipeline:
    """The steps from image to pose: to the input ``(3, h, w)``, to outputs by name."""

    preprocess: Callable[[Image.Image], NDArray[np.float32]]
    run: Callable[[NDArray[np.float32]], Mapping[str, NDArray[Any]]]

    @classmethod
    def of(cls, network: Path, threads: int | None = None) -> Pipeline:
        """Return that of a graph, or of weights: with as many threads as torch has, unless told."""
        estimator = load(network, threads=threads, device="cpu")
        return cls(estimator.preprocess, estimator.run)

    def times(self, path: Path) -> tuple[float, ...]:
        """Return the seconds of each of `STAGES` for an image file."""
        marks = [perf_counter()]
        image = read_rgb(path)
        marks.append(perf_counter())
        inputs = self.preprocess(image)[None]
        marks.append(perf_counter())
        outputs = self.run(inputs)
        marks.append(perf_counter())
        poses(**outputs, locates="object", in_view_threshold=None, degrees_of_freedom=None)
        marks.append(perf_counter())
        return tuple(after - before for before, after in pairwise(marks))


def measure_stages(
    pipelines: Mapping[str, Pipeline], path: Path, seconds: float
) -> dict[str, dict[str, Latency]]:
    """Measure pipelines in turn on an image file.

    Returns:
        By pipeline, the latencies of `STAGES` and of their `TOTAL`.
    """
    times: dict[str, list[tuple[float, ...]]] = {name: [] for name in pipelines}

    def run(name: str) -> None:
        times[name].append(pipelines[name].times(path))

    take_turns({name: Timer(partial(run, name)) for name in pipelines}, seconds)
    return {name: _latencies(_timed(each)) for name, each in times.items()}


def _timed(times: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Return the calls that `take_turns` times: not its first two, nor the first of each turn."""
    return [each for place, each in enumerate(times[2:]) if place % (TURN + 1)]


def _latencies(times: list[tuple[float, ...]]) -> dict[str, Latency]:
    by_stage = {stage: [each[place] for each in times] for place, stage in enumerate(STAGES)}
    by_stage[TOTAL] = [sum(each) for each in times]
    return {stage: percentiles(seconds) for stage, seconds in by_stage.items()}


def write_image(path: Path) -> None:
    """Write an image file of random patches and noise, PNG, always the same."""
    random = np.random.default_rng(0)
    rows, columns = IMAGE_SIZE
    patches = random.integers(0, 256 - NOISE, (rows // 80, columns // 80, 3), np.uint8)
    pixels = np.kron(patches, np.ones((80, 80, 1), np.uint8))
    pixels += random.integers(0, NOISE + 1, pixels.shape, np.uint8)
    Image.fromarray(pixels).save(path)


@dataclass(frozen=True)
class Start:
    """Arguments of `benchmarks.model.start`: a runtime's name, and the file it opens."""

    runtime: Backend
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
    words = [start.runtime, str(start.file.resolve()), str(image.resolve()), str(threads)]
    begin = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.model.start", *words],
        cwd=ROOT,
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
