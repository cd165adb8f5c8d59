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
from torch import Tensor, nn

from ffpose.nn.orientation import mean_quaternion


class EulerBinsHead(nn.Module):
    """Logits over a regular grid of Euler angles.

    Args:
        bins_per_dim: Number of values of roll, pitch and yaw each.
        smoothing: Width of the soft assignment in bins.
    """

    bins: Tensor
    outer: Tensor

    def __init__(self, bins_per_dim: int = 24, smoothing: float = 6.0) -> None:
        super().__init__()
        attitudes = euler_grid(bins_per_dim)
        self.features = len(attitudes)
        self.variance = (smoothing / bins_per_dim) ** 2 / 12
        self.register_buffer("bins", attitudes.float(), persistent=False)
        outer = (attitudes[:, :, None] * attitudes[:, None]).flatten(1)  # (features, 16)
        self.register_buffer("outer", outer.float(), persistent=False)

    def assign(self, q: Tensor) -> Tensor:
        """Return the soft labels ``(B, features)``, of sum 1, of unit quaternions ``(B, 4)``."""
        turn = 2 * torch.acos((q @ self.bins.T).abs().clamp(max=1.0)) / math.pi
        return (-turn.square() / (2 * self.variance)).softmax(-1)

    def decode(self, raw: Tensor) -> Tensor:
        """Return unit quaternions ``(B, 4)`` for logits ``(B, features)``: the weighted mean."""
        p = raw.softmax(-1)
        matrix = torch.unflatten(p @ self.outer, 1, (4, 4))  # sum of p b bT
        return mean_quaternion(matrix, self.bins[p.argmax(-1)])

    def loss(self, raw: Tensor, q: Tensor) -> Tensor:
        """Return the cross-entropy with the soft labels for each sample ``(B,)``."""
        return -(self.assign(q) * raw.log_softmax(-1)).sum(-1)


def euler_grid(count: int) -> Tensor:
    """Return the distinct attitudes of a regular grid of Euler angles, ``(bins, 4)``, float64.

    ``count`` values of each angle, in ZYX order: roll and yaw from -180 to 180 degrees, pitch from
    -90 to 90. Unit quaternions are ``(w, x, y, z)``.
    """
    steps = torch.linspace(-1, 1, count, dtype=torch.float64)
    roll, pitch, yaw = (
        grid.flatten()
        for grid in torch.meshgrid(
            math.pi * steps, math.pi / 2 * steps, math.pi * steps, indexing="ij"
        )
    )
    ends = (roll == math.pi) | (yaw == math.pi)
    poles = (pitch.abs() == math.pi / 2) & (roll != -math.pi)
    kept = ~(ends | poles)
    (cr, sr), (cp, sp), (cy, sy) = (
        ((angle[kept] / 2).cos(), (angle[kept] / 2).sin()) for angle in (roll, pitch, yaw)
    )
    return torch.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        dim=-1,
    )
