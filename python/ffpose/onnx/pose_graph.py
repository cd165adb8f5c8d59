"""``ffpose export``: the network of a weights file as an ONNX graph that knows what it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from ffpose._internal.files import sha256
from ffpose._internal.zoo import resolve
from ffpose.config import NetworkConfig, PolarPoseConfig, looks_twice
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import PolarPose, PosePrediction, WeightsMetadata, open_weights
from ffpose.models.base import UncertainPose
from ffpose.models.polar_pose import NearPoint
from ffpose.onnx.exporter import (
    Exported,
    FilterChoice,
    Outputs,
    Say,
    relative_differences,
    write_graph,
)
from ffpose.onnx.metadata import Filter, ModelMetadata

BATCHES = (2, 1, 3)
"""Sizes of the batches that graph and network are compared on; the first is exported with."""

PATCHES = 8
"""Number of patches along each side of a random image."""

SHARE = 4
"""The shorter side of a random image over that of the square."""

EDGE = 0.005
"""Probability of the few bins at the edge of a mode, which belong to it or not by a rounding."""


def export_weights(
    weights: str | Path,
    path: str | Path,
    filter: FilterChoice = "custom",
    *,
    takes_point: bool = False,
    track_sha256: str | None = None,
    say: Say = lambda _: None,
    **fields: Any,
) -> Exported:
    """Write the network of a weights file, or of a name, as an ONNX graph for `ffpose.load`.

    ``takes_point``: the single look at points that a track expects the object at
    (`ffpose.models.PolarPose.predict_near`); that of ``X.onnx`` is ``X.track.onnx``, and
    ``track_sha256``, of its file, is what ``X.onnx`` knows it by. ``fields`` of the network are
    changed as in `ffpose.models.load_network`; the rest is as of `ffpose.onnx.export`.

    Raises:
        FileNotFoundError: No such weights, or the operator's library is not installed.
        ValueError: An unknown filter or field, or the network cannot look at a point.
        RuntimeError: Graph and network differ by more than rounding.
        ffpose.DataError: The weights cannot be used.
    """
    expect_graph_name(path)
    network, source = open_weights(weights, **fields)
    module: nn.Module = network
    batches: list[tuple[torch.Tensor, ...]] = [
        (random_images(source.preprocessing, count),) for count in BATCHES
    ]
    if takes_point:
        if not isinstance(network, PolarPose):
            raise ValueError(
                "track: expected weights of a PolarPose, which can look at a point, got those of a"
                f" {network.config.architecture}"
            )
        module = NearPoint(network).eval()
        batches = [(*each, _middles(network.config, len(each[0]))) for each in batches]
    return write_graph(
        module,
        batches,
        path,
        filter,
        graph_entries(
            weights, source, takes_point=takes_point, track_sha256=track_sha256, **fields
        ),
        partial(pose_differences, doubt_sigma=doubt_growth(network.config)),
        input_names=["images", "point"] if takes_point else ["images"],
        output_names=output_names(source.config),
        say=say,
    )


def _middles(config: PolarPoseConfig, count: int) -> torch.Tensor:
    """Return points ``(count, 3)`` on the boresight, where `random_images` have their patches."""
    near, far = config.distance_m
    depths = torch.linspace(near, (near * far) ** 0.5, count)
    return torch.stack([torch.zeros(count), torch.zeros(count), depths], dim=1)


def graph_entries(
    weights: str | Path,
    source: WeightsMetadata,
    *,
    takes_point: bool = False,
    track_sha256: str | None = None,
    **fields: Any,
) -> Callable[[Filter], dict[str, str]]:
    """Return what gives the metadata of a graph of these weights, for how it computes filters."""
    described = ModelMetadata(
        source.config.at_inference(fields),
        source.preprocessing,
        "none",
        source.camera,
        source.in_view_threshold,
        sha256(resolve(weights)),
        locates=source.locates,
        undistorted=source.undistorted,
        distortion=source.distortion,
        white=source.white,
        takes_point=takes_point,
        track_sha256=track_sha256,
        tracking=source.tracking,
        symmetry=source.symmetry,
    )
    return lambda kind: replace(described, filter=kind).to_entries()


def output_names(config: NetworkConfig) -> list[str]:
    """Return the names of a network's outputs, in order."""
    return list((UncertainPose if looks_twice(config) else PosePrediction)._fields)


def random_images(preprocessing: Preprocessing, count: int) -> torch.Tensor:
    """Return standardized images of random patches amid black, ``(count, 3, h, w)``.

    Something to look at twice, in its place. Where there is nothing, such as on random pixels, a
    network that looks twice loses up to three of float32's digits, in torch as in any runtime
    (against float64), and a graph could not be told from a wrong one.
    """
    height, width = preprocessing.size
    side = max(min(height, width) // SHARE // PATCHES, 1)
    colors = np.random.default_rng(count).random((count, 3, PATCHES, PATCHES), np.float32)
    patches = np.kron(colors, np.ones((side, side), np.float32))
    pixels = np.zeros((count, 3, height, width), np.float32)
    top, left = (height - patches.shape[2]) // 2, (width - patches.shape[3]) // 2
    pixels[:, :, top : top + patches.shape[2], left : left + patches.shape[3]] = patches
    mean, std = np.array((preprocessing.mean, preprocessing.std), np.float32)[:, :, None, None]
    return torch.from_numpy((pixels - mean) / std)


def expect_graph_name(path: str | Path) -> None:
    """Refuse a name by which the file would not be taken for a graph."""
    if Path(path).suffix != ".onnx":
        raise ValueError(f"out: expected a file that ends in .onnx, got {path}")


def doubt_growth(config: NetworkConfig) -> tuple[float, float]:
    """Return a network's ``doubt_sigma``, zeros of one without uncertainty."""
    return config.doubt_sigma if looks_twice(config) else (0.0, 0.0)


def pose_differences(
    got: Outputs, expected: Outputs, doubt_sigma: tuple[float, float] = (0.0, 0.0)
) -> dict[str, float]:
    """Return the largest differences: meters, of quaternions of one sign, and relative ones.

    Those of covariances are halved, to be those of the standard deviations, and those of the
    probabilities of modes are beyond `EDGE`: a network that has hardly learned has bins there.
    Covariances are compared without the growth by the doubt of the first mode, of which the
    network's calibration says how much (`ffpose.models.second_look.calibrated`).
    """
    quaternions = ("orientation", "alternative") if "alternative" in expected else ("orientation",)
    aligned, expected = _without_doubt(got, doubt_sigma), _without_doubt(expected, doubt_sigma)
    for name in quaternions:
        sign = np.sign((got[name] * expected[name]).sum(-1, keepdims=True))
        aligned[name] = got[name] * sign
    absolute = {
        name: float(np.abs(aligned[name] - expected[name]).max())
        for name in ("translation", *quaternions)
    }
    relative = {
        name: value / 2 if name.endswith("_covariance") else value
        for name, value in relative_differences(aligned, expected).items()
    }
    if "probabilities" in relative:
        relative["probabilities"] = max(relative["probabilities"] - EDGE, 0.0)
    return relative | absolute


def _without_doubt(outputs: Outputs, doubt_sigma: tuple[float, float]) -> dict[str, NDArray[Any]]:
    """Return outputs whose covariances are those of a network without doubt."""
    changed = dict(outputs)
    names = ("translation_covariance", "rotation_covariance")
    for name, growth in zip(names, doubt_sigma, strict=True):
        if growth > 0:
            sigma = 1 + (1 - outputs["probabilities"][:, 0]) * growth
            changed[name] = outputs[name] / np.square(sigma)[:, None, None]
    return changed
