"""Orientation bins of angles and directions: geometry against SciPy, laws of a turned camera."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.nn.orientation import NEIGHBORHOOD_DEG
from ffpose.nn.polar import interpolation
from ffpose.nn.polar_bins import MODE_DEG, PolarBinsHead, attitudes, cell_centers, sphere

LATENT, MAP, ANGLES, DIRECTIONS = 8, 6, 12, 40


def bins_of(head):
    """The quaternions of a head's bins."""
    return attitudes(cell_centers(len(head.halves)), sphere(head.weight.shape[1])).flatten(0, 1)


@pytest.fixture
def head():
    torch.manual_seed(0)
    head = PolarBinsHead(LATENT, cell_centers(MAP) + 0.1, ANGLES, DIRECTIONS, 20.0)
    torch.nn.init.normal_(head.weight)
    torch.nn.init.normal_(head.bias)
    return head


def scipy(q):
    return Rotation.from_quat(q.detach().double().numpy(), scalar_first=True)


def test_directions_are_unit_vectors_spread_evenly():
    points = sphere(400)
    torch.testing.assert_close(points.norm(dim=1), torch.ones(400).double())
    assert points.mean(0).norm() < 0.01
    nearest = (points @ points.T - 2 * torch.eye(400)).amax(1).arccos()
    even = math.sqrt(4 * math.pi / 400)  # the side of a square of one point's area
    assert nearest.min() > 0.7 * even
    assert nearest.max() < 1.2 * even


def test_attitudes_turn_least_and_then_about_the_axis():
    """Least rotations are SciPy's about the cross product; the rest is one about z."""
    angles, directions = cell_centers(5), sphere(30)
    got = scipy(attitudes(angles, directions).flatten(0, 1)).as_matrix().reshape(5, 30, 3, 3)
    for j, d in enumerate(directions.numpy()):
        axis = np.cross(d, [0, 0, 1])
        axis *= math.acos(d[2]) / np.linalg.norm(axis)
        least = Rotation.from_rotvec(axis)
        np.testing.assert_allclose(least.apply(d), [0, 0, 1], atol=1e-12)
        for k, angle in enumerate(angles):
            expected = Rotation.from_rotvec([0, 0, float(angle)]) * least
            np.testing.assert_allclose(got[k, j], expected.as_matrix(), atol=1e-12)


def test_interpolation_is_exact_for_a_band_limited_function():
    def function(angle):
        return 1 + (2 * angle).cos() - 0.5 * (5 * angle + 0.3).sin()

    at, to = cell_centers(12) + 0.2, cell_centers(36)
    torch.testing.assert_close(interpolation(at, to) @ function(at), function(to))
    at = cell_centers(11)
    torch.testing.assert_close(interpolation(at, to) @ function(at), function(to))


