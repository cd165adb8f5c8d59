"""Rotations of NumPy arrays: quaternions, matrices and rotation vectors.

Quaternions are Hamilton's, scalar first ``(w, x, y, z)``; `ffpose.nn.rotations` has the same for
tensors.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose._internal.files import shortened

FloatArray = NDArray[np.float64]

QUATERNION_TOLERANCE = 1e-3
"""Deviation of a quaternion's norm from one (rounding in a printed label) that is normalized."""


def real_array(name: str, values: ArrayLike, size: int) -> FloatArray:
    """Convert to a finite float64 array whose last axis has ``size``, or raise."""
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    if array.ndim < 1 or array.shape[-1] != size:
        raise ValueError(f"{name}: expected shape (..., {size}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {shortened(array.tolist())}")
    return array.astype(np.float64)


def unit_quaternion(q: ArrayLike) -> FloatArray:
    """Normalize ``q (..., 4)``, whose norm must be one within `QUATERNION_TOLERANCE`."""
    array = real_array("quaternion", q, 4)
    norm = np.linalg.norm(array, axis=-1, keepdims=True)
    deviation = np.abs(norm - 1)
    if deviation.max(initial=0.0) > QUATERNION_TOLERANCE:
        got = norm.flat[deviation.argmax()]
        raise ValueError(
            f"quaternion: expected norm 1 within {QUATERNION_TOLERANCE}, got {got:.6g}"
        )
    return np.asarray(array / norm)


def rotation_matrix(q: ArrayLike) -> FloatArray:
    """Return the rotation matrices of Hamilton quaternions, scalar first.

    Args:
        q: Unit quaternions ``(..., 4)``, ``(w, x, y, z)``.

    Returns:
        Matrices ``(..., 3, 3)``, float64, such that ``matrix @ p`` rotates the point ``p``.

    Raises:
        TypeError: The values are not real numbers.
        ValueError: Wrong shape, a value that is not finite, or a norm other than one.

    Examples:
        >>> rotation_matrix([0.0, 0.0, 0.0, 1.0]).tolist()  # half a turn about z
        [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    w, x, y, z = np.moveaxis(unit_quaternion(q), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def conjugate(q: FloatArray) -> FloatArray:
    """Return the conjugates ``(..., 4)``, the inverse rotations of unit quaternions."""
    return np.asarray(q * (1.0, -1.0, -1.0, -1.0))


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton products ``p q (..., 4)``: first the rotation by q, then by p.

    Examples:
        >>> multiply(np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])).tolist()
        [0.0, 0.0, 0.0, 1.0]
    """
    (w, x, y, z), (i, j, k, m) = (np.moveaxis(each, -1, 0) for each in (p, q))
    parts = [
        w * i - x * j - y * k - z * m,
        w * j + x * i + y * m - z * k,
        w * k - x * m + y * i + z * j,
        w * m + x * k - y * j + z * i,
    ]
    return np.stack(parts, axis=-1)


def rotation_vector(q: FloatArray) -> FloatArray:
    """Return the rotation vectors ``(..., 3)`` of unit quaternions of either sign, radians.

    Examples:
        >>> rotation_vector(np.array([0.0, 0.0, 0.0, 1.0])).round(4).tolist()  # half a turn about z
        [0.0, 0.0, 3.1416]
    """
    w, v = q[..., :1], q[..., 1:]
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, np.abs(w))
    scale = np.divide(angle, length, out=np.full_like(length, 2.0), where=length > 0)
    return np.asarray(v * np.copysign(scale, w))


def from_rotation_vector(v: FloatArray) -> FloatArray:
    """Return the unit quaternion ``(4,)`` of a rotation vector ``(3,)``, radians."""
    half = np.linalg.norm(v) / 2
    return np.array([math.cos(half), *(np.sinc(half / math.pi) / 2 * v)])


def from_matrix(matrix: FloatArray) -> FloatArray:
    """Return the quaternion ``(4,)`` of the rotation nearest to a matrix (Bar-Itzhack 2000)."""
    sums = np.zeros((4, 4))
    sums[0, 1:] = sums[1:, 0] = [
        matrix[2, 1] - matrix[1, 2],
        matrix[0, 2] - matrix[2, 0],
        matrix[1, 0] - matrix[0, 1],
    ]
    sums[0, 0] = np.trace(matrix)
    sums[1:, 1:] = matrix + matrix.T - np.trace(matrix) * np.eye(3)
    return np.asarray(np.linalg.eigh(sums)[1][:, -1])


def shortest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the least rotation ``(3, 3)`` from a unit vector to one that is not its opposite."""
    skew = np.cross(np.eye(3), np.cross(a, b))
    # Rodrigues' formula.
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + a @ b))
