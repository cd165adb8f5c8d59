"""How far the attitude of trained weights changes with the twist of the second look's camera.

PolarPose's second look commutes with rotations of its virtual camera about the viewing ray by cells
of its last map, whatever the weights. By other angles it does as far as its layers keep frequencies
apart: convolutions and ReLUs make frequencies that a map of fewer angles takes for others
(aliasing). So here the camera is pointed at the true place of an object and twisted by random
angles, and attitudes in the camera's frame are compared with those of the camera without a twist.
The attitude of a pose is the mean of two such looks, half a cell apart: ``--looks 2``.
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
from torch.nn import functional as F

from ffpose._internal.seeds import CHOICES
from ffpose.arrays import rotation_error
from ffpose.errors import expect
from ffpose.evaluation.attitude import rotation_parts
from ffpose.models import PolarPose, load_network, read_metadata
from ffpose.models.virtual_camera import pyramid, render_virtual
from ffpose.render import render

SEED = CHOICES[345_678]
TWISTS = 8
"""Random angles for each image."""

QUANTILES = {"median": 0.5, "90 %": 0.9}

Changes = dict[str, NDArray[np.float64]]


def attitudes(
    model: PolarPose, image: Tensor, point: Tensor, twists: Tensor, looks: int = 1
) -> Tensor:
    """Return the orientations ``(K, 4)`` in the camera's frame, by second looks of each twist.

    With several looks, their normalized mean: each is turned by a part of a cell from the one
    before.

    Args:
        model: The network.
        image: ``(1, 3, H, W)``, standardized.
        point: ``(3,)``, what the virtual camera is pointed at, meters, camera frame.
        twists: ``(K,)``, radians.
        looks: Number of looks of each twist.
    """
    points = point.expand(len(twists), 3)
    part = 2 * math.pi / (model.config.object_grid[1] * looks)
    found = []
    with torch.inference_mode():
        for look in range(looks):
            view = model.view_at(points, twists + look * part)
            crops = render_virtual(pyramid(image), view, points, model.intrinsics)
            numbers = model.decode(model.encode(crops, view.tan_half_angle))
            found.append(view.turned_back(model.orientation.decode(numbers.orientation)))
    q = torch.stack(found)
    same = torch.where((q * q[0]).sum(-1, keepdim=True) < 0, -q, q)
    return F.normalize(same.sum(0), dim=-1)


def changes(
    model: PolarPose, image: Tensor, point: Tensor, twists: Tensor, looks: int = 1
) -> Changes:
    """Return the changes ``(K,)`` of the attitude, degrees: whole, in-plane and out-of-plane.

    Arguments as `attitudes`.
    """
    every = torch.cat((torch.zeros(1), twists))
    q = attitudes(model, image, point, every, looks).double().numpy()
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
    parser.add_argument("--looks", type=int, default=1, help="looks whose mean is compared")


def run(options: argparse.Namespace) -> None:
    """Measure a network on rendered images, and print quantiles of the changes, degrees.

    Raises:
        ValueError: The network has no polar second look, or there are no looks.
    """
    expect(options.looks >= 1, "looks", "1 or more", options.looks)
    model = load_network(Path(options.network))
    preprocessing = read_metadata(options.network).preprocessing
    if not isinstance(model, PolarPose):
        raise ValueError(f"network: expected a PolarPose, got {type(model).__name__}")
    height, width = preprocessing.size
    generator = torch.Generator().manual_seed(SEED)
    found: dict[str, list[NDArray[np.float64]]] = {}
    for number in range(options.count):
        shown = render(options.scene, SEED, number, size=(width, height))
        image = torch.from_numpy(preprocessing.array(Image.fromarray(shown.image)))[None]
        point = torch.tensor(shown.pose.t.tolist())
        twists = torch.rand(TWISTS, generator=generator) * 2 * math.pi
        for part, values in changes(model, image, point, twists, options.looks).items():
            found.setdefault(part, []).append(values)
    for part, each in found.items():
        changed = np.concatenate(each)
        words = (f"{name} {np.quantile(changed, share):.2f}°" for name, share in QUANTILES.items())
        print(f"{part}: {', '.join(words)}")
