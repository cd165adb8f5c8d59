"""What the weights of a run say of it."""

import hashlib
import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from ffpose.datasets import open_dataset
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.evaluate import evaluate
from ffpose.geometry import Camera
from ffpose.models import build_network, read_metadata
from ffpose.training import DataConfig, provenance
from ffpose.training.engine import train
from ffpose.training.provenance import describe_data, describe_images, recipe
from ffpose.training.run import build_run
from tiny_runs import MODEL_FIELDS, train_config, write_set


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("provenance") / "set")


@pytest.fixture(scope="module")
def trained(image_set, tmp_path_factory):
    """The folder of a run of one epoch."""
    out = tmp_path_factory.mktemp("provenance") / "run"
    return train(train_config(image_set, out, epochs=1), quiet=True).folder


def test_the_weights_of_a_run_tell_how_they_were_made(trained):
    for path in (trained.best, trained.last):
        metadata = read_metadata(path)
        assert metadata.backbone_source == "none"
        assert metadata.recipe["optimizer"]["learning_rate"] == 1e-3
        assert metadata.recipe["loss"] == {"s_t": -3.0, "s_q": -6.5, "antipodal": False}
        assert metadata.recipe["stages"][0]["name"] == "joint"
        assert metadata.data["count"] == 10
        assert metadata.data["image_size"] == [48, 64]


def test_the_weights_of_a_run_know_its_camera(trained):
    """URSO's, 640 and 640.463 pixels of 1280x960, at 64x48 and squeezed to 64x64."""
    metadata = read_metadata(trained.best)
    assert metadata.config.camera == pytest.approx((32.0, 640.463 / 15, 32.0, 32.0))
    assert metadata.camera.fy == pytest.approx(640.463 / 20)


def test_a_camera_that_is_given_stays(image_set, tmp_path):
    fields = MODEL_FIELDS | {"camera": [30.0, 31.0, 32.0, 33.0]}
    run = build_run(train_config(image_set, tmp_path / "run", model_fields=fields))
    assert run.model.config.camera == (30.0, 31.0, 32.0, 33.0)


def test_a_scale_of_positions_that_is_given_stays(image_set, tmp_path):
    fields = MODEL_FIELDS | {"translation_mean": [1.0, 2.0, 30.0]}
    given = build_run(train_config(image_set, tmp_path / "run", model_fields=fields)).model.config
    assert given.translation_mean == (1.0, 2.0, 30.0)
    assert given.translation_std != (1.0, 1.0, 1.0)  # of the images


def test_a_resumed_run_knows_its_backbone_and_needs_no_pretrained_weights(
    image_set, tmp_path, monkeypatch
):
    source = {"name": "a", "source": "b", "sha256": "c"}
    asked = []

    def load(features, name, weights):
        asked.append(weights)
        return source if weights == "auto" else "none"

    monkeypatch.setattr("ffpose.models.backbone.load_backbone_weights", load)
    for epochs in (1, 2):
        config = train_config(image_set, tmp_path / "run", backbone_weights="auto", epochs=epochs)
        run = train(config, resume=True, quiet=True)
        assert read_metadata(run.folder.last).backbone_source == source
    assert asked == ["auto", "none"]


def test_a_run_begins_from_the_weights_that_it_names(trained, image_set, tmp_path):
    weights = Path(shutil.copy(trained.last, tmp_path))
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    config = train_config(image_set, tmp_path / "b", epochs=1, seed=1, init=weights)
    begun = build_run(config).model.state_dict()
    assert all(torch.equal(begun[name], value) for name, value in load_file(weights).items())
    folder = train(config, quiet=True).folder
    first = read_metadata(weights)
    expected = {"sha256": digest, "recipe": first.recipe, "data": first.data}
    assert read_metadata(folder.last).recipe["init"] == expected
    weights.unlink()  # a run that is resumed does not need them
    train(replace(config, epochs=2), resume=True, quiet=True)
    assert read_metadata(folder.last).recipe["init"] == expected


def test_a_run_begins_from_shipped_weights_by_name(image_set, tmp_path, monkeypatch):
    monkeypatch.setattr("ffpose._internal.zoo.FOLDER", tmp_path)
    named = build_run(train_config(image_set, tmp_path / "a", seed=7)).model
    named.save_pretrained(tmp_path / "soyuz.safetensors")
    begun = build_run(train_config(image_set, tmp_path / "b", init=Path("soyuz"))).model
    assert all(map(torch.equal, begun.state_dict().values(), named.state_dict().values()))


