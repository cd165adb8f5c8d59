"""The moving average: the recursion by hand, and what a run makes of it."""

import copy

import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from ffpose.evaluation.evaluate import evaluate
from ffpose.training.averaging import WARM_UP, AveragedModel
from ffpose.training.engine import train
from tiny_runs import train_config, write_set


def network(seed=0):
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))


def move(model, generator):
    """Change every weight, and batch norm's running statistics by a batch."""
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(torch.randn(weight.shape, generator=generator))
    model.train()(torch.randn(8, 2, generator=generator))


@pytest.mark.parametrize("decay", [0.5, 0.9])
def test_the_average_follows_the_recursion_by_hand(decay):
    model, generator = network(), torch.Generator().manual_seed(1)
    average = AveragedModel(model, decay)
    expected = {name: value.double() for name, value in model.state_dict().items()}
    for step in range(1, 120):
        move(model, generator)
        average.update()
        stays = min(decay, step / (step + WARM_UP))
        for name, value in model.state_dict().items():
            expected[name] = stays * expected[name] + (1 - stays) * value.double()
    counted = expected.pop("1.num_batches_tracked")
    assert counted < 119  # an average would be no count
    averaged = average.model.state_dict()
    assert averaged.pop("1.num_batches_tracked") == 119
    for name, value in averaged.items():
        torch.testing.assert_close(value.double(), expected[name], rtol=1e-4, atol=1e-5)
        assert not torch.allclose(value, model.state_dict()[name], atol=1e-2)


def test_the_trained_network_is_as_it_was():
    model = network()
    average = AveragedModel(model, 0.9)
    move(model, torch.Generator().manual_seed(1))
    before = copy.deepcopy(model.state_dict())
    average.update()
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())
    assert all(weight.requires_grad for weight in model.parameters())
    assert not any(weight.requires_grad for weight in average.model.parameters())


def test_without_decay_the_network_itself_is_the_average():
    model = network()
    average = AveragedModel(model, 0.0)
    move(model, torch.Generator().manual_seed(1))
    average.update()
    assert average.model is model
    assert average.state_dict() == {}


def test_a_state_goes_on_as_if_it_had_not_been_interrupted():
    model, generator = network(), torch.Generator().manual_seed(1)
    whole = AveragedModel(model, 0.9)
    for _ in range(5):
        move(model, generator)
        whole.update()
    resumed = AveragedModel(model, 0.9)
    resumed.load_state_dict(copy.deepcopy(whole.state_dict()))
    for _ in range(5):
        move(model, generator)
        whole.update()
        resumed.update()
    assert resumed.steps == whole.steps == 10
    expected = whole.model.state_dict()
    for name, value in resumed.model.state_dict().items():
        assert torch.equal(value, expected[name])


def test_the_average_of_a_run_is_what_is_validated_and_saved(tmp_path):
    root = write_set(tmp_path / "set")
    config = train_config(root, tmp_path / "run", epochs=1, ema=0.5)
    result = train(config, quiet=True)
    saved = load_file(result.folder.last)
    state = result.folder.load_state()
    averaged = state.average["model"]
    assert saved.keys() == averaged.keys()
    assert all(torch.equal(saved[name], value) for name, value in averaged.items())
    assert any(not torch.equal(saved[name], value) for name, value in state.model.items())
    found = evaluate(result.folder.last, "urso", root, "val").summary()
    for name in ("median_translation_error_m", "median_rotation_error_deg"):
        assert result.history[0][f"val_{name}"] == pytest.approx(found[name], rel=1e-4)
