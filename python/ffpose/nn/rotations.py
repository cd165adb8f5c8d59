"""Rotations of tensors: quaternions, matrices and rotation vectors, in batches.

Quaternions are Hamilton's, scalar first ``(w, x, y, z)``. All functions are differentiable and can
be exported to ONNX; `ffpose.geometry.rotations` has them for NumPy.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def quaternion_to_matrix(q: Tensor) -> Tensor:
    """Return the rotation matrices ``(B, 3, 3)`` of unit quaternions ``(B, 4)``."""
    w, x, y, z = q.unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.unflatten(torch.stack(rows, dim=-1), -1, (3, 3))


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """Return unit quaternions ``(B, 4)`` of rotation matrices ``(B, 3, 3)``, of either sign.

    Of the four expressions for the quaternion times one of its own entries, the one with the
    largest entry is used for each matrix, so that no division is by a small number.
    """
    m = matrix
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    rows = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, wx, wy, wz], dim=-1),
            torch.stack([wx, 1 + xx - yy - zz, xy, xz], dim=-1),
            torch.stack([wy, xy, 1 - xx + yy - zz, yz], dim=-1),
            torch.stack([wz, xz, yz, 1 - xx - yy + zz], dim=-1),
        ],
        dim=1,
    )  # (B, 4, 4): row i is 4 q_i q
    best = rows.diagonal(dim1=1, dim2=2).argmax(-1)
    row = rows.gather(1, best[:, None, None].expand(-1, 1, 4))[:, 0]
    return F.normalize(row, dim=-1)


def rotation_vector(difference: Tensor) -> Tensor:
    """Convert unit quaternions ``(B, 4)`` to rotation vectors ``(B, 3)``, radians."""
    q = torch.where(difference[:, :1] < 0, -difference, difference)
    sine = q[:, 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, q[:, :1])
    return q[:, 1:] * torch.where(sine > 1e-6, angle / sine.clamp_min(1e-6), 2.0)


def nearest_equivalent(q_hat: Tensor, q: Tensor, rotations: Tensor) -> Tensor:
    """Return the attitudes ``q g``, of either sign, nearest to ``q_hat``, for ``g`` of a group.

    All are unit quaternions, ``(B, 4)``; ``rotations (G, 4)`` are those of the group.
    """
    inverse = q.new_tensor([1.0, -1.0, -1.0, -1.0])
    between = rotation_between(q_hat * inverse, q * inverse)  # conj(q) q_hat
    chosen = rotations[(between @ rotations.mT).abs().argmax(dim=1)]
    return rotation_between(chosen * inverse, q)


def rotation_between(q_from: Tensor, q_to: Tensor) -> Tensor:
    """Return the rotations ``q_to conj(q_from)`` of unit quaternions ``(B, 4)``."""
    a, v = q_to[:, :1], q_to[:, 1:]
    b, u = q_from[:, :1], -q_from[:, 1:]
    scalar = a * b - (v * u).sum(-1, keepdim=True)
    return torch.cat((scalar, a * u + b * v + torch.linalg.cross(v, u)), dim=1)
