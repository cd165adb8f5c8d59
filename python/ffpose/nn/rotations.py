"""Rotations of tensors: quaternions, matrices and rotation vectors, in batches.

Quaternions are Hamilton's, scalar first ``(w, x, y, z)``. All functions are differentiable and can
be exported to ONNX; `ffpose.geometry.rotations` has them for NumPy.
"""

from __future__ import annotations

import itertools

import numpy as np
import torch
from torch import Tensor

from ffpose._internal.torch_internals import constant

SIGNS = ((1, 1, 1, 1), (1, -1, 1, -1), (1, -1, -1, 1), (1, 1, -1, -1))
"""Unit ``m`` times unit ``n`` is ``SIGNS[m][n]`` times unit ``m ^ n``, for 1, i, j and k."""

INVERSE = constant((1.0, -1.0, -1.0, -1.0))
"""Signs of the conjugate's entries."""


def quaternion_product(p: Tensor, q: Tensor) -> Tensor:
    """Return the Hamilton products ``p q (B, 4)`` of quaternions ``(B, 4)``.

    As rotations: first ``q``, then ``p``.
    """
    return _bilinear(p, q, PRODUCTS)


def quaternion_to_matrix(q: Tensor) -> Tensor:
    """Return the rotation matrices ``(B, 3, 3)`` of unit quaternions ``(B, 4)``."""
    return torch.unflatten(_bilinear(q, q, MATRICES), 1, (3, 3))


def _bilinear(p: Tensor, q: Tensor, table: Tensor) -> Tensor:
    """Return what the products of two entries each of ``p`` and ``q (B, 4)`` are by a table.

    One product with a matrix ``(16, outputs)``: a network's geometry is of few numbers, and costs
    by the number of its operators.
    """
    return (p[:, :, None] * q[:, None]).flatten(1) @ table.to(q, non_blocking=True)


def _tables() -> tuple[Tensor, Tensor]:
    """Return the matrices ``(16, 4)`` of a product ``p q``, and ``(16, 9)`` of ``q v conj(q)``."""
    product = np.zeros((4, 4, 4))
    for m, n in itertools.product(range(4), repeat=2):
        product[m, n, m ^ n] = SIGNS[m][n]
    rotated = np.einsum("ibm,mja,j->ijab", product, product, INVERSE.numpy())
    tables = product.reshape(16, 4), rotated[:, :, 1:, 1:].reshape(16, 9)
    first, second = (constant(table.tolist()) for table in tables)
    return first, second


PRODUCTS, MATRICES = _tables()


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
    between = quaternion_product(conjugate(q), q_hat)
    chosen = rotations[(between @ rotations.mT).abs().argmax(dim=1)]
    return quaternion_product(q, chosen)


def conjugate(q: Tensor) -> Tensor:
    """Return the conjugates ``(B, 4)``, the inverse rotations of unit quaternions."""
    return q * INVERSE.to(q, non_blocking=True)


def toward(directions: Tensor) -> Tensor:
    """Return the smallest rotations from the z axis to ``directions (B, 3)``, quaternions.

    Unit quaternions ``(B, 4)``. The directions need not have unit length, but must not point along
    -z.
    """
    length = directions.norm(dim=-1, keepdim=True)
    # (|d| + z, -y, x, 0) is the unit quaternion times 2 |d| and half the angle's cosine.
    least = torch.cat((length, directions), dim=-1) @ LEAST.to(directions, non_blocking=True)
    unit: Tensor = least / least.norm(dim=-1, keepdim=True)
    return unit


LEAST = constant(
    [
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
    ]
)
"""From ``(|d|, x, y, z)`` to ``(|d| + z, -y, x, 0)``."""


def turned_about_axis(angles: Tensor, axis: int = 3) -> Tensor:
    """Return rotations about an axis by ``angles (B,)``, radians: quaternions ``(B, 4)``.

    ``axis`` is 1, 2 or 3 for x, y or z.
    """
    c, s = (angles / 2).cos(), (angles / 2).sin()
    parts = [c, *[torch.zeros_like(c)] * 3]
    parts[axis] = s
    return torch.stack(parts, dim=-1)
