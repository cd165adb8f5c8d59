"""The headers of the shipped weights describe the files: data, chain of trainings, calibration."""

import math
import shlex
from pathlib import Path

import numpy as np
import pytest

from ffpose._internal.seeds import CALIBRATION, CHOICES, TRAINING
from ffpose.cli import build_parser
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.card.seen import trainings
from ffpose.models import read_metadata, zoo
from ffpose.render import label
from ffpose.training.calibration_images import CUT_SEEDS, EMPTY_SEEDS
from ffpose.training.config_file import load_config
from ffpose.training.data import find_scene
from ffpose.training.provenance import recipe, rendered_sets

CONFIGS = Path(__file__).parents[2] / "configs"
CHAINS = {
    "dragon-hard": ["dragon-hard", "dragon-hard-begin", "soyuz-shared"],
    "soyuz-easy": ["soyuz-easy", "soyuz-easy-robust", "soyuz-easy-robust-begin", "soyuz-shared"],
    "soyuz-hard": ["soyuz-hard", "soyuz-shared"],
}
SAME = ("model", "model_fields", "epochs", "batch_size", "ema", "optimizer", "views", "seed")
SAME_DATA = ("kind", "scene", "count", "seed", "validation", "empty", "decoys")


def test_the_shipped_weights_are_known_here():
    assert sorted(CHAINS) == zoo.names()


@pytest.mark.slow
@pytest.mark.parametrize("name", CHAINS)
def test_the_sets_in_the_header_have_the_mean_pose_in_the_header(name):
    data = read_metadata(name).data
    poses = [
        label(find_scene(part["scene"], (180.0, 90.0, 180.0)), part["seed"], index).vector
        for part in data["sets"]
        for index in range(part["count"])
    ]
    assert len(poses) == data["count"]
    np.testing.assert_allclose(mean_pose(np.array(poses)), data["mean_pose"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CHAINS)
def test_the_chain_in_the_header_is_that_of_the_configurations(name):
    chain = trainings(read_metadata(name).recipe)
    assert len(chain) == len(CHAINS[name])
    for got, config in zip(chain, CHAINS[name], strict=True):
        expected = recipe(load_config(CONFIGS / f"{config}.yaml"), None)
        assert [got[field] for field in SAME] == [expected[field] for field in SAME]
        assert [got["data"][f] for f in SAME_DATA] == [expected["data"][f] for f in SAME_DATA]
        for kind in ("cut", "randomized"):
            assert got["data"].get(kind, 0) == expected["data"][kind]
    config = load_config(CONFIGS / f"{name}.yaml")
    data = read_metadata(name).data
    assert data["sets"] == rendered_sets(config.data)["sets"]
    assert all(part["seed"] in TRAINING for part in data["sets"])


@pytest.mark.parametrize("name", CHAINS)
def test_the_command_in_the_header_names_the_images_in_the_header(name):
    metadata = read_metadata(name)
    said = metadata.calibration
    words = shlex.split(said["command"])
    assert words[:3] == ["ffpose", "calibrate", name]
    options = build_parser("calibrate").parse_args(words[2:])
    data = options.data
    seeds = [data.seed + more for more in (0, CUT_SEEDS, EMPTY_SEEDS)]
    assert [(each["scene"], each["seed"], each["count"]) for each in said["images"]] == [
        (data.scene, seed, data.count) for seed in seeds
    ]
    assert data.scene == name.replace("-", "_")
    assert all(seed in CALIBRATION for seed in seeds)
    chosen = said["chosen"]
    assert list(map(int, chosen["medians"])) == options.turns
    assert metadata.config.turns == chosen["turns"]
    assert chosen["images"]["seed"] in CHOICES


@pytest.mark.parametrize("name", CHAINS)
def test_calibrated_values_are_not_rounded_and_not_at_a_bound(name):
    metadata = read_metadata(name)
    config = metadata.config
    values = (config.distance_scale, *config.hidden_sigma, metadata.in_view_threshold)
    assert all(value != round(value, 6) for value in values)
    assert all(math.isfinite(value) and 0 < value != 50 for value in values)
    assert 0 < metadata.calibration["hidden"] <= 200
