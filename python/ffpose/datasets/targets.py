"""Targets: what the labels of a set locate, and so what a network learns from it.

Sets of spacecraft locate an object in the camera frame, and a network learns ``[t, q]``. Sets of
places (Cambridge Landmarks, 7Scenes) locate the camera in the world, and a network learns
``[c, q]``: the camera's center in the world, and the rotation from the world to the camera frame,
as PoseNet (Kendall et al., ICCV 2015) and Table 5 of Ye et al. (Sensors 2023, 23, 8633) do. The
same pose as ``[t, q]`` has ``t = -R(q) c``, whose errors grow with those of ``q`` and the distance
to the world's arbitrary origin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffpose.geometry import FloatArray, Pose, Target, camera_pose

__all__ = ["Target", "camera_pose", "spread", "to_pose", "to_vector"]


def to_vector(pose: Pose, target: Target) -> FloatArray:
    """Return a pose as the vector ``(7,)`` that a network learns: ``[t, q]``, or ``[c, q]``."""
    if target == "object":
        return pose.vector
    return np.concatenate([-pose.rotation.T @ pose.t, pose.q])


def to_pose(vector: ArrayLike, target: Target) -> Pose:
    """Return the pose of a vector ``(7,)``: the inverse of `to_vector`.

    Raises:
        TypeError: The values are not real numbers.
        ValueError: As `Pose`.
    """
    if target == "object":
        return Pose.from_vector(vector)
    values = np.asarray(vector, np.float64)
    return camera_pose(values[..., :3], values[..., 3:])


def spread(vectors: FloatArray) -> float:
    """Return the RMS distance of positions (the first three of ``(N, 7)``) from their mean.

    One where they do not vary.
    """
    deviation = vectors[:, :3] - vectors[:, :3].mean(axis=0)
    return float(np.sqrt(np.square(deviation).sum(axis=1).mean())) or 1.0
