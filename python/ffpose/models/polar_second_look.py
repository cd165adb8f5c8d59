"""The second look in polar coordinates: backbone of spectral filters, and an equivariant head.

The view of the virtual camera is sampled on rings about the viewing ray, so a rotation of the
camera about that ray is a cyclic shift along the angle. `PolarBackbone` commutes with shifts by a
cell of its last map (`ffpose.nn.polar`). `PolarHead` reads from the map what turns with the camera
as a vector turns, what turns twice as fast, and what does not turn:

* the offset across the viewing ray is a first harmonic of the angle: the mean of a two-vector of
  each angle, rotated by that angle;
* the directions of the largest errors across the ray are second harmonics;
* distance, log standard deviations and in view follow from mean and maximum over the angles;
* the orientation's bins share the weights of all angles (`ffpose.nn.polar_bins`).

So the second look is equivariant to in-plane rotation for any weights (Worrall et al., "Harmonic
Networks", CVPR 2017).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.config import PolarPoseConfig
from ffpose.models.second_look import LOG_SIGMA_LIMITS, SecondLookOutput
from ffpose.nn.polar import PolarBlock, PolarConv, SpectralPool

SHEAR_LIMIT = 1.5
"""Bound on the log ratio of the standard deviations across the ray to their geometric mean."""


class PolarBackbone(nn.Module):
    """Feature extractor for polar images: a stem of two convolutions, and filter blocks."""

    def __init__(self, config: PolarPoseConfig) -> None:
        super().__init__()
        stem, first, last = config.channels
        radii, angles = config.object_grid
        before, after = config.blocks

        def blocks(count: int, size: tuple[int, int, int]) -> nn.Module:
            each = (PolarBlock(size, config.mixer, config.expansion) for _ in range(count))
            return nn.Sequential(*each)

        rays = config.object_size[1]
        self.begin = PolarConv(3, stem, (2, 2))
        self.pool = SpectralPool(rays // 2)
        self.widen = PolarConv(stem, first, (2, 1))
        self.pool_again = SpectralPool(rays // 4)
        self.perspective = nn.Linear(1, first)
        self.first = blocks(before, (2 * radii, angles, first))
        self.down = PolarConv(first, last, (2, 1))
        self.last = blocks(after, (radii, angles, last))
        self.channels = (last,)  # as a `Backbone` has
        self.to(memory_format=torch.channels_last)

    def forward(self, views: Tensor, tan_half_angle: Tensor) -> Tensor:
        """Return the map ``(B, C, radii', angles')`` of polar images ``(B, 3, radii, angles)``.

        ``tan_half_angle (B,)`` is `VirtualCamera.tan_half_angle`.
        """
        x = self.begin(views.contiguous(memory_format=torch.channels_last))
        x = self.widen(self.pool(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2))
        x = (
            self.pool_again(x.permute(0, 2, 3, 1))
            + self.perspective(tan_half_angle[:, None])[:, None, None]
        )
        x = self.first(x).permute(0, 3, 1, 2)
        result: Tensor = self.last(self.down(x).permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        return result


class PolarHead(nn.Module):
    """Head that computes the outputs of the second look from the last map."""

    turns: Tensor
    sigmas: Tensor

    def __init__(self, config: PolarPoseConfig) -> None:
        super().__init__()
        latent = config.latent
        self.mix = nn.Linear(config.channels[2] * config.object_grid[0], latent)
        self.mix_again = nn.Linear(latent, latent)
        self.scalars = nn.Sequential(nn.Linear(2 * latent, latent), nn.ReLU(), nn.Linear(latent, 6))
        self.vectors = nn.Linear(latent, 6)
        angles = map_angles(config)
        self.register_buffer(
            "turns", torch.stack([rotations(angles), rotations(2 * angles)]), persistent=False
        )
        # Of the scalars: distance; across and along the ray, of offset and rotation; in view.
        self.register_buffer("sigmas", torch.tensor([1, 1, 2, 3, 3, 4]), persistent=False)

    def forward(self, feature_map: Tensor) -> SecondLookOutput:
        """Return the outputs for a map ``(B, C, radii, angles)``."""
        g = feature_map.permute(0, 3, 2, 1).flatten(2)  # (B, angles, radii * C)
        g = F.relu(self.mix(g))
        g = F.relu(self.mix_again(g) + g)
        scalars = self.scalars(torch.cat((g.mean(1), g.amax(1)), dim=1))
        vectors = torch.unflatten(self.vectors(g), 2, (3, 2))  # (B, angles, 3, 2)
        first, second = self.turns.to(vectors.dtype)
        offset = torch.einsum("aij,baj->bi", first, vectors[:, :, 0]) / len(first)
        shear = torch.einsum("aij,banj->bni", second, vectors[:, :, 1:]) / len(second)
        length = shear.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        shear = shear * (SHEAR_LIMIT * (length / SHEAR_LIMIT).tanh() / length)
        return SecondLookOutput(
            orientation=g.flatten(1),
            offset=torch.cat((offset, scalars[:, :1]), dim=1),
            log_sigma=scalars[:, self.sigmas].clamp(*LOG_SIGMA_LIMITS),
            in_view=scalars[:, 5],
            shear=shear.flatten(1),
        )


def map_angles(config: PolarPoseConfig) -> Tensor:
    """Return the angles ``(A,)`` of the cells of the last map, radians, float64.

    They are those of the rays in the middle of each cell's kernels: of every stride the first.
    """
    rays, cells = config.object_size[1], config.object_grid[1]
    middle = torch.arange(cells, dtype=torch.float64) * (rays // cells) + 0.5
    return middle * (2 * math.pi / rays)


def rotations(angles: Tensor) -> Tensor:
    """Return rotations of the plane ``(A, 2, 2)``, float32, by ``angles (A,)``, radians."""
    c, s = angles.cos(), angles.sin()
    return torch.stack([torch.stack([c, -s], 1), torch.stack([s, c], 1)], dim=1).float()
