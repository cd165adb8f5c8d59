"""The first look as a heat map: where in the frame the object's origin is, and how far.

For each cell of the frame the network gives a logit of the origin lying there and the log of its
distance. A heat map can have several peaks, where a regression would give their mean: each of the
highest is a candidate to look at. The place of a candidate is the mean over the peak's cell and its
neighbors, weighted by the heat map; labels are distributed over the four nearest cells, as bilinear
interpolation would weight them, so the mean keeps the place within a cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.config import PolarPoseConfig
from ffpose.config.polar_pose import DENSE
from ffpose.models.compact_resnet import BasicBlock

APART = 2
"""Cells between two peaks that are not one, along a side."""

ENTROPY_WEIGHT = 0.1


class Candidates(NamedTuple):
    """Points where the object may be, the likeliest first.

    Attributes:
        points: ``(B, K, 3)``, meters, camera frame.
        log_mass: ``(B, K)``, log probability of the cells that a candidate was found from.
    """

    points: Tensor
    log_mass: Tensor


class HeatMap(nn.Module):
    """Heat map and distances from the first look's feature map, and the candidates in them.

    An origin outside of the frame counts as at its border; its distance is along the viewing ray.
    """

    centers: Tensor
    around: Tensor
    beyond: Tensor
    intrinsics: Tensor

    def __init__(self, config: PolarPoseConfig, channels: int) -> None:
        super().__init__()
        self.config = config
        rows, columns = config.heat_grid
        self.block = BasicBlock(channels, config.first_channels)
        self.numbers = nn.Conv2d(config.first_channels, 2 * DENSE**2, 1)
        cells = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).flip(1)  # (N, 2)
        height, width = config.image_size
        pixels = torch.tensor([width / columns, height / rows])
        self.register_buffer("centers", (cells + 0.5) * pixels, persistent=False)
        apart = (cells[:, None] - cells).abs().amax(-1)  # (N, N)
        self.register_buffer("around", (apart <= 1).float(), persistent=False)
        self.register_buffer("beyond", (apart > APART).float(), persistent=False)
        assert config.camera is not None
        self.register_buffer("intrinsics", torch.tensor(config.camera), persistent=False)

    def forward(self, feature_map: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits and relative log distances, ``(B, rows, columns)`` each."""
        numbers = F.pixel_shuffle(self.numbers(self.block(feature_map)), DENSE)
        return numbers[:, 0], numbers[:, 1]

    def candidates(self, logits: Tensor, distances: Tensor, count: int) -> Candidates:
        """Return the ``count`` highest peaks of a heat map; arguments as `forward` returns them."""
        p, distances = logits.flatten(1).softmax(-1), distances.flatten(1)
        free, points, masses = p, [], []
        for _ in range(count):
            peak = free.argmax(-1)
            weight = p * self.around[peak]
            # Zero where all else is less likely than the least number.
            mass = weight.sum(-1, keepdim=True).clamp_min(torch.finfo(weight.dtype).tiny)
            place = weight @ self.centers / mass
            relative = (weight * distances).sum(-1, keepdim=True) / mass
            points.append(self._points(place, relative))
            masses.append(mass[:, 0])
            free = free * self.beyond[peak]
        return Candidates(torch.stack(points, 1), torch.stack(masses, 1).clamp_min(1e-12).log())

    def loss(self, logits: Tensor, distances: Tensor, points: Tensor, smooth: float) -> Tensor:
        """Return the mean loss of the first look: cross-entropy, and Huber's of the log distance.

        The cross-entropy counts by `ENTROPY_WEIGHT`, to be as large as errors of a regression;
        logits and distances are as `forward` returns them, for origins ``(B, 3)``, meters, in front
        of the camera. Errors of the log distance below ``smooth`` count by their square.
        """
        weight = self._labels(points)
        entropy = -(weight * logits.flatten(1).log_softmax(-1)).sum(-1).mean()
        found = (weight * distances.flatten(1)).sum(-1)
        truth = (points.norm(dim=-1) / self._middle).log()
        return ENTROPY_WEIGHT * entropy + F.smooth_l1_loss(found, truth, beta=smooth)

    @property
    def _middle(self) -> float:
        return math.sqrt(math.prod(self.config.distance_m))

    def _labels(self, points: Tensor) -> Tensor:
        """Return the weights ``(B, N)`` of the four cells nearest to each point's place."""
        fx, fy, cx, cy = self.intrinsics.unbind(-1)
        x, y, z = points.unbind(-1)
        place = torch.stack([x / z * fx + cx, y / z * fy + cy], dim=-1)
        place = torch.minimum(torch.maximum(place, self.centers[0]), self.centers[-1])
        pitch = 2 * self.centers[0]
        apart = (place[:, None] - self.centers).abs() / pitch  # (B, N, 2)
        return (1 - apart).clamp_min(0).prod(-1)

    def _points(self, place: Tensor, relative: Tensor) -> Tensor:
        """Return points ``(B, 3)`` at pixels ``(B, 2)`` and relative log distances ``(B, 1)``.

        Distances are clamped to between half the smallest and twice the largest of training.
        """
        near, far = self.config.distance_m
        logs = [math.log(d / self._middle) for d in (near / 2, far * 2)]
        tangents = (place - self.intrinsics[2:]) / self.intrinsics[:2]
        rays = F.normalize(torch.cat((tangents, torch.ones_like(relative)), dim=1), dim=-1)
        return rays * (self._middle * relative.clamp(*logs).exp())
