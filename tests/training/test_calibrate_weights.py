"""Calibrated weights files: what their header says, done again, gives the same file."""

import json
import shlex
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from ffpose._internal.seeds import CALIBRATION
from ffpose.cli import build_parser, main, words_of
from ffpose.models import FilterformerPose, load_network, read_metadata
from ffpose.training.calibrate_weights import _as_trained, calibrate_weights
from ffpose.training.calibration_images import command_of
from ffpose.training.config import CalibrationImages
from ffpose.training.engine import train
from scene_runs import COUNT, scenes_config
from tiny_runs import SIZE, write_set


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    return train(scenes_config(folder / "views", folder / "run", epochs=1), quiet=True).folder.last


def values_of(path):
    metadata = read_metadata(path)
    config = metadata.config
    found = (config.distance_scale, config.doubt_sigma, config.degrees_of_freedom)
    return (*found, metadata.in_view_threshold)


def test_the_header_names_images_that_neither_train_nor_validate(trained):
    said = read_metadata(trained).calibration
    assert [(each["scene"], each["seed"], each["count"]) for each in said["images"]] == [
        ("soyuz_easy", CALIBRATION.start + 3, COUNT),
        ("soyuz_easy", CALIBRATION.start + 500_003, COUNT),
    ]


def test_the_command_in_the_header_calibrates_to_the_same_values(trained, tmp_path, monkeypatch):
    """On weights whose calibration was spoiled, and no other tensor changes."""
    spoiled = tmp_path / trained.name
    model = load_network(trained)
    model.variance_scales.fill_(7)
    header = read_metadata(trained)
    model.save_pretrained(spoiled, preprocessing=header.preprocessing, recipe=header.recipe)
    words = shlex.split(header.calibration["command"])
    assert words[:3] == ["ffpose", "calibrate", "last.safetensors"]
    monkeypatch.chdir(tmp_path)
    assert main([*words[1:], "--data.root", "images"]) == 0
    assert values_of(spoiled) == values_of(trained)
    assert read_metadata(spoiled).calibration == header.calibration
    assert read_metadata(spoiled).recipe == header.recipe
    before, after = load_file(trained), load_file(spoiled)
    assert before.keys() == after.keys()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


@pytest.mark.parametrize(
    "config",
    [
        CalibrationImages(),
        CalibrationImages(seed=CALIBRATION.start + 5, count=3, attitude_range_deg=(9.0, 8.0, 7.0)),
        CalibrationImages(cut=True, randomized=True, dusk=True, distance=(0.75, 1.5)),
        CalibrationImages("urso", Path("set"), split="train", start=3, step=6, undistort=True),
        CalibrationImages("csv", Path("set"), white="p99.5"),
    ],
)
def test_the_command_of_images_is_parsed_to_these_images(config):
    words = shlex.split(command_of("a.safetensors", config))
    assert not any(word.startswith("[") or word == "True" for word in words)
    parser = build_parser("calibrate")
    options = parser.instantiate(parser.parse_args(words_of("calibrate", words[2:])))
    assert CalibrationImages(**vars(options.data)) == config
    assert options.weights == Path("a.safetensors")


def test_the_command_names_no_place_of_this_machine():
    images = CalibrationImages(scene="/home/me/runs/craft/scene.json")
    assert command_of("a.safetensors", images).split() == [
        *("ffpose", "calibrate", "a.safetensors", "--data.scene", "scene.json"),
    ]


def test_the_set_is_the_first_that_the_weights_were_trained_on(trained, tmp_path):
    out = tmp_path / "calibrated.safetensors"
    views = trained.parents[1] / "views"
    images = CalibrationImages(root=views, seed=CALIBRATION.start + 3, count=COUNT)
    calibrate_weights(trained, images, out=out)
    assert read_metadata(out).calibration["images"] == read_metadata(trained).calibration["images"]
    assert "--data.scene soyuz_easy" in read_metadata(out).calibration["command"]
    unknown = tmp_path / "unknown.safetensors"
    load_network(trained).save_pretrained(unknown)
    with pytest.raises(ValueError, match=r"data\.scene: expected the name of a rendered set, got"):
        calibrate_weights(unknown, images)


