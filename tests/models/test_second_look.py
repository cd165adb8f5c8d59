"""What the second look's numbers mean: offsets, derivatives, covariances, rotation vectors."""

from functools import partial

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_t

from ffpose.models.second_look import (
    OFFSET_LIMIT,
    SecondLookOutput,
    covariance_of,
    covariances,
    in_front,
    offset_jacobian,
    offset_of,
    placed,
    points_at,
    sigma_loss,
)
from ffpose.models.virtual_camera import turn_to
from ffpose.nn.rotations import rotation_vector

COUNT = 12
SIZE, WIDTH = (16, 96), 64
T_CONSTANT = multivariate_t(shape=np.eye(3), df=4).logpdf(np.zeros(3))


@pytest.fixture
def generator():
    return np.random.default_rng(1)


@pytest.fixture
def view(generator):
    points = torch.from_numpy(generator.uniform((-4, -3, 8), (4, 3, 30), (COUNT, 3)))
    return turn_to(points, 3.0, SIZE, WIDTH, torch.from_numpy(generator.uniform(-3, 3, COUNT)))


def offsets(generator, most=2.8):
    """Offsets whose length across the ray is less than four for the default ``most``."""
    return torch.from_numpy(generator.uniform(-most, most, (COUNT, 3)))


def one_view(view, i):
    return view.of(slice(i, i + 1))


def point_seen(view, offset):
    """The point ``(3,)`` of one view for an offset ``(3,)``."""
    return points_at(offset[None], view)[0]


def test_the_point_that_was_turned_to_has_no_offset(view):
    middle = torch.zeros(COUNT, 3, dtype=torch.float64)
    middle[:, 2] = view.distance
    torch.testing.assert_close(offset_of(middle, view), torch.zeros_like(middle))


def test_offsets_by_hand(view):
    """Two at half the width to the right and below, four for a distance e times as large."""
    half = view.focal / WIDTH * 2  # of z / x, of z / y
    edges = torch.stack([1 / half, 1 / half, torch.ones(COUNT).double()], dim=-1)
    edges = edges / edges.norm(dim=-1, keepdim=True) * view.distance[:, None] * np.e
    expected = torch.tensor([2.0, 2.0, 4.0], dtype=torch.float64).expand(COUNT, 3)
    torch.testing.assert_close(offset_of(edges, view), expected)


