"""Soft classification over Euler angles: laws, and SciPy's rotations."""

import itertools

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.nn.euler_bins import EulerBinsHead, euler_grid

COUNT = 12


def random_attitudes(count=200):
    q = Rotation.random(count, random_state=0).as_quat(scalar_first=True)
    return torch.from_numpy(q).float()


def angles_deg(q, other):
    turn = Rotation.from_quat(q, scalar_first=True).inv() * Rotation.from_quat(
        other, scalar_first=True
    )
    return np.degrees(turn.magnitude())


def test_the_bins_are_the_distinct_attitudes_of_the_grid():
    """Every node of the full grid, as SciPy turns it, is one bin and no two bins are the same."""
    count = 6
    steps = np.linspace(-1, 1, count)
    nodes = [(180 * y, 90 * p, 180 * r) for r, p, y in itertools.product(steps, repeat=3)]
    full = Rotation.from_euler("ZYX", nodes, degrees=True).as_quat(scalar_first=True)
    bins = euler_grid(count).numpy()
    np.testing.assert_allclose(np.abs(full @ bins.T).max(axis=1), 1.0, atol=1e-12)
    between = np.abs(bins @ bins.T) - np.eye(len(bins))
    assert between.max() < 1 - 1e-6


def test_soft_labels_add_up_to_one_and_are_the_same_for_both_signs():
    head, q = EulerBinsHead(COUNT), random_attitudes()
    labels = head.assign(q)
    torch.testing.assert_close(labels.sum(-1), torch.ones(len(q)))
    torch.testing.assert_close(head.assign(-q), labels)


def test_a_soft_label_is_the_papers_kernel():
    """For three bins, by NumPy in float64: exp(-(angle / pi)^2 / (2 s^2)), s^2 = (D / n)^2 / 12."""
    head, q = EulerBinsHead(COUNT, smoothing=3.0), random_attitudes(1)
    labels = head.assign(q)[0].double().numpy()
    turns = angles_deg(q.repeat(head.features, 1), euler_grid(COUNT)) / 180
    kernel = np.exp(-(turns**2) / (2 * (3.0 / COUNT) ** 2 / 12))
    np.testing.assert_allclose(labels, kernel / kernel.sum(), atol=1e-6)


def test_the_mean_of_a_soft_label_is_the_attitude_within_a_bin():
    head, q = EulerBinsHead(COUNT, smoothing=3.0), random_attitudes()
    found = head.decode(head.assign(q).log())
    assert angles_deg(q, found).max() < 360 / (COUNT - 1) / 2


def test_the_mean_is_the_principal_eigenvector():
    """Markley et al., equation 12, by NumPy's eigenvectors in float64."""
    head = EulerBinsHead(COUNT)
    raw = torch.randn(20, head.features, generator=torch.Generator().manual_seed(0)) * 3
    p, bins = raw.double().softmax(-1).numpy(), euler_grid(COUNT).numpy()
    _, vectors = np.linalg.eigh(np.einsum("bi,ij,ik->bjk", p, bins, bins))
    assert angles_deg(head.decode(raw), vectors[:, :, -1]).max() < 0.1


def test_the_loss_is_least_for_the_label_itself():
    head, q = EulerBinsHead(COUNT), random_attitudes(20)
    labels = head.assign(q)
    least = head.loss(labels.log(), q)
    torch.testing.assert_close(least, torch.special.entr(labels).sum(-1))
    other = head.loss(labels.log() + torch.randn_like(labels), q)
    assert bool((other > least).all())


@pytest.mark.parametrize("q", [(0.5**0.5, 0.0, 0.5**0.5, 0.0), (0.5**0.5, 0.0, -(0.5**0.5), 0.0)])
def test_a_pole_of_pitch_has_a_label_as_any_attitude(q):
    head, pole = EulerBinsHead(COUNT, smoothing=3.0), torch.tensor([q])
    label = head.assign(pole)
    torch.testing.assert_close(label.sum(), torch.tensor(1.0))
    assert angles_deg(pole, head.decode(label.log()))[0] < 360 / (COUNT - 1) / 2
