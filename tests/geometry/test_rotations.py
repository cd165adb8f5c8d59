"""Rotations of arrays, against SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.geometry import rotation_matrix
from ffpose.geometry.rotations import from_matrix


def rotations(count, seed=0):
    return Rotation.random(count, rng=np.random.default_rng(seed))


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


def test_rotation_matrix_is_scipys():
    rotation = rotations(50)
    np.testing.assert_allclose(rotation_matrix(wxyz(rotation)), rotation.as_matrix(), atol=1e-15)


def test_rotation_matrix_keeps_the_leading_axes():
    q = wxyz(rotations(6)).reshape(2, 3, 4)
    assert rotation_matrix(q).shape == (2, 3, 3, 3)
    np.testing.assert_array_equal(rotation_matrix(q)[1, 2], rotation_matrix(q[1, 2]))


def test_quaternions_of_rotations():
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.standard_normal(4)
        q /= np.linalg.norm(q)
        matrix = rotation_matrix(q)
        assert abs(from_matrix(matrix) @ q) == pytest.approx(1)
