"""What any network must do: be built by name, saved and loaded, frozen in part, exported."""

from dataclasses import asdict
from inspect import getdoc

import numpy as np
import pytest
import torch

from ffpose.config import PRESETS, UrsoNetConfig, config_type
from ffpose.models import (
    FilterformerPose,
    PoseNet,
    UrsoNet,
    build_network,
    find_device,
    load_network,
    read_metadata,
)
from ffpose.models.registry import NETWORKS as CLASSES
from ffpose.training.losses import JointLoss
from ffpose.training.stages import Stage, enter_stage
from networks import MODEL_FIELDS, NETWORKS, SIZE


def build(name, **fields):
    torch.manual_seed(0)
    return build_network(name, backbone_weights="none", **MODEL_FIELDS[name] | fields)


def random_images(count=2):
    return torch.randn(count, 3, *SIZE, generator=torch.Generator().manual_seed(1))


def test_a_preset_names_a_network():
    assert set(CLASSES) == {config.architecture for config in PRESETS.values()}
    kinds = {name: type(build(name)) for name in NETWORKS}
    assert kinds == {"transformerpose": FilterformerPose, "ursonet": UrsoNet, "posenet": PoseNet}
    assert PRESETS["transformerpose"].filter == "none"


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_gives_unit_quaternions(name):
    pose = build(name).eval()(random_images())
    assert pose.translation.shape == (2, 3)
    torch.testing.assert_close(pose.orientation.norm(dim=-1), torch.ones(2))


@pytest.mark.parametrize("name", NETWORKS)
def test_saved_and_loaded_by_name(name, tmp_path):
    model = build(name, camera=(50.0, 51.0, 32.0, 32.0)).eval()
    model.save_pretrained(tmp_path / "a.safetensors")
    loaded = load_network(tmp_path / "a.safetensors")
    assert type(loaded) is type(model)
    assert loaded.config == model.config
    assert read_metadata(tmp_path / "a.safetensors").camera.fx == 50.0
    images = random_images()
    for got, expected in zip(loaded(images), model(images), strict=True):
        assert torch.equal(got, expected)


@pytest.mark.parametrize("name", NETWORKS)
def test_frozen_parts_stay_bit_for_bit(name):
    model = build(name)
    parts = ("backbone", "orientation_branch")
    before = {key: value.clone() for key, value in model.state_dict().items()}
    enter_stage(model, JointLoss(), Stage("translation", 1, parts))
    optimizer = torch.optim.Adam(model.parameters(), lr=0.1, weight_decay=0.1)
    translation, orientation = model.regress(random_images(4))
    (translation.sum() + orientation.sum()).backward()
    optimizer.step()
    changed = {k for k, value in model.state_dict().items() if not torch.equal(value, before[k])}
    assert changed
    assert not any(key.startswith(parts) for key in changed)


def test_the_relative_location_loss_by_hand():
    """The distance is 5 of 10, and 0 of 2."""
    t = torch.tensor([[0.0, 0.0, 10.0], [0.0, 0.0, 2.0]])
    t_hat = torch.tensor([[3.0, 4.0, 10.0], [0.0, 0.0, 2.0]])
    loss = build("ursonet").translation_loss(t_hat, t)
    np.testing.assert_allclose(loss.numpy(), [0.5, 0.0])
    np.testing.assert_allclose(build("posenet").translation_loss(t_hat, t).numpy(), [5.0, 0.0])


def test_an_unknown_architecture_or_preset_is_told_the_names():
    with pytest.raises(ValueError, match="PolarPose, UrsoNet, PoseNet, got 'HyperPose'"):
        config_type("HyperPose")
    with pytest.raises(ValueError, match=r"base, .*, polar, ursonet, posenet, got 'big'"):
        build_network("big")
    with pytest.raises(ValueError, match=r"expected one of \('ursonet',\), got 'base'"):
        UrsoNet.from_config("base")
    with pytest.raises(ValueError, match="expected a PoseNetConfig, got a UrsoNetConfig"):
        PoseNet.from_config(UrsoNetConfig())


def test_a_device_is_found_by_name():
    assert find_device("cpu") == torch.device("cpu")
    assert find_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")
    absent = f"cuda:{torch.cuda.device_count()}"
    for name in ("gpu", absent):
        with pytest.raises(ValueError, match=f"device: expected auto, .*, got '{name}'"):
            find_device(name)


@pytest.mark.parametrize(
    ("name", "fields", "text"),
    [
        ("ursonet", {"bins_per_dim": 2}, "bins_per_dim: expected at least 3, got 2"),
        ("ursonet", {"smoothing": 0.0}, "smoothing: expected a finite number above 0, got 0.0"),
        ("ursonet", {"hidden": 1.5}, "hidden: expected a whole number, at least 1, got 1.5"),
        ("ursonet", {"image_size": (24, 64)}, "image_size: expected each at least 32"),
        ("ursonet", {"depth": 3}, r"expected fields out of .*bins_per_dim.*got depth$"),
        ("posenet", {"beta": -1.0}, "beta: expected a finite number above 0, got -1.0"),
        ("posenet", {"dropout": 1.0}, "dropout: expected 0 <= dropout < 1, got 1.0"),
    ],
)
def test_refused_values(name, fields, text):
    with pytest.raises(ValueError, match=text):
        PRESETS[name].with_fields(fields)


@pytest.mark.parametrize("name", ["ursonet", "posenet"])
def test_every_field_is_saved_and_documented(name):
    config = PRESETS[name]
    assert type(config).from_json(config.to_json()) == config
    documentation = "\n".join(getdoc(each) or "" for each in type(config).__mro__)
    assert all(f"\n    {field}: " in documentation for field in asdict(config))
