"""Muon, against NumPy's singular value decomposition and torch's own AdamW."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from torch import nn

from ffpose.models import build_network
from ffpose.training.config import OptimizerConfig
from ffpose.training.losses import JointLoss
from ffpose.training.muon import matrices, orthogonalized
from ffpose.training.run import build_optimizer

RATE = 0.1


def optimizer(model, weight_decay=0.0):
    config = OptimizerConfig(kind="muon", learning_rate=RATE, weight_decay=weight_decay, eps=1e-8)
    return build_optimizer(model, JointLoss(), config)


def random_gradients(model, generator):
    for parameter in model.parameters():
        parameter.grad = torch.randn(parameter.shape, generator=generator)


@pytest.mark.parametrize("shape", [(20, 20), (12, 40), (40, 12), (1, 8)])
def test_singular_values_become_nearly_one_and_singular_vectors_stay(shape):
    rng = np.random.default_rng(0)
    u, _, v = np.linalg.svd(rng.normal(size=shape), full_matrices=False)
    values = np.geomspace(1, 0.05, len(v))
    found = orthogonalized(torch.tensor((u * values) @ v)).numpy()
    turned = u.T @ found @ v.T  # diagonal, if the singular vectors are the same
    diagonal = np.diag(turned)
    np.testing.assert_allclose(turned, np.diag(diagonal), atol=1e-12)
    assert found.shape == shape
    assert diagonal.min() > 0.6
    assert diagonal.max() < 1.25


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_length_of_the_gradient_does_not_count(scale):
    matrix = torch.randn(6, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(orthogonalized(scale * matrix), orthogonalized(matrix))


def test_no_gradient_is_no_step():
    assert torch.equal(orthogonalized(torch.zeros(3, 4)), torch.zeros(3, 4))


def test_first_step_of_a_matrix_is_as_long_as_adams():
    """About 0.2 learning rates each weight in the root mean square, as Liu et al. measured."""
    model = nn.Linear(64, 32, bias=False)
    before = model.weight.detach().clone()
    random_gradients(model, torch.Generator().manual_seed(2))
    optimizer(model).step()
    step = (model.weight.detach() - before) / RATE
    assert 0.15 < float(step.square().mean().sqrt()) < 0.25
    assert float((step * model.weight.grad).sum()) < 0


def test_constant_gradients_are_followed_as_by_momentum_alone():
    """Momentum adds up to the gradient's direction, so each step is the first one again."""
    model = nn.Conv2d(8, 16, 3, bias=False)
    gradient = torch.randn(model.weight.shape, generator=torch.Generator().manual_seed(3))
    taken, steps = optimizer(model), []
    for _ in range(4):
        before = model.weight.detach().clone()
        model.weight.grad = gradient.clone()
        taken.step()
        steps.append(model.weight.detach() - before)
    torch.testing.assert_close(steps[3], steps[0], rtol=1e-4, atol=1e-5)


def test_weight_decay_shrinks_matrices_as_it_does_other_weights():
    model = nn.Sequential(nn.Linear(8, 8), nn.LayerNorm(8))
    before = {name: value.clone() for name, value in model.state_dict().items()}
    for parameter in model.parameters():
        parameter.grad = torch.zeros_like(parameter)
    optimizer(model, weight_decay=0.1).step()
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, 0.99 * before[name])


def test_other_weights_are_stepped_as_by_adamw():
    torch.manual_seed(4)
    model = nn.Sequential(nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8), nn.Conv2d(8, 8, 3, groups=8))
    assert not list(matrices(model))
    twin = nn.Sequential(nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8), nn.Conv2d(8, 8, 3, groups=8))
    twin.load_state_dict(model.state_dict())
    ours = optimizer(model, weight_decay=0.1)
    theirs = torch.optim.AdamW(twin.parameters(), lr=RATE, weight_decay=0.1)
    for step in range(3):
        random_gradients(model, torch.Generator().manual_seed(step))
        random_gradients(twin, torch.Generator().manual_seed(step))
        ours.step()
        theirs.step()
    for ours_is, theirs_is in zip(model.parameters(), twin.parameters(), strict=True):
        torch.testing.assert_close(ours_is, theirs_is)


def test_parameters_without_a_gradient_stay():
    model = nn.Sequential(nn.Linear(8, 8), nn.LayerNorm(8))
    before = {name: value.clone() for name, value in model.state_dict().items()}
    model[1].weight.grad = torch.ones(8)
    optimizer(model, weight_decay=0.1).step()
    changed = {name for name, value in model.state_dict().items() if (value != before[name]).any()}
    assert changed == {"1.weight"}


def test_state_is_restored():
    torch.manual_seed(5)
    model = nn.Sequential(nn.Linear(8, 8), nn.LayerNorm(8))
    twin = nn.Sequential(nn.Linear(8, 8), nn.LayerNorm(8))
    first, second = optimizer(model), optimizer(twin)
    random_gradients(model, torch.Generator().manual_seed(6))
    first.step()
    twin.load_state_dict(model.state_dict())
    second.load_state_dict(deepcopy(first.state_dict()))
    for each, its in ((model, first), (twin, second)):
        random_gradients(each, torch.Generator().manual_seed(7))
        its.step()
    for one, other in zip(model.parameters(), twin.parameters(), strict=True):
        assert torch.equal(one, other)


def test_matrices_of_the_shipped_network_are_most_of_its_weights_and_no_filters():
    model = build_network("polar", backbone_weights="none")
    names = {id(parameter): name for name, parameter in model.named_parameters()}
    found = [names[id(parameter)] for parameter in matrices(model)]
    assert len(set(found)) == len(found)
    assert "object_backbone.first.0.up.weight" in found
    assert not [name for name in found if "filter" in name or "begin" in name]


def test_a_state_comes_back_on_the_devices_of_the_parameters():
    """As one that was saved on a CPU, of a training that goes on elsewhere."""
    model = nn.Sequential(nn.Linear(8, 8), nn.Linear(8, 2))
    before = optimizer(model)
    random_gradients(model, torch.Generator().manual_seed(0))
    before.step()
    after = optimizer(deepcopy(model).to("meta"))
    after.load_state_dict(before.state_dict())
    counted = [state for state in after.state.values() if "step" in state]
    assert counted
    for parameter, state in after.state.items():
        if parameter.is_meta:
            assert all(value.is_meta for value in state.values())
