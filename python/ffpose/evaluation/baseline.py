"""Baselines that ignore the image: the mean pose, and two oracles that know part of the truth.

A model that does not beat the mean pose has learned nothing from the image. One whose rotation
error equals that of an oracle has learned at most the part that the oracle knows.
"""

from __future__ import annotations

import numpy as np

from ffpose.arrays import canonical_quaternion
from ffpose.evaluation.attitude import remove_in_plane_error, remove_out_of_plane_error
from ffpose.geometry import FloatArray


def mean_pose(poses: FloatArray) -> FloatArray:
    """Return the mean pose ``(7,)`` of poses ``(N, 7)``, with ``qw >= 0``.

    The orientation is the principal eigenvector of the sum of ``q qᵀ``, which is regardless of
    signs (Markley et al., "Averaging Quaternions", 2007).

    Raises:
        ValueError: There are no poses.
    """
    if len(poses) == 0:
        raise ValueError("mean pose: expected at least one pose, got none")
    q = poses[:, 3:]
    _, vectors = np.linalg.eigh(q.T @ q)
    orientation = np.asarray(canonical_quaternion(vectors[:, -1].copy()))
    return np.concatenate([poses[:, :3].mean(axis=0), orientation])


def oracles(constant: FloatArray, truth: FloatArray) -> dict[str, FloatArray]:
    """Return the poses ``(N, 7)`` of two oracles, for a constant pose ``(7,)`` and true ones.

    Both have the true translations. ``in_plane_known`` is the constant attitude rotated about the
    true viewing ray so that its in-plane error vanishes; its rotation error is the constant's
    out-of-plane error. ``out_of_plane_known`` is the true attitude rotated about the ray by the
    constant's in-plane error, which is its rotation error.
    """
    t, q = truth[:, :3], truth[:, 3:]
    attitude = np.broadcast_to(constant[3:], q.shape)
    answers = {
        "in_plane_known": remove_in_plane_error(attitude, t, q),
        "out_of_plane_known": remove_out_of_plane_error(attitude, t, q),
    }
    return {name: np.concatenate([t, answer], axis=1) for name, answer in answers.items()}