def test_the_kinds_are_those_that_training_saw(trained, tmp_path):
    """Cut objects, randomized scenes and a low sun, at distances beyond the set's."""
    header, weights = read_metadata(trained), tmp_path / "cut.safetensors"
    seen = header.recipe["data"] | {"cut": 1, "randomized": 2, "dusk": 3, "distance": [0.75, 1.5]}
    load_network(trained).save_pretrained(
        weights, recipe=header.recipe | {"data": seen}, data=header.data
    )
    images = CalibrationImages(root=tmp_path / "images", seed=CALIBRATION.start + 3, count=COUNT)
    calibrate_weights(weights, images)
    said = read_metadata(weights).calibration
    assert [each["seed"] - CALIBRATION.start for each in said["images"]] == [
        *(3, 300_003, 400_003, 200_003, 500_003),
    ]
    for word in ("--data.cut", "--data.randomized", "--data.dusk", "--data.distance 0.75,1.5"):
        assert word in said["command"]
    labels = sorted((tmp_path / "images").glob("frames-*/gt.csv"))
    assert len(labels) == 4
    places = [np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1, 2)) for path in labels]
    distances = np.linalg.norm(np.concatenate(places), axis=1)
    assert distances.min() > 0.75 * 8
    assert distances.max() < 1.5 * 22


def test_ranges_are_those_of_the_training_unless_they_are_given():
    seen = {"distance": [0.75, 1.5], "attitude_range_deg": [30.0, 20.0, 10.0]}
    header = replace(read_metadata("soyuz"), recipe={"data": seen})
    taken = _as_trained(CalibrationImages(), header)
    assert (taken.distance, taken.attitude_range_deg) == ((0.75, 1.5), (30.0, 20.0, 10.0))
    given = CalibrationImages(distance=(0.9, 1.1), attitude_range_deg=(9.0, 8.0, 7.0))
    kept = _as_trained(given, header)
    assert (kept.distance, kept.attitude_range_deg) == ((0.9, 1.1), (9.0, 8.0, 7.0))
    named = _as_trained(CalibrationImages(scene="soyuz_easy"), header)  # trained on this one too
    assert (named.scene, named.distance) == ("soyuz_easy", (0.75, 1.5))
    other = CalibrationImages(scene="dragon_hard")
    assert _as_trained(other, header) == other


def test_weights_of_learn_ask_for_the_file_of_their_set():
    header = replace(
        read_metadata("soyuz"), data={"sets": [{"scene": "craft", "seed": 0, "count": 1}]}
    )
    with pytest.raises(ValueError, match=r"'craft'.* --data\.scene runs/craft/scene\.json"):
        _as_trained(CalibrationImages(), header)


def test_a_network_that_looks_once_is_refused(tmp_path):
    path = tmp_path / "once.safetensors"
    model = FilterformerPose.from_config(
        "tiny", backbone_weights="none", image_size=(64, 64), depth=1, dim=16, heads=2
    )
    model.save_pretrained(path)
    with pytest.raises(ValueError, match="expected a network with a second look"):
        calibrate_weights(path, CalibrationImages(root=tmp_path))


def test_too_few_labeled_images_are_refused(trained, tmp_path):
    """One image would make any network look certain."""
    images = CalibrationImages("urso", write_set(tmp_path / "few"), split="test")
    with pytest.raises(ValueError, match=r"data: expected at least 10 images in test, .* got 6"):
        calibrate_weights(trained, images, out=tmp_path / "out.safetensors")
    assert not (tmp_path / "out.safetensors").exists()


@pytest.mark.parametrize("field", ["fx", "distortion"])
def test_images_of_another_camera_are_refused(trained, tmp_path, field):
    """Their distances would be wrong by the ratio of the focal lengths."""
    root = write_set(tmp_path / "other", test=10)
    metadata = read_metadata(trained)
    view = metadata.preprocessing.image_camera(metadata.config.view_camera, *SIZE)
    told = asdict(view) | (
        {"fx": 2 * view.fx} if field == "fx" else {"distortion": [-0.2] + [0] * 4}
    )
    (root / "camera.json").write_text(json.dumps(told))
    images = CalibrationImages("urso", root, split="test")
    with pytest.raises(ValueError, match="expected images of"):
        calibrate_weights(trained, images, out=tmp_path / "out.safetensors")
    assert not (tmp_path / "out.safetensors").exists()
    (root / "camera.json").write_text(json.dumps(asdict(view)))
    calibrate_weights(trained, images, out=tmp_path / "out.safetensors")


def test_weights_by_name_are_not_written_to(tmp_path, capsys):
    """They are the package's, and all who use it would get others."""
    assert main(["calibrate", "soyuz", "--data.root", str(tmp_path)]) == 2
    assert "out: expected a file, as soyuz is installed for all" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
