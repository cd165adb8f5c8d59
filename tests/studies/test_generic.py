"""The weights that trainings start from: one network, a head for each of many spacecraft."""

import numpy as np
import pytest
import torch

from ffpose._internal.zoo import INITIAL
from ffpose.learn.plan import DEFAULT_INIT
from ffpose.models import build_network, read_metadata
from ffpose.models.weights import load_weights
from ffpose.render.spacecraft.craft import bounding_sphere
from ffpose.training.config import ObjectLossConfig, PatchAugmentation
from ffpose.training.patches import PatchBatches
from studies.generic.heads import ManyBinsHead, ManyObjective
from studies.generic.spacecraft import build_random_spacecraft, subject
from studies.generic.train import GenericConfig, new_network, opened_views, train_generic

SMALL = {"channels": (4, 8, 8), "blocks": (1, 1), "latent": 8, "directions": 20}


def test_a_random_spacecraft_is_a_function_of_its_number_about_its_middle():
    one, again, other = (build_random_spacecraft(number) for number in (5, 5, 6))
    assert np.array_equal(one.mesh.vertices, again.mesh.vertices)
    assert one.mesh.vertices.shape != other.mesh.vertices.shape
    center, radius = bounding_sphere(one.mesh.vertices)
    assert np.linalg.norm(center) < 2e-3 * radius
    with pytest.raises(ValueError, match="index: expected at least 0, got -1"):
        build_random_spacecraft(-1)


def test_distances_are_those_of_learn_for_every_size():
    for number in (0, 1, 2):
        scene, radius = subject(number)
        assert scene.distance_m == pytest.approx((0.7 * 3 * radius, 1.4 * 16 * radius))


def test_each_sample_is_decoded_by_the_bins_of_its_spacecraft():
    model = build_network("polar", backbone_weights="none", **SMALL)
    many = ManyBinsHead(model, 3)
    raw = torch.randn(4, many.features)
    many.chosen = torch.tensor([2, 0, 2, 1])
    for sample, number in enumerate(many.chosen):
        one = model.orientation
        one.weight.data, one.bias.data = many.weight[number].detach(), many.bias[number, 0].detach()
        torch.testing.assert_close(
            many.logits(raw)[sample], one.logits(raw[sample : sample + 1])[0]
        )


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    return tmp_path_factory.mktemp("views")


def small_run(folder, views, **fields):
    return GenericConfig(
        folder / "generic.safetensors",
        views,
        **{"spacecraft": 3, "count": 6, "batch_size": 6, "workers": 1, "device": "cpu"} | fields,
    )


@pytest.mark.slow
def test_the_loss_moves_the_shared_weights_and_the_heads_of_the_spacecraft_shown(tmp_path, views):
    model = new_network()
    arrays, empty, numbers = opened_views(small_run(tmp_path, views), model)
    # Relative to their radius all are within the distances of training.
    for each in arrays:
        distance = np.linalg.norm(each["labels"][:, :3], axis=1)
        assert np.all((distance > 0.7 * 3 * 0.999) & (distance < 1.4 * 16 * 1.001))
    model.orientation = ManyBinsHead(model, 3)
    loss = ManyObjective(model, ObjectLossConfig(angle=5.0), numbers)
    batches = PatchBatches(
        model, arrays, empty, PatchAugmentation(), (0.25,) * 3, loss.cells, np.zeros((0, 3))
    )
    chosen = torch.nonzero(numbers != 1)[:6, 0]
    drawn = batches.drawn(chosen, torch.Generator().manual_seed(0))
    batch = batches.augmented(batches.gathered(drawn))
    loss(model, batch).total.backward()
    shown = set(numbers[chosen[batch.present]].tolist())
    for weight in (model.orientation.weight, loss.weight):
        moved = {n for n in range(3) if weight.grad[n].abs().max() > 0}
        assert moved == shown
    assert all(
        p.grad is not None for name, p in model.named_parameters() if "orientation." not in name
    )


@pytest.mark.slow
def test_what_is_written_has_the_shared_weights_and_its_recipe(tmp_path, views, capsys):
    config = small_run(tmp_path, views, epochs=(1, 1))
    train_generic(config)
    assert capsys.readouterr().out.count("epoch 1 of 1: loss") == 2
    written = new_network()
    load_weights(config.out, written)
    start = new_network()
    load_weights(INITIAL.parent / "soyuz.safetensors", start)
    moved = (written.object_backbone.parameters(), start.object_backbone.parameters())
    apart = [float((a - b).detach().abs().max()) for a, b in zip(*moved, strict=True)]
    assert 0 < max(apart) < 0.1  # two steps from soyuz, not random
    header = read_metadata(config.out)
    assert header.recipe["spacecraft"] == 3
    assert header.recipe["epochs"] == [1, 1]


def test_the_shipped_file_is_of_the_command_without_options(tmp_path):
    header = read_metadata(INITIAL / f"{DEFAULT_INIT}.safetensors")
    plain = GenericConfig(tmp_path, tmp_path)
    assert header.config == new_network().config
    assert header.recipe["study"] == "generic"
    assert header.recipe["spacecraft"] == plain.spacecraft
    assert header.recipe["count"] == plain.count
    assert header.recipe["epochs"] == list(plain.epochs)
