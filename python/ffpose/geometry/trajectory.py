"""Poses over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffpose.geometry.pose import Pose
from ffpose.geometry.rotations import (
    FloatArray,
    conjugate,
    from_rotation_vector,
    multiply,
    rotation_vector,
)


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

    times: FloatArray
    t: FloatArray
    q: FloatArray
    v: FloatArray
    w: FloatArray

    @classmethod
    def through(cls, times: FloatArray, poses: Sequence[Pose]) -> Trajectory:
        """Return the trajectory through poses, with velocities by differences of neighbors.

        One pose alone stands still; of none the arrays are empty.
        """
        t = np.array([pose.t for pose in poses]).reshape(-1, 3)
        q = np.array([pose.q for pose in poses]).reshape(-1, 4)
        count = len(times)
        before = np.maximum(np.arange(count) - 1, 0)
        after = np.minimum(np.arange(count) + 1, count - 1)
        span = np.where(after > before, times[after] - times[before], 1.0)[:, None]
        w = rotation_vector(multiply(conjugate(q[before]), q[after]))
        return cls(times, t, q, (t[after] - t[before]) / span, w / span)

    def pose(self, index: int, later: float = 0.0) -> Pose:
        """Return the pose ``later`` seconds after that of a row."""
        turned = multiply(self.q[index], from_rotation_vector(self.w[index] * later))
        return Pose(self.t[index] + self.v[index] * later, turned / np.linalg.norm(turned))
