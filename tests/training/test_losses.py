"""Equations 9 to 11, worked out by hand and in NumPy."""

import math

import numpy as np
import pytest
import torch

from ffpose.ops import normalize_quaternion
from ffpose.training.losses import JointLoss


def batch(count=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    t, t_hat = torch.randn(2, count, 3, generator=generator, dtype=torch.float64)
    q, q_hat = torch.randn(2, count, 4, generator=generator, dtype=torch.float64)
    return t_hat, q_hat, t, q / q.norm(dim=1, keepdim=True)


def terms_of(loss, t_hat, q_hat, t, q):
    """Eq. 9 to 11 of a batch, as a network with the paper's heads is trained."""
    translation = torch.linalg.vector_norm(t - t_hat, dim=-1)
    orientation = loss.quaternion_distance(normalize_quaternion(q_hat), q)
    return loss.joined(translation.mean(), orientation.mean())


def test_one_sample_by_hand():
    # L_t = ||(3, 4, 0)|| = 5; q_hat normalizes to (0.6, 0.8, 0, 0), so L_q = ||(0.4, -0.8)||.
    terms = terms_of(
        JointLoss(s_t=math.log(2), s_q=0),
        torch.tensor([[3.0, 4.0, 9.0]]),
        torch.tensor([[3.0, 4.0, 0.0, 0.0]]),
        torch.tensor([[0.0, 0.0, 9.0]]),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
    )
    assert float(terms.translation) == pytest.approx(5)
    assert float(terms.orientation) == pytest.approx(math.sqrt(0.8))
    assert float(terms.total.detach()) == pytest.approx(5 / 2 + math.log(2) + math.sqrt(0.8))


def test_terms_are_means_over_the_batch():
    t_hat, q_hat, t, q = batch()
    terms = terms_of(JointLoss(), t_hat, q_hat, t, q)
    unit = q_hat.numpy() / np.linalg.norm(q_hat.numpy(), axis=1, keepdims=True)
    translation = np.linalg.norm(t.numpy() - t_hat.numpy(), axis=1).mean()
    orientation = np.linalg.norm(q.numpy() - unit, axis=1).mean()
    assert float(terms.translation) == pytest.approx(translation)
    assert float(terms.orientation) == pytest.approx(orientation)
    total = translation * math.exp(3) - 3 + orientation * math.exp(6.5) - 6.5
    assert float(terms.total.detach()) == pytest.approx(total, rel=1e-6)


def test_weights_learn_toward_the_log_of_their_term():
    # d/ds (L exp(-s) + s) = 1 - L exp(-s) vanishes at s = log L.
    t_hat, q_hat, t, q = batch()
    terms = terms_of(JointLoss(), t_hat, q_hat, t, q)
    loss = JointLoss(None, math.log(terms.translation), math.log(terms.orientation))
    terms_of(loss, t_hat, q_hat, t, q).total.backward()
    assert float(loss.s_t.grad) == pytest.approx(0, abs=1e-6)
    assert float(loss.s_q.grad) == pytest.approx(0, abs=1e-6)
    assert {name for name, _ in loss.named_parameters()} == {"s_t", "s_q"}


@pytest.mark.parametrize("antipodal", [False, True])
def test_gradients_are_the_difference_quotients(antipodal):
    t_hat, q_hat, t, q = batch()
    loss = JointLoss(antipodal=antipodal).double()
    inputs = (t_hat.requires_grad_(), q_hat.requires_grad_())
    assert torch.autograd.gradcheck(lambda a, b: terms_of(loss, a, b, t, q).total, inputs)


def test_a_perfect_prediction_has_no_terms_and_finite_gradients():
    _, _, t, q = batch()
    t_hat, q_hat = t.clone().requires_grad_(), q.clone().requires_grad_()
    terms = terms_of(JointLoss(), t_hat, q_hat, t, q)
    terms.total.backward()
    assert float(terms.translation.detach()) == 0
    assert float(terms.orientation.detach()) == pytest.approx(0, abs=1e-15)
    assert t_hat.grad.isfinite().all()
    assert q_hat.grad.isfinite().all()


def test_the_norm_of_the_prediction_does_not_matter():
    t_hat, q_hat, t, q = batch()
    one, other = (terms_of(JointLoss(), t_hat, k * q_hat, t, q) for k in (1, 7))
    torch.testing.assert_close(one, other)


def test_antipodal_takes_both_signs_for_one():
    t_hat, q_hat, t, q = batch()
    plain, antipodal = JointLoss(), JointLoss(antipodal=True)
    mirrored = torch.tensor([[1.0], [-1.0], [1.0], [-1.0], [1.0]]) * q_hat
    torch.testing.assert_close(*(terms_of(antipodal, t_hat, q_, t, q) for q_ in (q_hat, mirrored)))
    assert float(terms_of(antipodal, t_hat, -q, t, q).orientation) == pytest.approx(0, abs=1e-15)
    assert float(terms_of(plain, t_hat, -q, t, q).orientation) == pytest.approx(2)


def test_fixed_weights_are_no_parameters():
    loss = JointLoss((2.0, 10.0))
    assert list(loss.parameters()) == []
    assert float(loss.joined(torch.tensor(3.0), torch.tensor(0.5)).total) == 11
