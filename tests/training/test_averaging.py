"""The moving average: the recursion by hand, and what a run makes of it."""

import copy
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from ffpose.evaluation.evaluate import evaluate
from ffpose.training.averaging import WARM_UP, AveragedModel
from ffpose.training.engine import train
from ffpose.training.run import build_run
from tiny_runs import train_config, write_set


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("averaging") / "set")


@pytest.fixture(scope="module")
def begun_from(root):
    """Weights that trainings begin from."""
    path = root.parent / "initial.safetensors"
    build_run(train_config(root, root.parent / "none", seed=7)).model.save_pretrained(path)
    return path


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
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_the_average_follows_the_recursion_by_hand(decay, share):
    """A share of the initial weights is left in it: interpolated between both."""
    model, generator = network(), torch.Generator().manual_seed(1)
    average = AveragedModel(model, decay, share)
    expected = {name: value.double() for name, value in model.state_dict().items()}
    initial = copy.deepcopy(expected)
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
        between = (1 - share) * expected[name] + share * initial[name]
        torch.testing.assert_close(value.double(), between, rtol=1e-4, atol=1e-5)
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


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_state_goes_on_as_if_it_had_not_been_interrupted(share):
    model, generator = network(), torch.Generator().manual_seed(1)
    whole = AveragedModel(model, 0.9, share)
    for _ in range(5):
        move(model, generator)
        whole.update()
    resumed = AveragedModel(model, 0.9, share)
    resumed.load_state_dict(copy.deepcopy(whole.state_dict()))
    for _ in range(5):
        move(model, generator)
        whole.update()
        resumed.update()
    assert resumed.steps == whole.steps == 10
    expected = whole.model.state_dict()
    for name, value in resumed.model.state_dict().items():
        assert torch.equal(value, expected[name])


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_stage_averages_anew_with_a_share_of_the_same_initial_weights(share):
    """As the first stage did, by hand: from the average that the network goes on from."""
    model, generator = network(), torch.Generator().manual_seed(1)
    average = AveragedModel(model, 0.9, share)
    initial = copy.deepcopy(model.state_dict())
    for _ in range(5):
        move(model, generator)
        average.update()
    begun = copy.deepcopy(average.model.state_dict())
    average.restart(begun)
    assert all(
        torch.equal(value, begun[name]) for name, value in average.model.state_dict().items()
    )
    for name, value in model.state_dict().items():
        if value.is_floating_point():  # which the share of the initial weights makes the average
            torch.testing.assert_close(value.lerp(initial[name], share), begun[name])
    frozen = copy.deepcopy(average)
    for _ in range(9):
        frozen.update()
    for name, value in frozen.model.state_dict().items():
        torch.testing.assert_close(value, begun[name])
    move(model, generator)
    average.update()
    stays = 1 / (1 + WARM_UP)
    for name, value in average.model.state_dict().items():
        if value.is_floating_point():
            target = (1 - share) * model.state_dict()[name] + share * initial[name]
            torch.testing.assert_close(value, stays * begun[name] + (1 - stays) * target)
    kept = average.state_dict()["initial"]
    assert all(torch.equal(value, initial[name]) for name, value in kept.items())


def config(root, out, begun_from, share):
    return train_config(root, out, epochs=1, ema=0.5, init=begun_from, init_share=share)


@pytest.fixture(scope="module")
def averaged(root, begun_from):
    """A training without a share of the initial weights."""
    return train(config(root, root.parent / "averaged", begun_from, 0.0), quiet=True)


def test_the_average_of_a_run_is_what_is_validated_and_saved(root, averaged):
    saved = load_file(averaged.folder.last)
    state = averaged.folder.load_state()
    average = state.average["model"]
    assert saved.keys() == average.keys()
    assert all(torch.equal(saved[name], value) for name, value in average.items())
    assert any(not torch.equal(saved[name], value) for name, value in state.model.items())
    found = evaluate(averaged.folder.last, "urso", root, "val").summary()
    for name in ("median_translation_error_m", "median_rotation_error_deg"):
        assert averaged.history[0][f"val_{name}"] == pytest.approx(found[name], rel=1e-4)


def test_what_a_training_saves_lies_between_its_initial_weights_and_those_saved_without_share(
    root, begun_from, averaged, tmp_path
):
    shared = train(config(root, tmp_path, begun_from, 0.25), quiet=True)
    between, whole = (load_file(result.folder.last) for result in (shared, averaged))
    for name, initial in load_file(begun_from).items():
        if initial.is_floating_point():
            torch.testing.assert_close(between[name], whole[name].lerp(initial, 0.25))


def test_a_stage_begins_from_the_best_weights_and_keeps_the_share_of_the_initial_ones(
    root, begun_from, tmp_path
):
    run = build_run(config(root, tmp_path, begun_from, 0.25))
    best = {name: value + 1 for name, value in run.model.state_dict().items()}
    run.average.restart(best)
    average = run.average.state_dict()
    for name, value in run.model.state_dict().items():
        if value.is_floating_point():
            torch.testing.assert_close(value.lerp(average["initial"][name], 0.25), best[name])
    for expected, found in (
        (best, average["model"]),
        (load_file(begun_from), average["initial"]),
    ):
        assert found.keys() == expected.keys()
        assert all(torch.equal(value, expected[name]) for name, value in found.items())


@pytest.mark.parametrize(
    ("fields", "got"),
    [
        ({"init_share": 0.5, "ema": 0.9}, "init None and ema 0.9"),
        (
            {"init_share": 0.5, "init": Path("first.safetensors")},
            "init first.safetensors and ema 0",
        ),
        ({"init_share": 1.0}, "1.0"),
    ],
)
def test_a_share_of_no_initial_weights_is_refused(tmp_path, fields, got):
    with pytest.raises(ValueError, match=f"^init_share: .*got {got}$"):
        train_config(tmp_path, tmp_path, **fields)


@pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter")
def test_initial_weights_come_back_on_the_device_of_the_network():
    model = network()
    state = AveragedModel(model, 0.9, 0.3).state_dict()
    resumed = AveragedModel(copy.deepcopy(model).to("meta"), 0.9, 0.3)
    resumed.load_state_dict(state)
    assert all(value.is_meta for value in resumed.initial.values())
