"""Soft classification of orientation over a regular grid of Euler angles.

Proenca and Gao, "Deep Learning for Spacecraft Pose Estimation from Photorealistic Rendering", ICRA
2020, section "Direct orientation estimation via soft classification". Bins ``b_i`` are the
attitudes of a grid of ``n`` values for each angle, both ends of their ranges among them. The label
of an attitude q is the distribution

    f(q, b_i) = K(q, b_i) / sum_j K(q, b_j),   K(q, b) = exp(-(2 acos|q . b| / pi)^2 / (2 s^2)),

with ``s^2 = (smoothing / n)^2 / 12``, the variance of a uniform distribution over ``smoothing``
bins. The loss is the cross-entropy, and the estimate the mean of the bins weighted by their
probabilities: the eigenvector of ``sum_i p_i b_i b_i^T`` to its largest eigenvalue (Markley et al.,
"Averaging Quaternions", 2007).

Some nodes of the grid are the same attitude: -180 and 180 degrees of roll or yaw, and, where the
pitch is -90 or 90 degrees, all with the same difference or sum of roll and yaw. The authors give
the labels of all but one of them zero; here those have no bin. Near the poles of pitch bins are
denser than elsewhere, in the authors' program as here.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ffpose.nn.orientation import AttitudeBins
from ffpose.nn.rotations import quaternion_product, turned_about_axis


class EulerBinsHead(AttitudeBins):
    """Logits over a regular grid of Euler angles.

    Args:
        bins_per_dim: Number of values of roll, pitch and yaw each.
        smoothing: Width of the soft assignment in bins.
    """

    def __init__(self, bins_per_dim: int = 24, smoothing: float = 6.0) -> None:
        super().__init__(euler_grid(bins_per_dim), math.pi * smoothing / bins_per_dim / 12**0.5)


def euler_grid(count: int) -> Tensor:
    """Return the distinct attitudes of a regular grid of Euler angles, ``(bins, 4)``, float64.

    ``count`` values of each angle, in ZYX order: roll and yaw from -180 to 180 degrees, pitch from
    -90 to 90. Unit quaternions are ``(w, x, y, z)``.
    """
    steps = torch.linspace(-1, 1, count, dtype=torch.float64)
    turns, halves = math.pi * steps, math.pi / 2 * steps
    roll, pitch, yaw = torch.cartesian_prod(turns, halves, turns).unbind(1)
    ends = (roll == math.pi) | (yaw == math.pi)
    poles = (pitch.abs() == math.pi / 2) & (roll != -math.pi)
    kept = ~(ends | poles)
    x, y, z = (
        turned_about_axis(angle[kept], axis) for axis, angle in enumerate((roll, pitch, yaw), 1)
    )
    return quaternion_product(z, quaternion_product(y, x))