def test_a_shift_of_the_features_is_a_turn_of_the_camera(head):
    """By one angle of the map, which is two of the bins."""
    raw = torch.randn(3, MAP * LATENT)
    turned = raw.unflatten(1, (MAP, LATENT)).roll(1, 1).flatten(1)
    logits = head.logits(raw).unflatten(1, (ANGLES, DIRECTIONS))
    got = head.logits(turned).unflatten(1, (ANGLES, DIRECTIONS))
    torch.testing.assert_close(got, logits.roll(ANGLES // MAP, 1), rtol=1e-5, atol=1e-5)
    turn = Rotation.from_rotvec([0, 0, 2 * math.pi / MAP])
    expected = turn * scipy(head.decode(raw))
    assert (expected.inv() * scipy(head.decode(turned))).magnitude().max() < 1e-5


def test_a_bin_of_all_weight_is_decoded(head):
    """Features that say one angle and one direction give that bin's attitude."""
    with torch.no_grad():
        head.bias.zero_()
        head.weight.zero_()
        head.weight[0, 17] = 1
    # A sum of cosines through the map's angles whose peak is at a bin's.
    peak = cell_centers(ANGLES)[4]
    away = cell_centers(MAP) + 0.1 - peak
    values = away.cos() + 2 * (2 * away).cos()
    raw = torch.zeros(1, MAP, LATENT)
    raw[0, :, 0] = 1000 * values.float()
    got = scipy(head.decode(raw.flatten(1)))
    expected = scipy(attitudes(peak[None], sphere(DIRECTIONS)[17:18])[0])
    assert (expected.inv() * got).magnitude().max() < 1e-4


def test_the_attitude_is_the_mean_near_the_most_likely_bin(head):
    raw, bins = 0.3 * torch.randn(6, MAP * LATENT), scipy(bins_of(head))
    for row, got in zip(
        head.logits(raw).double().softmax(-1), scipy(head.decode(raw)), strict=True
    ):
        p = row.detach().numpy()
        near = (bins[int(p.argmax())].inv() * bins).magnitude() < math.radians(NEIGHBORHOOD_DEG)
        assert near.sum() > 5
        expected = bins[near].mean(weights=p[near])
        assert (expected.inv() * got).magnitude() < 1e-5


def test_the_loss_is_the_cross_entropy_with_matrix_fisher_labels(head):
    """By the angles of SciPy: exp(k cos²(angle / 2)), which near the truth has the width."""
    raw = torch.randn(4, MAP * LATENT)
    truth = Rotation.random(4, rng=np.random.default_rng(0))
    q = torch.from_numpy(truth.as_quat(scalar_first=True)).float()
    angles = np.stack([(one.inv() * scipy(bins_of(head))).magnitude() for one in truth])
    label = np.exp(2 / math.radians(20) ** 2 * (np.cos(angles / 2) ** 2 - 1))
    label /= label.sum(1, keepdims=True)
    log_p = head.logits(raw).double().log_softmax(-1).detach().numpy()
    np.testing.assert_allclose(head.loss(raw, q).detach(), -(label * log_p).sum(1), rtol=1e-5)
    torch.testing.assert_close(head.loss(raw, -q), head.loss(raw, q))


def peaked(head, *peaks):
    """Let a head give peaks of named heights about named turns, Gaussians of 8 degrees.

    Returns:
        The probability that bins near a turn have, as a function of it.
    """
    bins = scipy(bins_of(head))

    def angles(turn):
        return np.degrees((Rotation.from_rotvec(turn, degrees=True).inv() * bins).magnitude())

    total = sum(height * np.exp(-0.5 * (angles(turn) / 8) ** 2) for height, turn in peaks) + 1e-30
    head.logits = lambda raw: torch.tensor(np.log(total)).float().expand(len(raw), -1)
    return lambda turn: total[angles(turn) < MODE_DEG].sum() / total.sum()


@pytest.mark.parametrize("height", [0.3, 0.01])
def test_the_second_of_two_peaks_is_the_alternative_and_both_have_their_mass(height):
    head = PolarBinsHead(LATENT, cell_centers(MAP), 24, 300, 20.0)
    turns = [10.0, 0.0, 0.0], [100.0, 90.0, 30.0]
    mass = peaked(head, (1.0, turns[0]), (height, turns[1]))
    modes = head.modes(torch.zeros(2, LATENT * MAP))
    for got, turn, probability in zip(modes[:2], turns, modes.probabilities.T, strict=True):
        away = scipy(got) * Rotation.from_rotvec(turn, degrees=True).inv()
        assert np.degrees(away.magnitude()).max() < 3  # a peak is of a few bins
        np.testing.assert_allclose(probability, mass(turn), rtol=0.05)
    assert 0.95 < modes.probabilities[0].sum() <= 1
    torch.testing.assert_close(modes.orientation, head.decode(torch.zeros(2, LATENT * MAP)))


def test_a_shoulder_of_the_first_peak_is_no_second_mode():
    """What is likelier but closer than twice the radius of a mode belongs to no other mode."""
    head = PolarBinsHead(LATENT, cell_centers(MAP), 24, 300, 20.0)
    far = [0.0, 0.0, 150.0]
    mass = peaked(head, (1.0, [0.0, 0, 0]), (0.5, [0.0, 45.0, 0]), (0.1, far))
    modes = head.modes(torch.zeros(1, LATENT * MAP))
    away = scipy(modes.alternative) * Rotation.from_rotvec(far, degrees=True).inv()
    assert np.degrees(away.magnitude()) < 4
    np.testing.assert_allclose(modes.probabilities[0, 1], mass(far), rtol=0.05)


def test_probabilities_of_sharp_peaks_are_at_most_one():
    """Sums of float32 alone are above one in a third of these, of which frames were refused."""
    head = PolarBinsHead(LATENT, cell_centers(MAP), 48, 500, 8.0)
    generator = torch.Generator().manual_seed(0)
    q = torch.nn.functional.normalize(torch.randn(200, 4, generator=generator), dim=1)
    head.logits = lambda raw: 300 * (q @ bins_of(head).float().T).square()
    found = head.modes(torch.zeros(200, LATENT * MAP)).probabilities
    assert 0.999 < found.sum(1).min() < found.max() == 1


def test_a_certain_attitude_has_a_finite_alternative():
    head = PolarBinsHead(LATENT, cell_centers(MAP), ANGLES, DIRECTIONS, 20.0)
    logits = torch.full((1, len(bins_of(head))), -500.0)
    logits[0, 7] = 500.0
    head.logits = lambda raw: logits
    modes = head.modes(torch.zeros(1, LATENT * MAP))
    torch.testing.assert_close(modes.orientation.abs(), bins_of(head)[7:8].float().abs())
    torch.testing.assert_close(modes.alternative.norm(dim=1), torch.ones(1))
    torch.testing.assert_close(modes.probabilities, torch.tensor([[1.0, 0.0]]))
