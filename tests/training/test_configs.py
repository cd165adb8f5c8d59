"""The configurations in configs/ are read as they stand, each by the network that it names."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from ffpose.cli import main, with_recipe
from ffpose.config import PRESETS
from ffpose.recipes import recipe_file, recipe_names
from ffpose.training.config import DataConfig, TrainConfig
from ffpose.training.config_file import load_config
from ffpose.training.stages import PAPER_STAGES

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "configs").glob("*.yaml"))


def test_there_are_some():
    assert FILES


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_configuration_is_read(path):
    config = load_config(path)
    PRESETS[config.model].with_fields(config.model_fields)
    assert config.out == Path("runs") / path.stem


def test_make_trains_each_weights_after_those_that_they_begin_with(tmp_path):
    command = ["make", "--dry-run", "weights", f"VENV={tmp_path}"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    trained = [Path(name) for name in re.findall(r"train --config (\S+) --resume", printed)]
    assert sorted(trained) == [path.relative_to(ROOT) for path in FILES]
    for place, path in enumerate(trained):
        init = load_config(ROOT / path).init
        assert init is None or Path(init).parent.name in {each.stem for each in trained[:place]}


def test_the_papers_recipe_is_what_the_paper_says(capsys, tmp_path):
    """Section 4.3, which the defaults of the configuration follow where it gives a figure."""
    words = ["train", "--recipe", "paper", "--data.root", str(tmp_path), "--out", "runs/paper"]
    with pytest.raises(SystemExit):
        main([*words, "--print_config"])
    printed = tmp_path / "config.yaml"
    command_line = ("recipe:", "transforms:", "resume:", "debug:")
    lines = capsys.readouterr().out.splitlines(keepends=True)
    printed.write_text("".join(line for line in lines if not line.startswith(command_line)))
    crop = {"random_crop": True, "noise": 0.0, "blur": 0.0}
    data = DataConfig("urso", tmp_path, mode="center_crop", augmentation=crop)
    out = Path("runs/paper")
    assert load_config(printed) == TrainConfig(data, out, stages=PAPER_STAGES)


@pytest.mark.parametrize("words", [["--recipe", "papre"], ["--recipe=papre"]])
def test_an_unknown_recipe_is_refused(words, capsys):
    assert main(["train", *words]) == 1
    assert "recipe: expected one of paper, got 'papre'" in capsys.readouterr().err


def test_a_recipe_has_a_file():
    assert recipe_file("paper").is_file()


def test_transforms_by_name_are_fields_of_the_configuration():
    assert recipe_names("transforms") == ["paper", "resize"]
    paper = recipe_file("paper", "transforms")
    assert with_recipe(["--transforms", "paper", "--out", "x"]) == [
        *("--config", str(paper), "--out", "x")
    ]
    recipe = yaml.safe_load(recipe_file("paper").read_text())["data"]
    assert yaml.safe_load(paper.read_text())["data"] == {
        name: recipe[name] for name in ("mode", "augmentation")
    }
    with pytest.raises(ValueError, match="transforms: expected one of paper, resize, got 'paperr'"):
        recipe_file("paperr", "transforms")
