"""What no looking achieves: a constant answer, and two oracles that know one part of the truth.

A model that does not beat the mean pose has not learned to look. One whose rotation error is that
of an oracle has learned at most the part that the oracle knows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffpose.attitude import remove_in_plane_error, remove_out_of_plane_error

FloatArray = NDArray[np.float64]


def mean_pose(poses: FloatArray) -> FloatArray:
    """Return the mean of poses ``(N, 7)``: a pose ``(7,)`` with ``qw >= 0``.

    The orientation is the quaternion whose squared chordal distances to all others have the least
    sum, whatever their signs: the principal eigenvector of the sum of ``q qᵀ`` (Markley et al.,
    "Averaging Quaternions", 2007).

    Raises:
        ValueError: There are no poses.
    """
    if len(poses) == 0:
        raise ValueError("mean pose: expected at least one pose, got none")
    q = poses[:, 3:]
    _, vectors = np.linalg.eigh(q.T @ q)
    orientation = vectors[:, -1] if vectors[0, -1] >= 0 else -vectors[:, -1]
    return np.concatenate([poses[:, :3].mean(axis=0), orientation])


def oracles(truth: FloatArray, constant: FloatArray) -> dict[str, FloatArray]:
    """Return the poses of two oracles that answer a constant attitude, but for what they know.

    Args:
        truth: True poses ``(N, 7)``.
        constant: The constant pose ``(7,)``.

    Returns:
        Poses ``(N, 7)`` with the true translations. ``in_plane_known``: the constant attitude,
        turned about the true viewing ray until no in-plane error is left, so that it keeps its
        viewing direction; its rotation error is the constant's out-of-plane error.
        ``out_of_plane_known``: the true attitude, turned about the true viewing ray by the
        in-plane error of the constant one, which is its rotation error.
    """
    t, q = truth[:, :3], truth[:, 3:]
    attitude = np.broadcast_to(constant[3:], q.shape)
    answers = {
        "in_plane_known": remove_in_plane_error(t, q, attitude),
        "out_of_plane_known": remove_out_of_plane_error(t, q, attitude),
    }
    return {name: np.concatenate([t, answer], axis=1) for name, answer in answers.items()}
