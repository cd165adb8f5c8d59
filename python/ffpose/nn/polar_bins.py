"""Orientation bins that are products of a rotation about the viewing ray and a viewing direction.

The bins are attitudes ``R_z(a_k) R_j``. ``R_j`` is the least rotation that takes direction ``j`` of
the object's frame to the z axis of the (virtual) camera; the rotation about that axis follows. All
angles share their weights: the features of an angle of the map are scored against each direction,
and interpolated to more angles by the Fourier series. So a rotation of the camera about its axis by
a cell of the map shifts the distribution by as much: it is equivariant by construction.

Directions are spread evenly over the sphere (Vogel's spiral); decoding is that of `BinsHead`. Soft
labels are matrix Fisher distributions about the true attitude, ``exp(k <q, b>^2)`` with ``k = 2 /
width^2`` (Mohlin et al., "Probabilistic Orientation Estimation with Matrix Fisher Distributions",
NeurIPS 2020), which near it are Gaussians of that standard deviation of the angle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.nn.orientation import NEAR_SQUARINGS, NEIGHBORHOOD_DEG, mean_quaternion
from ffpose.nn.polar import interpolation
from ffpose.nn.rotations import conjugate, quaternion_product, toward, turned_about_axis

WEIGHT_STD = 0.02

MODE_DEG = 30.0
"""Largest angle from a mode of an attitude that counts as near it, degrees.

