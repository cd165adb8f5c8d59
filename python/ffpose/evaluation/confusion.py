"""Sides of the object that a network takes for each other: the turn that errors gather about."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose.geometry.rotations import (
    FloatArray,
    conjugate,
    multiply,
    rotation_vector,
    unit_quaternion,
)

LARGE_DEG, CONFUSED_DEG = 30.0, 15.0
"""Least error that counts as a confusion, and largest angle between two that are the same."""


BLOCK = 1000
"""Number of errors that are compared with all others at once, as memory allows."""


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
    blocks = (large[start : start + BLOCK] for start in range(0, len(large), BLOCK))
    near = np.concatenate([_near(block, large).sum(axis=1) for block in blocks])
    gathered = large[_near(large[near.argmax()], large)]
    mean = np.linalg.eigh(gathered.T @ gathered)[1][:, -1]
    return Confusion(np.degrees(rotation_vector(mean)), len(gathered) / len(turns))


def _near(some: FloatArray, all_of_them: FloatArray) -> NDArray[np.bool_]:
    """Return which turns ``(N, 4)`` are the same as one, or as each of some."""
    return np.asarray(np.abs(some @ all_of_them.T) > np.cos(np.radians(CONFUSED_DEG) / 2))
