"""Poses over time, and the algebra of rotations that they need."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry.frames import Pose

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of an object over time, between which it moves steadily.

    Attributes:
        times: ``(N,)`` seconds, increasing.
        t: Translations ``(N, 3)``, meters, camera frame.
        q: Unit quaternions ``(N, 4)``, ``(w, x, y, z)``.
        v: Velocities ``(N, 3)``, m/s, camera axes.
        w: Angular velocities relative to the camera ``(N, 3)``, rad/s, object's axes.
    """

    times: Floats
    t: Floats
    q: Floats
    v: Floats
    w: Floats

    @classmethod
    def through(cls, times: Floats, poses: Sequence[Pose]) -> Trajectory:
        """Return the trajectory through poses, with velocities by differences of neighbors."""
        t = np.array([pose.t for pose in poses])
        q = np.array([pose.q for pose in poses])
        count = len(times)
        before = np.maximum(np.arange(count) - 1, 0)
        after = np.minimum(np.arange(count) + 1, count - 1)
        span = np.where(after > before, times[after] - times[before], 1.0)[:, None]
        pairs = zip(q[before], q[after], strict=True)
        w = np.array([logarithm(product(conjugate(a), b)) for a, b in pairs])
        return cls(times, t, q, (t[after] - t[before]) / span, w / span)

    def pose(self, index: int, later: float = 0.0) -> Pose:
        """Return the pose ``later`` seconds after that of a row."""
        turned = product(self.q[index], exponential(self.w[index] * later))
        return Pose(self.t[index] + self.v[index] * later, turned / np.linalg.norm(turned))


def product(a: Floats, b: Floats) -> Floats:
    """Return Hamilton's product (4,) of two quaternions, scalar first."""
    (w, x, y, z), (i, j, k, m) = a, b
    return np.array(
        [
            w * i - x * j - y * k - z * m,
            w * j + x * i + y * m - z * k,
            w * k - x * m + y * i + z * j,
            w * m + x * k - y * j + z * i,
        ]
    )


def conjugate(q: Floats) -> Floats:
    """Return the inverse of a unit quaternion (4,)."""
    inverse: Floats = q * np.array([1.0, -1.0, -1.0, -1.0])
    return inverse


def exponential(v: Floats) -> Floats:
    """Return the unit quaternion (4,) of a rotation vector (3,), radians."""
    half = np.linalg.norm(v) / 2
    return np.array([math.cos(half), *(np.sinc(half / math.pi) / 2 * v)])


def logarithm(q: Floats) -> Floats:
    """Return the rotation vector (3,) of a unit quaternion, at most pi long; q and -q are one."""
    q = q if q[0] >= 0 else -q
    sine = np.linalg.norm(q[1:])
    angle = 2 * math.atan2(sine, q[0])
    return np.asarray(q[1:] * (angle / sine if sine > 0 else 2.0))