def test_offsets_and_points_are_inverse(generator, view):
    offset = offsets(generator)
    points = points_at(offset, view)
    torch.testing.assert_close(offset_of(points, view), offset, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(
        points_at(offset_of(points, view), view), points, rtol=1e-12, atol=1e-12
    )


def test_offsets_out_of_the_view_are_brought_to_the_limit(view):
    wild = torch.tensor([[1e30, -1e30, 1e30]], dtype=torch.float64).expand(COUNT, 3)
    points = points_at(wild, view)
    limit = OFFSET_LIMIT * torch.tensor([0.5**0.5, -(0.5**0.5), 1.0], dtype=torch.float64)
    torch.testing.assert_close(points, points_at(limit.expand(COUNT, 3), view))
    assert points.isfinite().all()
    assert (points[:, 2] > 0).all()


def test_jacobian_is_autograds(generator, view):
    offset = offsets(generator)
    got = offset_jacobian(points_at(offset, view), view)
    for i in range(COUNT):
        alone = one_view(view, i)
        expected = torch.autograd.functional.jacobian(partial(point_seen, alone), offset[i])
        torch.testing.assert_close(got[i], expected, rtol=1e-10, atol=1e-10)


def numbers_for(offset, log_sigma):
    nothing = torch.zeros(len(offset))
    return SecondLookOutput(nothing[:, None], offset, log_sigma, nothing, torch.zeros(COUNT, 4))


def covariances_of(numbers, view):
    return covariances(placed(numbers, view))


def test_covariances_are_symmetric_and_positive(generator, view):
    log_sigma = torch.from_numpy(generator.uniform(-3, 1, (COUNT, 6)))
    # Out of the view as well: an uncertainty of zero would be a lie.
    for offset in (offsets(generator), offsets(generator, 40)):
        for matrix in covariances_of(numbers_for(offset, log_sigma), view):
            torch.testing.assert_close(matrix, matrix.mT, rtol=1e-12, atol=1e-15)
            assert (torch.linalg.eigvalsh(matrix) > 0).all()


def test_points_are_kept_before_the_camera():
    points = torch.tensor([[3.0, 4.0, -12.0], [0.0, 30.0, 0.0], [1.0, 2.0, 5.0]])
    expected = torch.tensor([[3.0, 4.0, 1.3], [0.0, 30.0, 3.0], [1.0, 2.0, 5.0]])
    torch.testing.assert_close(in_front(points), expected)


def test_translation_covariance_is_carried_by_the_jacobian(generator, view):
    offset, log_sigma = offsets(generator), torch.from_numpy(generator.uniform(-3, 1, (COUNT, 6)))
    got, _ = covariances_of(numbers_for(offset, log_sigma), view)
    for i in range(COUNT):
        seen = partial(point_seen, one_view(view, i))
        back = view.rotation[i].numpy().T
        jacobian = back @ torch.autograd.functional.jacobian(seen, offset[i]).numpy()
        expected = jacobian @ np.diag(np.exp(2 * log_sigma[i, :3].numpy())) @ jacobian.T
        np.testing.assert_allclose(got[i], expected, rtol=1e-9, atol=1e-12)


def test_rotation_covariance_is_that_of_sampled_attitudes(generator, view):
    """Errors drawn in the virtual frame, measured in the camera's, where R_true = exp(r) R."""
    sigma = np.array([0.002, 0.01, 0.03])
    log_sigma = torch.zeros(COUNT, 6, dtype=torch.float64)
    log_sigma[:, 3:] = torch.from_numpy(np.log(sigma))
    _, got = covariances_of(numbers_for(offsets(generator), log_sigma), view)
    for i in range(3):
        back = Rotation.from_matrix(view.rotation[i].numpy()).inv()
        seen = Rotation.random(rng=generator)
        errors = Rotation.from_rotvec(generator.normal(size=(20000, 3)) * sigma)
        true, estimated = back * errors * seen, back * seen
        drawn = np.cov((true * estimated.inv()).as_rotvec(), rowvar=False)
        np.testing.assert_allclose(drawn, got[i], atol=0.05 * sigma.max() ** 2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotation_vectors_are_scipys(generator, sign):
    axes = generator.normal(size=(60, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    angles = [0, 1e-12, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3, *np.linspace(0.1, np.pi - 1e-6, 53)]
    rotations = Rotation.from_rotvec(axes * np.array(angles)[:, None])
    q = torch.from_numpy(sign * rotations.as_quat(scalar_first=True))
    np.testing.assert_allclose(
        rotation_vector(q).numpy(), rotations.as_rotvec(), rtol=1e-10, atol=1e-15
    )


def test_a_half_turn_is_pi_about_its_axis_either_way():
    axis = np.array([0.6, 0.0, -0.8])
    got = rotation_vector(torch.tensor([[0.0, *axis], [0.0, *-axis]])).numpy()
    np.testing.assert_allclose(got, np.pi * np.array([axis, -axis]), rtol=1e-6)


def numbers_of(log_sigma, shear):
    nothing = torch.zeros(len(log_sigma))
    return SecondLookOutput(nothing[:, None], nothing[:, None], log_sigma, nothing, shear)


def t_log_likelihood(residual, covariance):
    """By SciPy, of a t distribution with four degrees of freedom."""
    pairs = zip(residual.numpy(), covariance.numpy(), strict=True)
    return np.array([multivariate_t(shape=shape, df=4).logpdf(part) for part, shape in pairs])


def test_sigma_loss_is_the_likelihood_of_a_t_distribution():
    residual = torch.tensor([[0.5, -2.0, 1.0, 0.2, -0.1, 3.0]], dtype=torch.float64)
    log_sigma = torch.tensor([[-1.0, 0.3, 0.0, 0.2, -2.0, 1.0]], dtype=torch.float64)
    expected = sum(
        t_log_likelihood(part, torch.diag_embed((2 * logs).exp()))
        for part, logs in zip(residual.split(3, 1), log_sigma.split(3, 1), strict=True)
    )
    got = -6 * sigma_loss(numbers_of(log_sigma, torch.zeros(1, 4)), residual) + 2 * T_CONSTANT
    np.testing.assert_allclose(got, expected)


def sheared(generator):
    """Log standard deviations, equal across the ray, and shears of both vectors."""
    log_sigma = torch.from_numpy(generator.uniform(-2, 1, (COUNT, 6)))
    log_sigma[:, 1], log_sigma[:, 4] = log_sigma[:, 0], log_sigma[:, 3]
    return log_sigma, torch.from_numpy(generator.uniform(-1, 1, (COUNT, 4)))


def test_a_shear_is_the_matrix_exponential_of_a_traceless_matrix(generator):
    log_sigma, shear = sheared(generator)
    got = covariance_of(log_sigma[:, :3], shear[:, :2])
    parts = (got.numpy(), log_sigma.numpy(), shear[:, :2].numpy())
    for matrix, sigma, (a, b) in zip(*parts, strict=True):
        across = np.exp(2 * sigma[0]) * expm(2 * np.array([[a, b], [b, -a]]))
        np.testing.assert_allclose(matrix[:2, :2], across, rtol=1e-12)
        np.testing.assert_allclose(matrix[2], [0, 0, np.exp(2 * sigma[2])], rtol=1e-12)
    plain = covariance_of(log_sigma[:, :3], torch.zeros(COUNT, 2))
    torch.testing.assert_close(plain, torch.diag_embed((2 * log_sigma[:, :3]).exp()))


def test_a_rotated_shear_is_the_covariance_of_rotated_vectors(generator):
    log_sigma, shear = sheared(generator)
    angle = 0.7
    turn, twice = (
        torch.from_numpy(Rotation.from_rotvec([0, 0, a]).as_matrix()) for a in (angle, 2 * angle)
    )
    got = covariance_of(log_sigma[:, :3], shear[:, :2] @ twice[:2, :2].T)
    torch.testing.assert_close(got, turn @ covariance_of(log_sigma[:, :3], shear[:, :2]) @ turn.T)


def test_sigma_loss_with_a_shear_is_the_likelihood_under_both_covariances(generator):
    log_sigma, shear = sheared(generator)
    residual = torch.from_numpy(generator.normal(size=(COUNT, 6)))
    numbers = numbers_of(log_sigma, shear)
    ahead = torch.tensor([[0.0, 0.0, 1.0]]).double().expand(COUNT, 3)
    view = turn_to(ahead, 1.0, SIZE, WIDTH)
    _, rotation = covariances_of(numbers._replace(offset=torch.zeros(COUNT, 3).double()), view)
    blocks = (covariance_of(log_sigma[:, :3], shear[:, :2]), rotation)
    expected = sum(
        t_log_likelihood(part, block)
        for block, part in zip(blocks, residual.split(3, 1), strict=True)
    )
    got = -6 * sigma_loss(numbers, residual) + 2 * T_CONSTANT
    np.testing.assert_allclose(got, expected)