Bins that make the second mode are at least twice that from the first, so no bin is near both."""


class Modes(NamedTuple):
    """The two most likely modes of a batch of distributions of the attitude.

    Attributes:
        orientation: ``(B, 4)``, that of `PolarBinsHead.decode`.
        alternative: ``(B, 4)``, the weighted mean near the most likely of the bins that are at
            least twice `MODE_DEG` from it.
        probabilities: ``(B, 2)``, that the attitude is within `MODE_DEG` of the one and of the
            other.
    """

    orientation: Tensor
    alternative: Tensor
    probabilities: Tensor


class PolarBinsHead(nn.Module):
    """Logits over attitudes, products of angles and directions, from the features of angles.

    Args:
        latent: Number of features of each angle of the map.
        map_angles: The map's angles ``(A,)``, radians, in equal steps of a turn.
        angles: Number of angles of the bins, a multiple of ``A``.
        directions: Number of viewing directions.
        width_deg: Standard deviation of the soft labels, degrees.

    Attributes:
        features: Number of inputs, ``A * latent``.
    """

    halves: Tensor
    squares: Tensor
    ends: Tensor
    outer: Tensor
    interpolation: Tensor

    def __init__(
        self, latent: int, map_angles: Tensor, angles: int, directions: int, width_deg: float
    ) -> None:
        super().__init__()
        self.latent, self.features = latent, len(map_angles) * latent
        self.concentration = 2 / math.radians(width_deg) ** 2
        # A bin is cos(a / 2) times its direction's least rotation r plus sin(a / 2) times that
        # after half a turn, s; products of bins follow from those of r and s.
        half = cell_centers(angles) / 2
        c, s = half.cos(), half.sin()
        ends = attitudes(torch.tensor([0.0, math.pi]).double(), sphere(directions))  # (2, J, 4)
        rr, rs, sr, ss = (a[:, :, None] * b[:, None] for a in ends for b in ends)  # (J, 4, 4)
        for name, values in (
            ("halves", torch.stack([c, s], dim=1)),  # (K, 2)
            ("squares", torch.stack([c * c, c * s, s * s])),  # (3, K)
            ("ends", ends),
            ("outer", torch.cat((rr, rs + sr, ss)).flatten(1)),  # (3 J, 16)
        ):
            self.register_buffer(name, values.float(), persistent=False)
        series = interpolation(map_angles.double(), cell_centers(angles))
        self.register_buffer("interpolation", series.float(), persistent=False)
        self.weight = nn.Parameter(torch.randn(latent, directions) * WEIGHT_STD)
        self.bias = nn.Parameter(torch.zeros(directions))

    def logits(self, raw: Tensor) -> Tensor:
        """Return logits ``(B, angles * directions)`` for ``raw (B, A * latent)``."""
        scores = torch.unflatten(raw, 1, (-1, self.latent)) @ self.weight + self.bias
        return (self.interpolation @ scores).flatten(1)

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)``: the weighted mean near the most likely bin."""
        return self._mean_near_mode(self.logits(raw))

    def _mean_near_mode(self, logits: Tensor) -> Tensor:
        """Return the mean of the attitudes within `NEIGHBORHOOD_DEG` of the most likely bin."""
        p = logits.softmax(-1)
        best, count = p.argmax(-1), self.ends.shape[1]
        halves, ends = self.halves[best // count], self.ends[:, best % count]
        mode = halves[:, :1] * ends[0] + halves[:, 1:] * ends[1]  # (B, 4)
        near = self._within(mode, NEIGHBORHOOD_DEG)
        weights = torch.unflatten(p * near, 1, (-1, count))  # (B, K, J)
        matrix = (self.squares @ weights).flatten(1) @ self.outer  # sum of p q qT
        return mean_quaternion(torch.unflatten(matrix, 1, (4, 4)), mode, NEAR_SQUARINGS)

    def modes(self, raw: Tensor) -> Modes:
        """Return the two most likely modes of the distributions."""
        logits = self.logits(raw)
        first = self._mean_near_mode(logits)
        away = ~self._within(first, 2 * MODE_DEG)
        second = self._mean_near_mode(logits.masked_fill(~away, -math.inf))
        p = logits.softmax(-1)
        near = (self._within(first, MODE_DEG), self._within(second, MODE_DEG) & away)
        sums = torch.stack([(p * each).sum(-1) for each in near], dim=1)
        return Modes(first, second, sums.clamp(max=1))  # those of float32 may round to more

    def _within(self, q: Tensor, degrees: float) -> Tensor:
        """Return which bins ``(B, bins)`` are closer to ``q (B, 4)`` than an angle."""
        return self._overlaps(q).abs() > math.cos(math.radians(degrees) / 2)

    def _overlaps(self, q: Tensor) -> Tensor:
        """Return the products ``(B, bins)`` of quaternions ``(B, 4)`` with those of the bins."""
        ends = torch.unflatten(q @ self.ends.flatten(0, 1).T, 1, (2, -1))
        return (self.halves @ ends).flatten(1)

    def loss(self, raw: Tensor, q: Tensor) -> Tensor:
        """Return the cross-entropy with soft labels for each sample ``(B,)``."""
        target = (self.concentration * self._overlaps(q).square()).softmax(-1)
        return F.cross_entropy(self.logits(raw), target, reduction="none")


def cell_centers(count: int) -> Tensor:
    """Return the angles ``(count,)`` of the centers of equal cells of a turn, radians, float64."""
    return (torch.arange(count, dtype=torch.float64) + 0.5) * (2 * math.pi / count)


def sphere(count: int) -> Tensor:
    """Return unit vectors ``(count, 3)`` spread evenly over the sphere, float64."""
    number = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * number / count
    radius, turn = (1 - z * z).sqrt(), number * (math.pi * (3 - math.sqrt(5)))
    return torch.stack([radius * turn.cos(), radius * turn.sin(), z], dim=-1)


def attitudes(angles: Tensor, directions: Tensor) -> Tensor:
    """Return the unit quaternions ``(K, J, 4)`` of ``R_z(angle) R``.

    Args:
        angles: ``(K,)``, radians.
        directions: Unit vectors ``(J, 3)``, none of them -z; ``R`` is the least rotation that takes
            one to the z axis.
    """
    least = conjugate(toward(directions))
    turns = turned_about_axis(angles)
    return torch.stack([quaternion_product(turn.expand_as(least), least) for turn in turns])
