"""Orientation heads against SciPy: rotations, bins, harmonics, decoding, losses."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import log_softmax, softmax

from ffpose.models import build_network
from ffpose.nn.orientation import (
    NEAR_SQUARINGS,
    POWER_SQUARINGS,
    BinsHead,
    QuaternionHead,
    harmonics,
    mean_quaternion,
    super_fibonacci,
)
from ffpose.nn.rotations import quaternion_to_matrix

WIDTH_DEG = 7.0
SHARP = 80.0
"""Concentration of the Bingham logits ``SHARP (q . q0)^2``: a standard deviation of 9 degrees."""


@pytest.fixture
def generator():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def head():
    """Bins some 11 degrees apart; degree 2 holds the logits of the tests exactly."""
    return BinsHead(6000, degree=2, width_deg=WIDTH_DEG)


def quaternions(rotations):
    return torch.from_numpy(rotations.as_quat(scalar_first=True))


def degrees_between(q, q_hat):
    """Angles between unit quaternions, by SciPy."""
    a, b = (Rotation.from_quat(x.detach().double().numpy(), scalar_first=True) for x in (q, q_hat))
    return np.degrees((a.inv() * b).magnitude())


def coefficients(head, logits):
    """Project functions ``(B, bins)`` on the harmonics, float64 sums."""
    return (logits.double() @ head.basis.double().T / len(head.bins)).float()


def some_rotations(generator):
    """Any, tiny, and half turns about every axis, which each of the four expressions serves."""
    axes = np.concatenate([np.eye(3), -np.eye(3), generator.normal(size=(20, 3))])
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    return Rotation.concatenate(
        [
            Rotation.random(100, rng=generator),
            *(Rotation.from_rotvec(axes * a) for a in (0, 1e-9, np.pi - 1e-9, np.pi)),
        ]
    )


def test_matrices_and_quaternions_are_scipys(generator):
    rotations = some_rotations(generator)
    matrices = torch.from_numpy(rotations.as_matrix())
    q = quaternions(rotations)
    torch.testing.assert_close(quaternion_to_matrix(q), matrices, rtol=0, atol=1e-12)
    torch.testing.assert_close(quaternion_to_matrix(-q), matrices, rtol=0, atol=1e-12)


def test_batches_of_none():
    assert quaternion_to_matrix(torch.zeros(0, 4)).shape == (0, 3, 3)


@pytest.mark.parametrize("count", [100, 1000])
def test_a_spiral_is_spread_evenly(generator, count):
    q = super_fibonacci(count)
    torch.testing.assert_close(q.norm(dim=1), torch.ones(count).double(), rtol=0, atol=1e-12)
    second = (q.T @ q / count).numpy()  # of an even distribution: a quarter of the identity
    np.testing.assert_allclose(second, np.eye(4) / 4, atol=1 / count)
    # A cube of SO(3)'s volume, 8 pi^2, over the number of bins.
    side = np.degrees((8 * np.pi**2 / count) ** (1 / 3))
    dots = (q @ q.T).abs().fill_diagonal_(0).amax(1).clamp(max=1)
    nearest = np.degrees(2 * np.arccos(dots.numpy()))
    assert nearest.min() > 0.5 * side
    assert nearest.max() < 1.1 * side
    anywhere = quaternions(Rotation.random(3000, rng=generator))
    covered = np.degrees(2 * np.arccos((anywhere @ q.T).abs().amax(1).clamp(max=1).numpy()))
    assert covered.max() < side


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_harmonics_are_orthonormal_even_and_as_many_as_wigners(degree):
    q = super_fibonacci(400)
    basis = harmonics(q, degree)
    columns = sum((2 * n + 1) ** 2 for n in range(degree + 1))
    assert basis.shape == (400, columns)
    assert columns == (degree + 1) * (2 * degree + 1) * (2 * degree + 3) // 3
    identity = torch.eye(columns, dtype=torch.float64)
    torch.testing.assert_close(basis.T @ basis / 400, identity, rtol=0, atol=1e-12)
    flipped = q * torch.where(torch.arange(400) % 3 == 0, -1, 1)[:, None]
    torch.testing.assert_close(harmonics(flipped, degree), basis, rtol=0, atol=1e-10)


def outside(basis, functions):
    """The largest part of functions ``(N, F)`` that the basis does not hold."""
    return float((functions - basis @ (basis.T @ functions) / len(basis)).abs().max())


def test_harmonics_span_the_matrix_elements():
    """Wigner's functions of degree 1 are a rotation matrix's entries, those of 2 in products."""
    q = super_fibonacci(500)
    entries = torch.from_numpy(
        Rotation.from_quat(q.numpy(), scalar_first=True).as_matrix().reshape(-1, 9)
    )
    products = (entries[:, :, None] * entries[:, None]).flatten(1)
    cubes = (products[:, :, None] * entries[:, None]).flatten(1)
    first, second, third = (harmonics(q, degree) for degree in (1, 2, 3))
    assert outside(first, torch.cat([entries, torch.ones(500, 1)], dim=1)) < 1e-12
    assert outside(first, products) > 0.1
    assert outside(second, products) < 1e-11
    assert outside(second, cubes) > 0.1
    assert outside(third, cubes) < 1e-11


def test_harmonics_do_not_depend_on_the_order_of_the_attitudes(generator):
    """Nor do their signs, which the factorization leaves open."""
    q = super_fibonacci(300)
    order = torch.from_numpy(generator.permutation(300))
    torch.testing.assert_close(harmonics(q[order], 2), harmonics(q, 2)[order], rtol=0, atol=1e-10)


def test_too_few_attitudes_for_the_degree():
    harmonics(super_fibonacci(84), 3)
    with pytest.raises(ValueError, match=r"bins: expected at least 84, .* of degree 3, got 83"):
        BinsHead(83, 3)


def test_peaked_logits_decode_to_their_peak(head, generator):
    q = quaternions(Rotation.random(100, rng=generator)).float()
    raw = coefficients(head, SHARP * (q @ head.bins.T).square())
    torch.testing.assert_close(
        head.logits(raw), SHARP * (q @ head.bins.T).square(), rtol=0, atol=1e-3
    )
    decoded = head.decode(raw)
    torch.testing.assert_close(decoded.norm(dim=1), torch.ones(100))
    errors = degrees_between(q, decoded)
    assert errors.mean() < 0.4
    assert errors.max() < 1.0


def test_of_two_modes_one_is_chosen(head, generator):
    """A craft that looks the same after half a turn: the mean of both would be 90 degrees off."""
    a = Rotation.random(40, rng=generator)
    b = a * Rotation.from_rotvec([0, 0, np.pi])
    to_a, to_b = ((quaternions(each).float() @ head.bins.T).square() for each in (a, b))
    decoded = head.decode(coefficients(head, -SHARP * (1 - to_a) * (1 - to_b)))
    errors = np.stack([degrees_between(quaternions(each), decoded) for each in (a, b)])
    assert errors.min(axis=0).max() < 2.0
    assert (errors.argmin(axis=0) == 0).any()
    assert (errors.argmin(axis=0) == 1).any()


def test_even_and_wild_logits_decode_to_rotations(head):
    raw = torch.cat([torch.zeros(1, head.features), 1e4 * torch.randn(8, head.features)])
    torch.testing.assert_close(head.decode(raw).norm(dim=1), torch.ones(9))


def test_the_bins_loss_is_cross_entropy_with_soft_labels(head, generator):
    truth = Rotation.random(6, rng=generator)
    raw = torch.from_numpy(generator.normal(size=(6, head.features))).float()
    bins = Rotation.from_quat(head.bins.double().numpy(), scalar_first=True)
    logits = raw.double().numpy() @ head.basis.double().numpy()
    expected = []
    for i in range(6):
        angle = np.degrees((truth[i].inv() * bins).magnitude())
        target = softmax(-((angle / WIDTH_DEG) ** 2) / 2)
        expected.append(-(target * log_softmax(logits[i])).sum())
    q = quaternions(truth).float()
    np.testing.assert_allclose(head.loss(raw, q), expected, rtol=1e-3)
    torch.testing.assert_close(head.loss(raw, -q), head.loss(raw, q))


def test_the_bins_loss_grows_with_the_error(head, generator):
    truth = Rotation.random(20, rng=generator)
    raw = coefficients(head, SHARP * (quaternions(truth).float() @ head.bins.T).square())
    axes = generator.normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    losses = [
        head.loss(raw, quaternions(Rotation.from_rotvec(axes * np.radians(a)) * truth).float())
        for a in (0, 10, 30, 90, 180)
    ]
    assert (torch.stack(losses).diff(dim=0) > 0).all()


def test_what_is_trained_on_the_bins_loss_decodes_to_the_truth(head, generator):
    q = quaternions(Rotation.random(8, rng=generator)).float()
    raw = torch.zeros(8, head.features, requires_grad=True)
    optimizer = torch.optim.LBFGS([raw], max_iter=40, line_search_fn="strong_wolfe")

    def closure():
        optimizer.zero_grad()
        loss = head.loss(raw, q).mean()
        loss.backward()
        return loss

    before = float(closure().detach())
    optimizer.step(closure)
    assert closure().item() < before - 1
    assert degrees_between(q, head.decode(raw)).max() < 2.0


def test_no_table_of_the_bins_is_saved(head):
    assert not head.state_dict()


def test_four_numbers_are_normalized_and_of_either_sign():
    head = QuaternionHead()
    raw = torch.tensor([[0.0, 3.0, 0.0, -4.0]])
    expected = torch.tensor([[0.0, 0.6, 0.0, -0.8]])
    torch.testing.assert_close(head.decode(raw), expected)
    for q, distance in ((expected, 0.0), (-expected, 0.0), (torch.eye(4)[:1], 2**0.5)):
        torch.testing.assert_close(head.loss(raw, q), torch.tensor([distance]))


def test_a_head_starts_at_no_rotation():
    head = QuaternionHead()
    assert len(head.start) == head.features
    decoded = head.decode(torch.tensor([head.start]))
    torch.testing.assert_close(decoded.abs(), torch.eye(4)[:1])


def test_the_mean_of_half_precision_does_not_overflow():
    """The 16th power of the matrix of (1, 1, 1, 1) / 2, whose largest entry is scaled to 1."""
    q = torch.full((1, 4), 0.5, dtype=torch.float16)
    mean = mean_quaternion(q[:, :, None] * q[:, None], q, NEAR_SQUARINGS)
    assert mean.equal(q)


def test_autocast_decodes_in_float32(monkeypatch):
    torch.manual_seed(0)
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2, "orientation_head": "bins"}
    model = build_network("tiny", backbone_weights="none", **fields)
    regress, found = model.regress, []
    monkeypatch.setattr(model, "regress", lambda images: found.append(regress(images)) or found[-1])
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        pose = model(torch.randn(3, 3, 64, 64))
    assert found[0][1].dtype == torch.bfloat16
    assert pose.orientation.equal(model.orientation.decode(found[0][1].float()))
    assert pose.translation.dtype == torch.float32


@pytest.mark.parametrize("squarings", [POWER_SQUARINGS, NEAR_SQUARINGS])
def test_the_mean_of_quaternions_is_scipys(squarings):
    """The quaternions have either sign and lie up to 40 degrees around an attitude."""
    generator = np.random.default_rng(3)
    turns = generator.normal(size=(7, 3))
    turns *= np.linspace(0, np.radians(40), 7)[:, None] / np.linalg.norm(turns, axis=1)[:, None]
    rotations = Rotation.from_rotvec(turns) * Rotation.random(rng=generator)
    q = rotations.as_quat(scalar_first=True) * generator.choice([-1, 1], (7, 1))
    weights = generator.uniform(0.2, 1, 7)
    matrix = np.einsum("n,ni,nj->ij", weights, q, q)
    got = mean_quaternion(torch.from_numpy(matrix)[None], torch.from_numpy(q[:1]), squarings)
    expected = rotations.mean(weights)
    angle = (expected.inv() * Rotation.from_quat(got[0].numpy(), scalar_first=True)).magnitude()
    assert angle < 1e-9
