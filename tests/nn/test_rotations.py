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


def test_toward_is_the_least_rotation_that_takes_the_axis_there():
    generator = np.random.default_rng(0)
    rays = generator.normal(size=(200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = rays[rays[:, 2] > np.cos(np.radians(170))]
    points = torch.from_numpy(rays * generator.uniform(0.1, 9, (len(rays), 1)))
    matrices = tensors.quaternion_to_matrix(tensors.toward(points)).numpy()
    unit = np.broadcast_to(np.eye(3), matrices.shape)
    np.testing.assert_allclose(matrices @ matrices.swapaxes(1, 2), unit, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, rtol=1e-12)
    np.testing.assert_allclose(matrices @ [0, 0, 1], rays, atol=1e-12)
    angles = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    np.testing.assert_allclose(Rotation.from_matrix(matrices).magnitude(), angles, atol=1e-12)


def test_toward_the_axis_itself_turns_nothing():
    assert tensors.toward(torch.tensor([[0.0, 0.0, 7.0]])).tolist() == [[1.0, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize(("axis", "name"), [(1, "x"), (2, "y"), (3, "z")])
def test_a_turn_is_about_its_axis(axis, name):
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, 20)
    expected = Rotation.from_euler(name, angles[:, None]).as_quat(scalar_first=True)
    got = tensors.turned_about_axis(torch.from_numpy(angles), axis).numpy()
    np.testing.assert_allclose(got, expected, atol=1e-12)
