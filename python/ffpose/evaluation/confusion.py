"""Sides of the object that a network takes for each other: the turn that errors gather about."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffpose.geometry.rotations import (
    FloatArray,
    conjugate,
    multiply,
    rotation_vector,
    unit_quaternion,
)

LARGE_DEG, CONFUSED_DEG = 30.0, 15.0
"""Least error that counts as a confusion, and largest angle between two that are the same."""


class Confusion(NamedTuple):
    """A turn of the object that a network takes for the object as it stands.

    The attitude ``R`` is predicted as ``R`` after the turn, a rotation vector ``(3,)``, object
    frame, degrees; ``share`` of all predictions are within `CONFUSED_DEG` of that.
    """

    rotation_vector_deg: FloatArray
    share: float


def most_confused(q_hat: ArrayLike, q: ArrayLike) -> Confusion:
    """Find the turn of the object, of `LARGE_DEG` or more, that most predictions are off by.

    Where sides that look alike are taken for each other, errors gather about one turn, such as half
    a turn about the axis of a body with two wings. Of attitudes within a narrow range a constant
    answer's gather too, so a share means something beside that of a constant. Quaternions are
    ``(N, 4)``; the share is 0 if no error is so large.

    Examples:
        >>> truth = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0.6, 0.8, 0, 0]])
        >>> half_about_y = np.array([[0.0, 0, 1, 0]])
        >>> predicted = np.concatenate([multiply(truth[:2], half_about_y), truth[2:]])
        >>> turn, share = most_confused(predicted, truth)
        >>> np.abs(turn).round().tolist(), round(share, 2)
        ([0.0, 180.0, 0.0], 0.67)
    """
    turns = multiply(conjugate(unit_quaternion(q)), unit_quaternion(q_hat))
    large = turns[np.abs(turns[:, 0]) < np.cos(np.radians(LARGE_DEG) / 2)]
    if not len(large):
        return Confusion(np.zeros(3), 0.0)
    near = np.abs(large @ large.T) > np.cos(np.radians(CONFUSED_DEG) / 2)
    gathered = large[near[near.sum(axis=1).argmax()]]
    mean = np.linalg.eigh(gathered.T @ gathered)[1][:, -1]
    return Confusion(np.degrees(rotation_vector(mean)), len(gathered) / len(turns))
