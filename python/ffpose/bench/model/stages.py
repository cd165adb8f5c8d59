"""From an image file to a pose, split into decode, preprocessing, network and post-processing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from ffpose.bench.latency import Latency, percentiles, take_turns
from ffpose.geometry import poses
from ffpose.images import read_rgb
from ffpose.onnx.runtime import PoseEstimator
from ffpose.predictor import Predictor

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
    def of_graph(cls, graph: Path, threads: int) -> Pipeline:
        """Return that of a graph in ONNX Runtime."""
        estimator = PoseEstimator(graph, threads=threads)
        return cls(estimator.preprocess, estimator.run)

    @classmethod
    def of_weights(cls, weights: Path) -> Pipeline:
        """Return that of weights in torch, with as many threads as torch has."""
        predictor = Predictor.from_weights(weights)

        def run(inputs: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
            with torch.inference_mode():
                prediction = predictor.model(torch.from_numpy(inputs))
            return {name: values.numpy() for name, values in prediction._asdict().items()}

        return cls(predictor.preprocessing.array, run)

    def times(self, path: Path) -> tuple[float, ...]:
        """Return the seconds of each of `STAGES` for an image file."""
        marks = [perf_counter()]
        image = read_rgb(path)
        marks.append(perf_counter())
        inputs = self.preprocess(image)[None]
        marks.append(perf_counter())
        outputs = self.run(inputs)
        marks.append(perf_counter())
        poses(**outputs)
        marks.append(perf_counter())
        return tuple(after - before for before, after in pairwise(marks))


def measure_stages(
    pipelines: Mapping[str, Pipeline], path: Path, seconds: float
) -> dict[str, dict[str, Latency]]:
    """Measure pipelines in turn on an image file.

    Returns:
        By pipeline, the latencies of `STAGES` and of their `TOTAL`.
    """
    measures = {name: partial(pipeline.times, path) for name, pipeline in pipelines.items()}
    return {name: _latencies(times) for name, times in take_turns(measures, seconds).items()}


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
