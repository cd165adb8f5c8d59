"""Calibrated weights files: what their header says, done again, gives the same file."""

import shlex
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from ffpose._internal.seeds import CALIBRATION, CHOICES
from ffpose.cli import build_parser, main, words_of
from ffpose.models import FilterformerPose, PolarPose, read_metadata
from ffpose.training.calibrate_weights import calibrate_weights
from ffpose.training.calibration_images import command_of
from ffpose.training.config import CalibrationImages
from ffpose.training.engine import train
from scene_runs import COUNT, scenes_config


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    return train(scenes_config(folder / "views", folder / "run", epochs=1), quiet=True).folder.last


def values_of(path):
    metadata = read_metadata(path)
    config = metadata.config
    found = (config.distance_scale, config.doubt_sigma, config.degrees_of_freedom)
    return (*found, config.turns, metadata.in_view_threshold)


def test_the_header_names_images_that_neither_train_nor_validate(trained):
    said = read_metadata(trained).calibration
    assert [(each["scene"], each["seed"], each["count"]) for each in said["images"]] == [
        ("soyuz_easy", CALIBRATION.start + 3, COUNT),
        ("soyuz_easy", CALIBRATION.start + 300_003, COUNT),
        ("soyuz_easy", CALIBRATION.start + 500_003, COUNT),
    ]


def test_the_command_in_the_header_calibrates_to_the_same_values(trained, tmp_path, monkeypatch):
    """On weights whose calibration was spoiled, and no other tensor changes."""
    spoiled = tmp_path / trained.name
    model = FilterformerPose.from_pretrained(trained)
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
        CalibrationImages("urso", Path("set"), split="train", start=3, step=6, undistort=True),
        CalibrationImages("csv", Path("set"), white="p99.5"),
    ],
)
def test_the_command_of_images_is_parsed_to_these_images(config):
    words = shlex.split(command_of("a.safetensors", config, [4, 8]))
    assert not any(word.startswith("[") or word == "True" for word in words)
    parser = build_parser("calibrate")
    options = parser.instantiate(parser.parse_args(words_of("calibrate", words[2:])))
    assert CalibrationImages(**vars(options.data)) == config
    assert (options.weights, options.turns) == (Path("a.safetensors"), [4, 8])


def test_the_number_of_views_is_chosen_on_images_of_its_own(trained, tmp_path):
    out = tmp_path / "chosen.safetensors"
    images = CalibrationImages(
        root=trained.parents[1] / "views", scene="soyuz_easy", seed=CALIBRATION.start + 3, count=4
    )
    calibrate_weights(trained, images, turns=[1, 3], out=out)
    said = read_metadata(out).calibration
    chosen = said["chosen"]
    assert chosen["images"] == {"scene": "soyuz_easy", "seed": CHOICES.start + 3, "count": 4}
    assert chosen["medians"].keys() == {"1", "3"}
    assert chosen["turns"] == int(min(chosen["medians"], key=chosen["medians"].get))
    assert read_metadata(out).config.turns == chosen["turns"]
    assert said["command"].endswith("--turns 1 3")


def test_a_network_that_looks_once_is_refused(tmp_path):
    path = tmp_path / "once.safetensors"
    model = FilterformerPose.from_config(
        "tiny", backbone_weights="none", image_size=(64, 64), depth=1, dim=16, heads=2
    )
    model.save_pretrained(path)
    with pytest.raises(ValueError, match="expected a network with a second look"):
        calibrate_weights(path, CalibrationImages(root=tmp_path))


def test_weights_by_name_are_not_written_to(tmp_path, capsys):
    """They are the package's, and all who use it would get others."""
    assert main(["calibrate", "soyuz", "--data.root", str(tmp_path)]) == 2
    assert "out: expected a file, as soyuz is installed for all" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_network_without_rotated_views_has_no_number_of_them_to_choose(tmp_path):
    path = tmp_path / "polar.safetensors"
    model = PolarPose.from_config("polar", backbone_weights="none")
    model.save_pretrained(path)
    images = CalibrationImages(root=tmp_path, count=2)
    with pytest.raises(ValueError, match=r"may change .*\(looks, candidates\), got turns"):
        calibrate_weights(path, images, turns=[1])


def test_views_are_chosen_on_rendered_images_alone(trained, tmp_path):
    path = tmp_path / "weights.safetensors"
    shutil.copy(trained, path)
    with pytest.raises(ValueError, match=r"turns: expected with data\.kind scenes, got urso"):
        calibrate_weights(path, CalibrationImages("urso", tmp_path), turns=[1, 2])
