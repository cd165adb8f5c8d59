"""The network as a whole: shapes, units, readings, learning, graphs."""

import subprocess
import sys

import pytest
import torch

from ffpose.models import FilterformerPose, PosePrediction

SMALL = {
    "backbone": "test_efficientnet",
    "image_size": (48, 64),
    "dim": 16,
    "depth": 1,
    "heads": 2,
    "feed_forward": 16,
    "head_hidden": 16,
    "translation_mlp_dim": 8,
    "orientation_mlp_dim": 8,
}


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def build(**fields):
    return FilterformerPose.from_config("tiny", backbone_weights="none", **(SMALL | fields))


@pytest.mark.parametrize(("name", "millions"), [("base", 9.3), ("small", 2.8), ("tiny", 0.33)])
def test_presets(name, millions):
    model = FilterformerPose.from_config(name, backbone_weights="none").eval()
    parameters = sum(parameter.numel() for parameter in model.parameters())
    assert parameters == pytest.approx(millions * 1e6, rel=0.02)
    with torch.no_grad():
        pose = model(torch.randn(1, 3, *model.config.image_size))
    assert isinstance(pose, PosePrediction)
    assert (pose.translation.shape, pose.orientation.shape) == ((1, 3), (1, 4))
    torch.testing.assert_close(pose.orientation.norm(dim=1), torch.ones(1))


@pytest.mark.parametrize(
    "fields",
    [
        *({"filter": kind} for kind in ("tokens", "grid", "none")),
        {"pooling": "mean"},
        {"position": "sinusoidal"},
        {"norm": "post"},
        {"orientation_reduction": 16},
        {"image_size": (70, 90)},
        {"orientation_head": "bins", "bins": 300, "bins_degree": 2},
    ],
)
def test_every_reading_trains_every_weight(fields):
    model = build(**fields)
    before = {name: value.clone() for name, value in model.named_parameters()}
    optimizer = torch.optim.Adam(model.parameters())
    for _ in range(2):
        optimizer.zero_grad()
        pose = model(torch.randn(4, 3, *model.config.image_size))
        target = torch.tensor((0.5, 0.5, 0.5, 0.5))
        (pose.translation.square().sum() + (pose.orientation - target).square().sum()).backward()
        optimizer.step()
    same = [name for name, value in model.named_parameters() if torch.equal(value, before[name])]
    assert not same


def test_parts_that_training_freezes():
    model = build()
    parts = dict(model.named_children())
    assert {"backbone", "translation_branch", "orientation_branch"} <= set(parts)
    pose = model(torch.randn(2, 3, 48, 64))
    pose.translation.sum().backward()
    for parameter in parts["orientation_branch"].parameters():
        assert parameter.grad is None
    assert all(p.grad is not None for p in parts["translation_branch"].parameters())


def test_translation_counts_from_the_mean_in_units_of_the_spread():
    plain = build().eval()
    mean, std = (1.0, -2.0, 30.0), (2.0, 3.0, 4.0)
    scaled = build(translation_mean=mean, translation_std=std).eval()
    scaled.load_state_dict(plain.state_dict())
    images = torch.randn(2, 3, 48, 64)
    expected = plain(images).translation * torch.tensor(std) + torch.tensor(mean)
    torch.testing.assert_close(scaled(images).translation, expected)


def test_a_new_network_is_near_the_identity_rotation():
    orientation = build().eval()(torch.randn(4, 3, 48, 64)).orientation
    assert (orientation[:, 0] > 0.7).all()
    torch.testing.assert_close(orientation.norm(dim=1), torch.ones(4))


def test_images_do_not_mix_and_strides_do_not_matter():
    model, images = build().eval(), torch.randn(3, 3, 48, 64)
    together = model(images)
    for one in (images[1:2], images[1:2].contiguous(memory_format=torch.channels_last)):
        for got, expected in zip(model(one), together, strict=True):
            torch.testing.assert_close(got, expected[1:2], rtol=1e-4, atol=1e-5)


def test_it_can_learn_a_handful_of_images_by_heart():
    model = build(dropout=0.0)
    images = torch.randn(4, 3, 48, 64)
    translation = torch.randn(4, 3)
    orientation = torch.nn.functional.normalize(torch.randn(4, 4).abs(), dim=1)
    optimizer = torch.optim.Adam(model.parameters(), 5e-3)
    losses = []
    for _ in range(25):
        pose = model(images)
        loss = (pose.translation - translation).norm(dim=1).mean()
        loss = loss + (pose.orientation - orientation).norm(dim=1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.3 * losses[0]


@pytest.mark.slow
def test_compile_and_export_without_graph_break():
    model, images = build(filter="tokens").eval(), torch.randn(2, 3, 48, 64)
    expected = model(images)
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    exported = torch.export.export(model, (images,)).module()
    for graph in (compiled, exported):
        for got, wanted in zip(graph(images), expected, strict=True):
            torch.testing.assert_close(got, wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("pooling", ["token", "mean"])
def test_an_exported_network_takes_batches_of_any_size(pooling):
    model, batch = build(pooling=pooling).eval(), torch.export.Dim("batch")
    images = torch.randn(2, 3, 48, 64)
    program = torch.export.export(model, (images,), dynamic_shapes=({0: batch},)).module()
    for count in (1, 2, 5):
        images = torch.randn(count, 3, 48, 64)
        for got, wanted in zip(program(images), model(images), strict=True):
            torch.testing.assert_close(got, wanted, rtol=1e-4, atol=1e-5)


RUN_PROGRAM = """
import sys
import torch
import ffpose.models

program, images, poses = sys.argv[1:]
torch.save(tuple(torch.export.load(program).module()(torch.load(images))), poses)
"""


# torch takes weights that lie channels last for slices; on the CPU they are saved whole.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:No complete tensor found in the group")
def test_an_exported_network_is_saved_and_runs_in_another_process(tmp_path):
    model, images = build().eval(), torch.randn(2, 3, 48, 64)
    program, inputs, poses = (tmp_path / name for name in ("model.pt2", "images.pt", "poses.pt"))
    torch.export.save(torch.export.export(model, (images,)), program)
    torch.save(images, inputs)
    command = [sys.executable, "-c", RUN_PROGRAM, program, inputs, poses]
    subprocess.run(command, check=True, timeout=120)
    for got, wanted in zip(torch.load(poses), model(images), strict=True):
        torch.testing.assert_close(got, wanted, rtol=1e-4, atol=1e-5)
    loaded = torch.export.load(program).module()(images)
    assert isinstance(loaded, PosePrediction)


@pytest.mark.parametrize("shape", [(1, 3, 64, 48), (1, 1, 48, 64), (3, 48, 64)])
def test_images_of_another_shape(shape):
    with pytest.raises(ValueError, match=r"images: expected shape \(B, 3, 48, 64\), got"):
        build()(torch.zeros(shape))


def test_unknown_preset_and_field():
    with pytest.raises(ValueError, match=r"config: expected one of \('base', 'small', 'tiny', "):
        FilterformerPose.from_config("huge")
    with pytest.raises(ValueError, match=r"fields out of .* got depht"):
        build(depht=3)


def test_a_config_is_taken_as_well_as_a_name():
    config = build().config
    assert FilterformerPose.from_config(config, backbone_weights="none", depth=2).config.depth == 2
