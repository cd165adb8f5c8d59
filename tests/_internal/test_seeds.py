"""Seeds have one purpose each, and those of the final figures are rendered by one command alone."""

import ast
import itertools
from pathlib import Path

import pytest

from ffpose._internal import seeds
from ffpose._internal.seeds import (
    CALIBRATION,
    CHOICES,
    FINAL,
    TRAINING,
    VALIDATION,
    matching,
    refuse_final,
)
from ffpose.cli import COMMANDS, main
from ffpose.demo.config import DemoConfig
from ffpose.render.dataset.writer import write_dataset
from ffpose.training import DataConfig

PACKAGE = Path(seeds.__file__).parents[1]
PURPOSES = {
    "TRAINING": TRAINING,
    "CHOICES": CHOICES,
    "VALIDATION": VALIDATION,
    "CALIBRATION": CALIBRATION,
    "FINAL": FINAL,
}


def test_no_seed_has_two_purposes():
    for one, other in itertools.combinations(PURPOSES.values(), 2):
        assert range(max(one.start, other.start), min(one.stop, other.stop)) == range(0)
        assert len(one) == len(other)


@pytest.mark.parametrize("purpose", PURPOSES)
def test_matching_seeds_are_of_their_purpose_and_differ_as_those_of_trainings_do(purpose):
    found = [matching(PURPOSES[purpose], seed) for seed in (0, 101, 999_999, 1_000_102)]
    assert all(seed in PURPOSES[purpose] for seed in found)
    assert len(set(found)) == 4


def test_only_the_card_names_the_final_seeds():
    """By name; a number is refused by whatever takes one (below)."""
    naming = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.name] if isinstance(node, ast.alias) else []
            if "FINAL" in [*names, getattr(node, "attr", None)]:
                naming.add(path.relative_to(PACKAGE).as_posix())
    assert naming == {"evaluation/card/measurement.py"}


FINAL_SEED = str(FINAL.start + 7)
TAKE_SEEDS = {
    "render": ["soyuz_easy", "--out", "OUT", "--count", "1", "--size", "64x48", "--seed"],
    "train": ["--data.kind", "scenes", "--data.root", "OUT", "--out", "OUT", "--data.seed"],
    "calibrate": ["soyuz", "--out", "OUT/w.safetensors", "--data.root", "OUT", "--data.seed"],
    "card": ["soyuz", "--scene", "soyuz_easy", "--count", "1", "--size", "64x48", "--seed"],
}
"""Commands that take the seed of scenes as their last argument."""

RENDER_NO_CHOSEN_SCENES = {
    *("evaluate", "predict", "track", "export", "inspect", "bench", "demo"),
    "learn",  # by `matching`
}


def test_every_command_is_known_here():
    assert {*TAKE_SEEDS, *RENDER_NO_CHOSEN_SCENES} == set(COMMANDS)


@pytest.mark.parametrize("command", TAKE_SEEDS)
def test_no_command_renders_a_final_seed_that_it_is_given(command, tmp_path, capsys, monkeypatch):
    rendered = []
    monkeypatch.setattr(
        "ffpose.render.renderer.situation", lambda *arguments: rendered.append(arguments)
    )
    words = [word.replace("OUT", str(tmp_path)) for word in TAKE_SEEDS[command]]
    try:
        code = main([command, *words, FINAL_SEED])
    except SystemExit as end:
        code = end.code
    assert code in (1, 2)
    assert "seed: expected" in capsys.readouterr().err
    assert not rendered


def test_the_seeds_of_demo_and_studies_are_for_choices():
    from studies.run import TEST_SEED

    assert DemoConfig().seed in CHOICES
    assert TEST_SEED in CHOICES


def test_a_set_of_final_scenes_is_not_written(tmp_path):
    with pytest.raises(ValueError, match="which ffpose card --final alone renders, got 5000007"):
        write_dataset("soyuz_easy", tmp_path / "set", 1, int(FINAL_SEED), size=(64, 48))
    assert not list(tmp_path.iterdir())
    for seed in (FINAL.start - 1, FINAL.stop):
        refuse_final(seed)


def test_what_trains_validates_and_calibrates_is_of_other_seeds(tmp_path):
    config = DataConfig("scenes", tmp_path, scene="soyuz_hard+soyuz_easy", seed=101)
    assert config.calibration_images.seed == CALIBRATION.start + 101
    assert config.calibration_images.scene == "soyuz_hard"


@pytest.mark.parametrize("holdout", [0, 3])
def test_of_a_set_on_disk_no_image_validates_and_calibrates(tmp_path, holdout):
    images = DataConfig("urso", tmp_path, holdout=holdout).calibration_images
    split = list(range(24))
    calibrate = set(split[images.start :: images.step])
    held_out = split[::holdout] if holdout else split
    assert images.split == ("train" if holdout else "val")
    assert calibrate < set(held_out)
    assert not calibrate & set(held_out[::2])
    assert calibrate | set(held_out[::2]) == set(held_out)
