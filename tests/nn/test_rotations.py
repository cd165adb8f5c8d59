"""The rotations of tensors are those of arrays, and both are SciPy's."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.geometry import rotations as arrays
from ffpose.nn import rotations as tensors


@pytest.fixture(scope="module")
def pair():
    random = Rotation.random(200, random_state=3)
    vectors = random.as_rotvec()
    vectors[:3] *= 1e-9  # tiny angles
    return Rotation.from_rotvec(vectors[:100]), random[100:]


def wxyz(rotation, sign=1.0):
    return sign * rotation.as_quat(scalar_first=True)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotation_vectors(pair, sign):
    q, expected = wxyz(pair[0], sign), pair[0].as_rotvec()
    np.testing.assert_allclose(arrays.rotation_vector(q), expected, rtol=1e-9, atol=1e-15)
    found = tensors.rotation_vector(torch.from_numpy(q)).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


def test_products(pair):
    first, second = pair
    expected = second * first
    product = arrays.multiply(wxyz(second), wxyz(first))
    np.testing.assert_allclose(arrays.rotation_matrix(product), expected.as_matrix(), atol=1e-12)
    tensor = tensors.quaternion_product(*(torch.from_numpy(wxyz(r)) for r in (second, first)))
    np.testing.assert_allclose(tensor.numpy(), product, atol=1e-15)


def test_matrices(pair):
    q = wxyz(pair[1])
    matrices = tensors.quaternion_to_matrix(torch.from_numpy(q))
    np.testing.assert_allclose(matrices.numpy(), arrays.rotation_matrix(q), atol=1e-15)
