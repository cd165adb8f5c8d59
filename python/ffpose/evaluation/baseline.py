"""The mean pose: a model that does not beat it has learned nothing from the image."""

from __future__ import annotations

import numpy as np

from ffpose.arrays import canonical_quaternion
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
