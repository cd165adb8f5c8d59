"""The configurations in configs/ are read as they stand, each by the network that it names."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from ffpose.ablation.paper import TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5
from ffpose.cli import main, with_recipe
from ffpose.config import PRESETS
from ffpose.recipes import recipe_file, recipe_names
from ffpose.training.config import DataConfig, TrainConfig
from ffpose.training.config_file import load_config
from ffpose.training.stages import PAPER_STAGES, check_stages

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


def parsed(words, folder, capsys):
    """Return the configuration that ``ffpose train`` reads from its arguments."""
    with pytest.raises(SystemExit):
        main(["train", *words, "--print_config"])
    printed = folder / "config.yaml"
    command_line = ("recipe:", "transforms:", "resume:", "debug:")
    lines = capsys.readouterr().out.splitlines(keepends=True)
    printed.write_text("".join(line for line in lines if not line.startswith(command_line)))
    return load_config(printed)


PAPER = sorted((ROOT / "configs/paper").glob("*.yaml"))


def made(config):
    """What distinguishes the numbers that the paper publishes: the network and the images."""
    network = PRESETS[config.model].with_fields(config.model_fields)
    data = config.data
    return network, data.kind, data.root.name, data.holdout


def test_each_number_of_the_paper_has_its_configuration(tmp_path, capsys):
    """Each variant of the five tables is made by one file, whose first line has its numbers."""
    configs = {}
    for path in PAPER:
        words = ["--recipe", "paper", "--config", str(path)]
        config = parsed(words, tmp_path, capsys)
        assert config.stages == PAPER_STAGES
        check_stages(PRESETS[config.model].parts, config.stages)
        assert config.data.mode == "center_crop"
        assert config.out == Path("runs/paper") / path.stem
        assert made(config) not in configs
        configs[made(config)] = path
    used = set()
    for number, study in enumerate((TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5), start=1):
        for variant in study.variants:
            config = replace(study.base, **plain(study, variant))
            path = configs[made(config)]
            (t_m, q_deg), first = variant.paper[:2], path.read_text().splitlines()[0]
            assert f"Table {number}: {t_m:g} m, {q_deg:g}°" in first
            assert ("medians" in first) == study.medians
            used.add(path)
    assert used == set(PAPER)


def plain(study, variant):
    """Return a variant's fields with the folder on which the paper measured it."""
    changes = dict(variant.changes)
    camera = study.base.data.kind == "cambridge"
    scene = changes.pop("data", {}).get("scene", "soyuz_hard")
    kind, folder = ("cambridge", "Cambridge") if camera else ("urso", "URSO")
    data = DataConfig(kind, Path(folder) / scene, holdout=10 if camera else 0)
    return {"data": data, **changes}


def test_the_papers_recipe_is_what_the_paper_says(capsys, tmp_path):
    """Section 4.3, which the defaults of the configuration follow where it gives a figure."""
    words = ["--recipe", "paper", "--data.root", str(tmp_path), "--out", "runs/paper"]
    config = parsed(words, tmp_path, capsys)
    crop = {"random_crop": True, "noise": 0.0, "blur": 0.0}
    data = DataConfig("urso", tmp_path, mode="center_crop", augmentation=crop)
    out = Path("runs/paper")
    assert config == TrainConfig(data, out, stages=PAPER_STAGES)


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
