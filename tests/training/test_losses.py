"""Equations 9 to 11, worked out by hand and in NumPy."""

import math

import numpy as np
import pytest
import torch

from ffpose.training.losses import PoseLoss


def batch(count=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    t, t_hat = torch.randn(2, count, 3, generator=generator, dtype=torch.float64)
    q, q_hat = torch.randn(2, count, 4, generator=generator, dtype=torch.float64)
    return t_hat, q_hat, t, q / q.norm(dim=1, keepdim=True)


def test_one_sample_by_hand():
    # L_t = ||(3, 4, 0)|| = 5; q_hat normalizes to (0.6, 0.8, 0, 0), so L_q = ||(0.4, -0.8)||.
    terms = PoseLoss(s_t=math.log(2), s_q=0)(
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
    terms = PoseLoss()(t_hat, q_hat, t, q)
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
    terms = PoseLoss()(t_hat, q_hat, t, q)
    loss = PoseLoss(math.log(terms.translation), math.log(terms.orientation))
    loss(t_hat, q_hat, t, q).total.backward()
    assert float(loss.s_t.grad) == pytest.approx(0, abs=1e-6)
    assert float(loss.s_q.grad) == pytest.approx(0, abs=1e-6)
    assert {name for name, _ in loss.named_parameters()} == {"s_t", "s_q"}


@pytest.mark.parametrize("antipodal", [False, True])
def test_gradients_are_the_difference_quotients(antipodal):
    t_hat, q_hat, t, q = batch()
    loss = PoseLoss(antipodal=antipodal).double()
    inputs = (t_hat.requires_grad_(), q_hat.requires_grad_())
    assert torch.autograd.gradcheck(lambda a, b: loss(a, b, t, q).total, inputs)


def test_a_perfect_prediction_has_no_terms_and_finite_gradients():
    _, _, t, q = batch()
    t_hat, q_hat = t.clone().requires_grad_(), q.clone().requires_grad_()
    terms = PoseLoss()(t_hat, q_hat, t, q)
    terms.total.backward()
    assert float(terms.translation.detach()) == 0
    assert float(terms.orientation.detach()) == pytest.approx(0, abs=1e-15)
    assert t_hat.grad.isfinite().all()
    assert q_hat.grad.isfinite().all()


def test_the_norm_of_the_prediction_does_not_matter():
    t_hat, q_hat, t, q = batch()
    one, other = PoseLoss()(t_hat, q_hat, t, q), PoseLoss()(t_hat, 7 * q_hat, t, q)
    torch.testing.assert_close(one, other)


def test_antipodal_takes_both_signs_for_one():
    t_hat, q_hat, t, q = batch()
    plain, antipodal = PoseLoss(), PoseLoss(antipodal=True)
    mirrored = torch.tensor([[1.0], [-1.0], [1.0], [-1.0], [1.0]]) * q_hat
    torch.testing.assert_close(antipodal(t_hat, q_hat, t, q), antipodal(t_hat, mirrored, t, q))
    assert float(antipodal(t_hat, -q, t, q).orientation) == pytest.approx(0, abs=1e-15)
    assert float(plain(t_hat, -q, t, q).orientation) == pytest.approx(2)


@pytest.mark.parametrize(
    ("place", "shape", "name"),
    [(0, (5, 4), "t_hat"), (1, (5, 3), "q_hat"), (2, (1, 3), "t"), (3, (4,), "q")],
)
def test_shapes_are_not_broadcast(place, shape, name):
    tensors = list(batch())
    tensors[place] = torch.ones(shape)
    with pytest.raises(ValueError, match=rf"^{name}: expected shape \(B, \d\)"):
        PoseLoss()(*tensors)


def test_an_empty_batch_has_no_mean():
    with pytest.raises(ValueError, match="B >= 1"):
        PoseLoss()(torch.ones(0, 3), torch.ones(0, 4), torch.ones(0, 3), torch.ones(0, 4))
