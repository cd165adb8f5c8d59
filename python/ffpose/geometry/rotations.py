"""Rotations of NumPy arrays: quaternions, matrices and rotation vectors.

Quaternions are Hamilton's, scalar first ``(w, x, y, z)``; `ffpose.nn.rotations` has the same for
tensors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array.astype(np.float64)


def unit_quaternion(q: ArrayLike) -> FloatArray:
    """Normalize ``q (..., 4)``, whose norm must be one within `QUATERNION_TOLERANCE`."""
    array = real_array("quaternion", q, 4)
    norm = np.linalg.norm(array, axis=-1, keepdims=True)
    worst = float(np.max(np.abs(norm - 1), initial=0.0))
    if worst > QUATERNION_TOLERANCE:
        raise ValueError(
            f"quaternion: expected norm 1 within {QUATERNION_TOLERANCE}, "
            f"got {norm.flat[np.argmax(np.abs(norm - 1))]:.6g}"
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
    scalar = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)


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
