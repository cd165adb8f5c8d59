"""The hypernetwork head and the quaternion activation."""

import pytest
import torch

from ffpose.nn import HyperHead, QuaternionActivation


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def test_a_new_head_is_its_static_part():
    head, z = HyperHead(6, 3, hidden=16, mlp_dim=5), torch.randn(4, 6)
    torch.testing.assert_close(head(z), head.static(z))


def test_the_generated_layer_by_a_loop():
    head, z = HyperHead(6, 3, hidden=16, mlp_dim=5), torch.randn(4, 6)
    for parameter in head.parameters():
        torch.nn.init.normal_(parameter)
    for one, result in zip(z, head(z), strict=True):
        generated = head.generator(one).view(3, 6)
        hidden = torch.nn.functional.silu(head.features[0](one))
        expected = head.static(one) + generated[:, :5] @ hidden + generated[:, 5]
        torch.testing.assert_close(result, expected)


def test_gradients_reach_the_generator_at_once_and_its_inputs_soon():
    head, z = HyperHead(6, 3, hidden=16, mlp_dim=5), torch.randn(4, 6)
    optimizer = torch.optim.SGD(head.parameters(), 0.1)
    for _ in range(2):
        optimizer.zero_grad()
        head(z).square().sum().backward()
        optimizer.step()
    assert all(parameter.grad.any() for parameter in head.parameters())


def test_z_of_another_shape():
    with pytest.raises(ValueError, match=r"z: expected shape \(B, 6\), got \(4, 5\)"):
        HyperHead(6, 3)(torch.zeros(4, 5))


def test_activation_gives_unit_quaternions():
    q = torch.tensor([[0.0, 3.0, 0.0, -4.0], [2.0, 0.0, 0.0, 0.0]])
    expected = torch.tensor([[0.0, 0.6, 0.0, -0.8], [1.0, 0.0, 0.0, 0.0]])
    for mode in (True, False):
        torch.testing.assert_close(QuaternionActivation().train(mode)(q), expected)


def test_zero_is_an_error_in_training_and_the_identity_when_deployed():
    q = torch.tensor([[1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"\b1\b"):
        QuaternionActivation().train()(q)
    deployed = QuaternionActivation().eval()
    expected = torch.tensor([[0.5, 0.5, 0.5, 0.5], [1.0, 0.0, 0.0, 0.0]])
    torch.testing.assert_close(deployed(q), expected)
    exported = torch.export.export(deployed, (torch.ones(2, 4),)).module()
    torch.testing.assert_close(exported(q), expected)


def test_nan_is_not_hidden():
    q = torch.full((1, 4), torch.nan)
    assert QuaternionActivation().eval()(q).isnan().all()
