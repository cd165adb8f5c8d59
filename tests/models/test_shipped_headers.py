"""The headers of the shipped weights describe the files: data, training, calibration."""

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest

from ffpose._internal import zoo
from ffpose._internal.seeds import CALIBRATION, TRAINING
from ffpose.cli import build_parser, words_of
from ffpose.evaluation.baseline import mean_pose
from ffpose.models import read_metadata
from ffpose.render import find_scene, label
from ffpose.training.calibrate import LEAST_DEGREES_OF_FREEDOM
from ffpose.training.calibration_images import (
    DUSK_SEEDS,
    EMPTY_SEEDS,
    RANDOMIZATION,
    RANDOMIZED_SEEDS,
    TRUNCATED_SEEDS,
    TRUNCATED_SHARE,
)
from ffpose.training.options import load_config
from ffpose.training.provenance import recipe, rendered_sets

CONFIGS = Path(__file__).parents[2] / "configs"
CALIBRATED_ON = {"dragon": "dragon_hard", "soyuz": "soyuz_hard"}
TRAININGS = {"dragon": ["dragon.yaml"], "soyuz": ["soyuz.yaml", "soyuz-first.yaml"]}
SAME = (
    "model",
    "model_fields",
    "stages",
    "batch_size",
    "ema",
    "init_share",
    "optimizer",
    "views",
    "seed",
)


def test_the_shipped_weights_are_known_here():
    assert sorted(CALIBRATED_ON) == zoo.names()


@pytest.mark.slow
@pytest.mark.parametrize("name", CALIBRATED_ON)
def test_the_sets_in_the_header_have_the_mean_pose_in_the_header(name):
    """Those that the border cuts and the randomized ones are among the poses too."""
    header = read_metadata(name)
    said, sets = header.recipe["data"], header.data["sets"]
    scenes = [
        find_scene(part["scene"], (180.0, 90.0, 180.0)).scaled(*said["distance"]) for part in sets
    ]
    poses = [
        label(scene, part["seed"] + more, index).vector
        for change, more, count in (
            (lambda scene: scene, 0, None),
            (lambda scene: scene.truncated(*TRUNCATED_SHARE), TRUNCATED_SEEDS, said["cut"]),
            (lambda scene: scene.randomized(RANDOMIZATION), RANDOMIZED_SEEDS, said["randomized"]),
            (lambda scene: scene.at_dusk(), DUSK_SEEDS, said["dusk"]),
        )
        for scene, part in zip(map(change, scenes), sets, strict=True)
        for index in range(part["count"] if count is None else count)
    ]
    assert len(poses) == header.data["count"]
    np.testing.assert_allclose(
        mean_pose(np.array(poses)), header.data["mean_pose"], rtol=0, atol=1e-12
    )


def trainings(header):
    """Return recipe and data of each training that the weights had, the last first."""
    found, data = header.recipe, header.data
    yield found, data
    while found["init"] is not None:
        found, data = found["init"]["recipe"], found["init"]["data"]
        yield found, data


def resolved(recipe):
    """Return a recipe with the epochs that were asked for, and the images of each step."""
    first, *others = recipe["stages"]
    epochs = first["epochs"] if recipe["epochs"] is None else recipe["epochs"]
    images = recipe["batch_size"] * recipe["processes"]
    return recipe | {"stages": [first | {"epochs": epochs}, *others], "batch_size": images}


@pytest.mark.parametrize("name", CALIBRATED_ON)
def test_the_trainings_in_the_header_are_those_of_the_configurations(name):
    """The first of them began with random weights."""
    header = read_metadata(name)
    assert {each["count"] for each in header.calibration["images"]} == {600}
    given = list(trainings(header))
    assert len(given) == len(TRAININGS[name])
    for (got, data), file in zip(given, TRAININGS[name], strict=True):
        config = load_config(CONFIGS / file)
        got, expected = resolved(got), resolved(json.loads(json.dumps(recipe(config, None))))
        assert [got[field] for field in SAME] == [expected[field] for field in SAME]
        # Weights were calibrated once more, on as many images as the configurations say.
        assert got["data"] | {"calibration": 600} == expected["data"]
        assert data["sets"] == rendered_sets(config.data)["sets"]
        assert all(part["seed"] in TRAINING for part in data["sets"])


@pytest.mark.parametrize("name", CALIBRATED_ON)
def test_the_command_in_the_header_names_the_images_in_the_header(name):
    said = read_metadata(name).calibration
    words = shlex.split(said["command"])
    assert words[:2] == ["ffpose", "calibrate"]
    parser = build_parser("calibrate")
    options = parser.instantiate(parser.parse_args(words_of("calibrate", words[2:])))
    data = options.data
    kinds = (
        *((True, 0), (data.cut, TRUNCATED_SEEDS), (data.randomized, RANDOMIZED_SEEDS)),
        *((data.dusk, DUSK_SEEDS), (True, EMPTY_SEEDS)),
    )
    seeds = [data.seed + more for shown, more in kinds if shown]
    assert [(each["scene"], each["seed"], each["count"]) for each in said["images"]] == [
        (data.scene, seed, data.count) for seed in seeds
    ]
    assert data.scene == CALIBRATED_ON[name]
    assert all(seed in CALIBRATION for seed in seeds)
    assert (data.cut, data.randomized, data.distance) == (True, True, (0.7, 1.4))


@pytest.mark.parametrize("name", CALIBRATED_ON)
def test_calibrated_values_are_not_rounded_and_not_at_a_bound(name):
    metadata = read_metadata(name)
    config = metadata.config
    values = (
        metadata.in_view_threshold,
        config.distance_scale,
        *config.doubt_sigma,
        *config.truncation_sigma,
    )
    assert all(value != round(value, 6) for value in values)
    assert all(math.isfinite(value) and value > 0 for value in values)
    assert all(LEAST_DEGREES_OF_FREEDOM <= nu < 100 for nu in config.degrees_of_freedom)