@pytest.mark.parametrize(
    ("init", "words"),
    [("moon", r"or a name \(one of .*soyuz.*\), got moon"), ("a/b.safetensors", "or a name, got")],
)
def test_initial_weights_that_there_are_none_of_are_told_first(init, words, tmp_path):
    with pytest.raises(FileNotFoundError, match=f"^init: expected a file {words}"):
        build_run(train_config(tmp_path / "no_set", tmp_path / "run", init=Path(init)))


def test_weights_remember_the_whole_chain_that_they_come_from(trained, image_set, tmp_path):
    init, digests = trained.last, []
    for number in (1, 2):
        digests.append(hashlib.sha256(init.read_bytes()).hexdigest())
        config = train_config(image_set, tmp_path / f"{number}", epochs=1, init=init, seed=number)
        init = train(config, quiet=True).folder.last
    last = read_metadata(init).recipe
    first = last["init"]["recipe"]["init"]["recipe"]
    assert last["init"]["sha256"] == digests[1]
    assert last["init"]["recipe"]["init"]["sha256"] == digests[0]
    assert [last["seed"], last["init"]["recipe"]["seed"], first["seed"]] == [2, 1, 0]
    assert first["init"] is None


def test_weights_to_begin_from_that_are_not_there_are_named(image_set, tmp_path):
    config = train_config(image_set, tmp_path / "run", init=tmp_path / "none.safetensors")
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors"):
        train(config, quiet=True)


def test_the_recipe_names_nothing_of_this_machine(image_set, tmp_path):
    config = train_config(image_set, tmp_path / "run")
    text = json.dumps(recipe(config, None))
    assert str(image_set) not in text
    assert str(tmp_path) not in text
    assert not {"out", "device"} & set(json.loads(text))
    assert json.loads(text)["data"]["kind"] == "urso"
    assert json.loads(text)["seed"] == config.seed


def test_the_digest_is_that_of_names_and_labels(image_set, tmp_path):
    run = build_run(train_config(image_set, tmp_path / "run"))
    content = b"".join(
        f"{name}\n".encode() + struct.pack("<7d", *pose)
        for name, pose in zip(run.task.train_set.names, run.task.train_set.poses, strict=True)
    )
    described = describe_images(run.task.train_set, run.config.data)
    assert described["digest"] == hashlib.sha256(content).hexdigest()
    assert described["name"] == image_set.name
    assert described["digest"] != describe_images(run.task.val_set, run.config.data)["digest"]


def test_weights_carry_the_mean_pose_that_evaluation_compares_with(trained, image_set, tmp_path):
    test_alone = shutil.copytree(
        image_set, tmp_path / "test", ignore=shutil.ignore_patterns("train_*", "val_*", "gt.csv")
    )
    alone = evaluate(trained.best, "urso", test_alone)
    expected = mean_pose(
        open_dataset("urso", image_set, "train", read_metadata(trained.best).preprocessing).poses
    )
    np.testing.assert_allclose(alone.baseline, expected, atol=1e-12)


def test_positions_of_initial_weights_keep_their_scale(image_set, tmp_path):
    """Their heads tell positions in it, whatever set they are trained on from now on."""
    config, path = train_config(image_set, tmp_path / "run"), tmp_path / "initial.safetensors"
    scale = {"translation_mean": (1.0, 2.0, 30.0), "translation_std": (4.0, 5.0, 6.0)}
    fields = {**config.model_fields, **scale}
    build_network(config.model, backbone_weights="none", **fields).save_pretrained(path)
    run = build_run(replace(config, init=path))
    assert run.model.config.translation_mean == scale["translation_mean"]
    assert run.model.config.translation_std == scale["translation_std"]


def test_the_size_of_scenes_is_that_of_their_camera(image_set, tmp_path, monkeypatch):
    """The network's input is of a shape near it, and predict takes the camera's own."""
    run = build_run(train_config(image_set, tmp_path / "run"))
    camera = Camera(1280, 1024, 900.0, 900.0, 640.0, 512.0)
    monkeypatch.setattr(provenance, "find_scene", lambda _: SimpleNamespace(camera=camera))
    images, config = run.task.val_set, DataConfig("scenes", tmp_path, scene="soyuz_easy")
    described = describe_data(config, images.poses, images, hashlib.sha256())
    assert described["image_size"] == [1024, 1280]
