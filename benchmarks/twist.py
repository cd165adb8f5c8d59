"""How far the attitude of trained weights changes with the twist of the second look's camera.

PolarPose's second look commutes with rotations of its virtual camera about the viewing ray by cells
of its last map, whatever the weights. By other angles it does as far as its layers keep frequencies
apart: convolutions and ReLUs make frequencies that a map of fewer angles takes for others
(aliasing). So here the camera is pointed at the true place of an object and twisted by random
angles, and attitudes in the camera's frame are compared with those of the camera without a twist.
The attitude of a pose is the mean of several looks, parts of a cell apart, each of which is pointed
by the one before: ``--looks 3``, as `soyuz` has them.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ffpose._internal.seeds import CHOICES
from ffpose.arrays import rotation_error
from ffpose.config import PolarPoseConfig
from ffpose.errors import expect
from ffpose.evaluation.attitude import rotation_parts
from ffpose.models import PolarPose, load_network, read_metadata
from ffpose.models.heat_map import Candidates
from ffpose.render import render

SEED = CHOICES[345_678]
TWISTS = 8
"""Random angles for each image."""

QUANTILES = {"median": 0.5, "90 %": 0.9}

Changes = dict[str, NDArray[np.float64]]


def attitudes(model: PolarPose, image: Tensor, point: Tensor, twists: Tensor) -> Tensor:
    """Return the orientations ``(K, 4)`` of a network's poses, by second looks of each twist.

    Args:
        model: The network, of one candidate.
        image: ``(1, 3, H, W)``, standardized.
        point: ``(3,)``, what the first virtual camera is pointed at, meters, camera frame.
        twists: ``(K,)``, radians.
    """
    count, view_at, heat_map = len(twists), model.view_at, model.translation_branch
    there = Candidates(point.expand(count, 1, 3), torch.zeros(count, 1))
    try:
        heat_map.candidates = lambda *_: there  # type: ignore[method-assign]  # until `finally`
        model.view_at = (  # type: ignore[method-assign]  # until `finally`
            lambda points, twist=None: view_at(points, twists if twist is None else twists + twist)
        )
        with torch.inference_mode():
            found: Tensor = model(image.expand(count, -1, -1, -1)).orientation
    finally:
        del heat_map.candidates, model.view_at
    return found


def changes(model: PolarPose, image: Tensor, point: Tensor, twists: Tensor) -> Changes:
    """Return the changes ``(K,)`` of the attitude, degrees: whole, in-plane and out-of-plane.

    Arguments as `attitudes`.
    """
    every = torch.cat((torch.zeros(1), twists))
    q = attitudes(model, image, point, every).double().numpy()
    plain = np.repeat(q[:1], len(twists), axis=0)
    rays = np.repeat(point[None].double().numpy(), len(twists), axis=0)
    parts = rotation_parts(q[1:], rays, plain)
    return {
        "attitude": np.asarray(rotation_error(q[1:], plain), np.float64),
        "in-plane": parts.in_plane_deg,
        "out-of-plane": parts.out_of_plane_deg,
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("network", help="weights of the preset polar")
    parser.add_argument("--scene", default="soyuz_easy", help="of the images (default: this)")
    parser.add_argument("--count", type=int, default=100, help="number of images")
    parser.add_argument("--looks", type=int, default=1, help="looks that make a pose")


def run(options: argparse.Namespace) -> None:
    """Measure a network on rendered images, and print quantiles of the changes, degrees.

    Raises:
        ValueError: The network has no polar second look, or there are no looks.
    """
    expect(options.looks >= 1, "looks", "1 or more", options.looks)
    metadata = read_metadata(options.network)
    if not isinstance(metadata.config, PolarPoseConfig):
        got = metadata.config.architecture
        raise ValueError(f"network: expected a PolarPose, got {got}")
    model = load_network(Path(options.network), looks=options.looks, candidates=1)
    assert isinstance(model, PolarPose)
    preprocessing = metadata.preprocessing
    height, width = preprocessing.size
    generator = torch.Generator().manual_seed(SEED)
    found: dict[str, list[NDArray[np.float64]]] = {}
    for number in range(options.count):
        shown = render(options.scene, SEED, number, size=(width, height))
        image = torch.from_numpy(preprocessing.array(Image.fromarray(shown.image)))[None]
        point = torch.tensor(shown.pose.t.tolist())
        twists = torch.rand(TWISTS, generator=generator) * 2 * math.pi
        for part, values in changes(model, image, point, twists).items():
            found.setdefault(part, []).append(values)
    for part, each in found.items():
        changed = np.concatenate(each)
        words = (f"{name} {np.quantile(changed, share):.2f}°" for name, share in QUANTILES.items())
        print(f"{part}: {', '.join(words)}")
