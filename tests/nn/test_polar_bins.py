"""Orientation bins of angles and directions: geometry against SciPy, laws of a turned camera."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.nn.polar import interpolation
from ffpose.nn.polar_bins import PolarBinsHead, attitudes, cell_centers, sphere

LATENT, MAP, ANGLES, DIRECTIONS = 8, 6, 12, 40


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


def test_the_loss_is_the_cross_entropy_with_matrix_fisher_labels(head):
    """By the angles of SciPy: exp(k cos²(angle / 2)), which near the truth has the width."""
    raw = torch.randn(4, MAP * LATENT)
    truth = Rotation.random(4, rng=np.random.default_rng(0))
    q = torch.from_numpy(truth.as_quat(scalar_first=True)).float()
    angles = np.stack([(one.inv() * scipy(head.bins)).magnitude() for one in truth])
    label = np.exp(2 / math.radians(20) ** 2 * (np.cos(angles / 2) ** 2 - 1))
    label /= label.sum(1, keepdims=True)
    log_p = head.logits(raw).double().log_softmax(-1).detach().numpy()
    np.testing.assert_allclose(head.loss(raw, q).detach(), -(label * log_p).sum(1), rtol=1e-5)
    torch.testing.assert_close(head.loss(raw, -q), head.loss(raw, q))
