"""In-plane and out-of-plane rotation errors: the swing-twist decomposition about the viewing ray.

Let ``r = t / |t|`` be the true viewing ray in the camera frame, ``R`` the true and ``R_hat`` the
predicted rotation, and ``E = R_hat Rᵀ`` the error. Its swing-twist decomposition about the ray,
``E = S T`` (Dobrowolski, "Swing-twist decomposition in Clifford algebra", arXiv:1506.05481), has

* the *in-plane* part: the angle of the twist ``T``, a rotation about the ray;
* the *out-of-plane* part: the angle of the swing ``S``, the smallest rotation that takes ``r`` to
  ``E r``. It is the angle between the true and the predicted viewing direction in the object frame,
  ``Rᵀ r`` and ``R_hatᵀ r``.

``cos(E / 2) = cos(S / 2) cos(T / 2)``: neither part exceeds the whole, and a rotation of the camera
changes neither. All functions compute in float64 with NumPy; quaternions are scalar first
``(w, x, y, z)``, of any nonzero norm and either sign.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffpose.geometry.rotations import FloatArray, conjugate, multiply, rotation_vector


class RotationParts(NamedTuple):
    """In-plane and out-of-plane rotation errors, ``(N,)`` each, degrees from 0 to 180.

    In plane is the twist about the true viewing ray, 0 where the predicted viewing direction is
    opposite to the true one, where the twist is undefined; out of plane the angle between both.
    """

    in_plane_deg: FloatArray
    out_of_plane_deg: FloatArray


def rotation_parts(q_hat: ArrayLike, t: ArrayLike, q: ArrayLike) -> RotationParts:
    """Decompose rotation errors into in-plane and out-of-plane parts.

    Half angles are computed by arctangents of the quaternion's parts, which is accurate for tiny
    angles and for those near 180 degrees.

    Args:
        q_hat: Predicted orientations ``(N, 4)``.
        t: True translations ``(N, 3)``; their length does not matter.
        q: True orientations ``(N, 4)``.

    Raises:
        TypeError: An argument is not of floating dtype.
        ValueError: A shape is wrong, a value is not finite, or a row is the zero vector.

    Examples:
        >>> half = np.sqrt(0.5)
        >>> parts = rotation_parts([[half, 0, 0, half]], [[0.0, 0, 9]], [[1.0, 0, 0, 0]])
        >>> float(parts.in_plane_deg[0].round(6)), float(parts.out_of_plane_deg[0].round(6))
        (90.0, 0.0)
    """
    rows = np.shape(q_hat)[:1]
    prediction, ray = _unit_rows("q_hat", q_hat, (*rows, 4)), _unit_rows("t", t, (*rows, 3))
    error = multiply(prediction, conjugate(_unit_rows("q", q, (*rows, 4))))
    w, v = error[:, 0], error[:, 1:]
    along = (v * ray).sum(axis=1)
    across = np.linalg.norm(np.cross(v, ray), axis=1)
    in_plane = 2 * np.arctan2(np.abs(along), np.abs(w))
    out_of_plane = 2 * np.arctan2(across, np.hypot(w, along))
    return RotationParts(np.degrees(in_plane), np.degrees(out_of_plane))


def rotation_error_vector(q_hat: ArrayLike, q: ArrayLike) -> FloatArray:
    """Return the rotation vectors ``r`` with ``R = exp([r]x) R_hat``, in the camera frame.

    ``(N, 3)`` radians, of length 0 to pi, for predicted and true orientations ``(N, 4)``; raises as
    `rotation_parts`.
    """
    shape = (*np.shape(q_hat)[:1], 4)
    prediction, truth = _unit_rows("q_hat", q_hat, shape), _unit_rows("q", q, shape)
    return rotation_vector(multiply(truth, conjugate(prediction)))


def _unit_rows(name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Check an argument, and return it in float64 with rows of unit norm."""
    array = np.asarray(values)
    if array.dtype.kind != "f":
        raise TypeError(f"{name}: expected a floating dtype, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    norm = np.linalg.norm(array.astype(np.float64), axis=1, keepdims=True)
    bad = np.flatnonzero(~(np.isfinite(norm) & (norm > 0)))
    if len(bad):
        row = array[bad[0]].tolist()
        raise ValueError(
            f"{name}: expected finite numbers, not all zero, got {row} in row {bad[0]}"
        )
    return np.asarray(array / norm)
