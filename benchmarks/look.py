"""``python -m benchmarks look WEIGHTS [GRAPH]``: the slope and the time of a look at a known point.

The look is pointed off the true place by one and two predicted standard deviations along each of
their axes; the slope of the measured offset on the true one is 1 where the look does not follow its
pointing. Pointed at where a whole frame's pose is, its errors are compared with that pose's: the
ratios of the mean squares, of images where both poses are within `COMPARED`. The CPU time
of a frame with such a look is measured against that of a whole frame, alternately, on one thread:
in torch, or given a graph of ``ffpose export --track`` in ONNX Runtime.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose._internal.seeds import CHOICES
from ffpose.arrays import rotation_error
from ffpose.geometry import Pose
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.load import load
from ffpose.render.renderer import render

SEED = CHOICES.start + 35_000
SIZE = (512, 384)

COMPARED = (10.0, 0.1)
"""Errors up to which an image counts in the ratios, degrees and shares of the distance: a few that
are flips, or miss, would be most of a square."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command line."""
    parser.add_argument("weights", help="weights file, or a name")
    parser.add_argument("graph", nargs="?", type=Path, help="graph whose time is measured")
    parser.add_argument("--scenes", nargs="+", default=["soyuz_hard", "soyuz_easy"])
    parser.add_argument("--images", type=int, default=60, help="of each scene")
    parser.add_argument("--repeats", type=int, default=100, help="frames timed of each kind")


def run(options: argparse.Namespace) -> None:
    """Measure, and print the results as JSON."""
    estimator = load(options.weights, track=True, device="cpu", threads=1, warm_up=1)
    found: dict[str, object] = {}
    for scene in options.scenes:
        found[scene] = measured(estimator, scene, options.images)
    timed = estimator
    if options.graph is not None:
        timed = load(options.graph, track=True, threads=1, warm_up=3)
    found["milliseconds"] = milliseconds(timed, options.repeats)
    print(json.dumps(found, indent=1))


def measured(estimator: PoseEstimator, scene: str, images: int) -> dict[str, float]:
    """Return median slopes across the ray, along it and of all axes, and variance ratios."""
    rows, errors = [], []
    for index in range(images):
        frame = render(scene, SEED, index, SIZE)
        x = estimator.preprocess(Image.fromarray(frame.image))[None]
        rows += slopes(estimator, x, frame.pose)
        errors.append(errors_of_both(estimator, x, frame.pose))
    table = np.array(rows)
    along = table[:, 0] > 0.5
    named = {"across": ~along, "along": along, "all": np.full(len(table), True)}
    found = {name: float(np.median(table[rows, 1])) for name, rows in named.items()}
    both = np.array(errors)  # (images, whole and look, attitude and position)
    squares = np.square(both[(both < COMPARED).all(axis=(1, 2))]).mean(axis=0)
    ratios = (squares[1] / squares[0]).tolist()
    return found | dict(zip(("variance_of_attitude", "variance_of_position"), ratios, strict=True))


def errors_of_both(
    estimator: PoseEstimator, x: NDArray[np.float32], truth: Pose
) -> list[tuple[float, float]]:
    """Return the errors of a frame's pose and of a look there: degrees, shares of the distance."""
    (whole,) = estimator.estimate(x)
    (look,) = estimator.estimate(x, whole.t[None])
    distance = np.linalg.norm(truth.t)
    return [
        (
            float(rotation_error(pose.q[None], truth.q[None])[0]),
            float(np.linalg.norm(pose.t - truth.t) / distance),
        )
        for pose in (whole, look)
    ]


def slopes(
    estimator: PoseEstimator, x: NDArray[np.float32], truth: Pose
) -> list[tuple[float, float]]:
    """Return for each axis its cosine with the viewing ray and the slope of an image ``x``."""
    (whole,) = estimator.estimate(x)
    if whole.uncertainty is None:
        raise ValueError("weights: expected some with uncertainty, got some without")
    variances, axes = np.linalg.eigh(whole.uncertainty.translation_covariance)
    ray, found = truth.t / np.linalg.norm(truth.t), []
    for deviation, axis in zip(np.sqrt(variances), axes.T, strict=True):
        offsets = deviation * np.array([-2.0, -1.0, 1.0, 2.0])
        pointed = truth.t - offsets[:, None] * axis
        if (pointed[:, 2] <= 0).any():
            continue  # the network is so unsure that it may be behind the camera
        poses = estimator.estimate(x.repeat(4, 0), pointed)
        measured = [(pose.t - point) @ axis for pose, point in zip(poses, pointed, strict=True)]
        found.append((abs(float(axis @ ray)), float(np.polyfit(offsets, measured, 1)[0])))
    return found


def milliseconds(estimator: PoseEstimator, repeats: int) -> dict[str, float]:
    """Return median CPU times of a whole frame and of a look, and their ratio."""
    x = np.zeros((1, 3, *estimator.preprocessing.size), np.float32)
    point = np.array([[0.0, 0.0, 15.0]])

    def timed(call: Callable[[], object]) -> float:
        begin = time.process_time()
        call()
        return 1e3 * (time.process_time() - begin)

    pairs = [
        (timed(lambda: estimator.run(x)), timed(lambda: estimator.run(x, point)))
        for _ in range(repeats)
    ]
    whole, look = (float(np.median(each)) for each in zip(*pairs, strict=True))
    return {"whole": whole, "look": look, "ratio": look / whole}
