"""The configurations in configs/ are read as they stand, each by the network that it names."""

import re
import subprocess
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
import yaml

from ffpose.cli import main
from ffpose.config import PRESETS
from ffpose.training import configs
from ffpose.training.config import DataConfig, TrainConfig
from ffpose.training.options import load_config
from ffpose.training.stages import PAPER_STAGES, check_stages
from studies.paper import TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5

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
        main(["train", *words, "--print-config"])
    printed = folder / "config.yaml"
    command_line = ("resume:", "debug:")
    lines = capsys.readouterr().out.splitlines(keepends=True)
    printed.write_text("".join(line for line in lines if not line.startswith(command_line)))
    return load_config(printed)


PAPER = sorted((ROOT / "configs/paper").glob("*.yaml"))


def made(config):
    """What distinguishes the numbers that the paper publishes: the network and the images."""
    network = PRESETS[config.model].with_fields(config.model_fields)
    data = config.data
    return network, data.kind, data.root.name, data.holdout


@pytest.mark.slow
def test_each_number_of_the_paper_has_its_configuration(tmp_path, capsys):
    """Each variant of the five tables is made by one file, whose first line has its numbers."""
    configs = {}
    for path in PAPER:
        words = ["--config", "paper", "--config", str(path)]
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


def test_the_papers_training_is_what_the_paper_says(capsys, tmp_path):
    """Section 4.3, which the defaults of the configuration follow where it gives a figure."""
    words = ["--config", "paper", "--data.root", str(tmp_path), "--out", "runs/paper"]
    config = parsed(words, tmp_path, capsys)
    crop = {"random_crop": True, "noise": 0.0, "blur": 0.0}
    data = DataConfig("urso", tmp_path, mode="center_crop", augmentation=crop)
    out = Path("runs/paper")
    assert config == TrainConfig(data, out, stages=PAPER_STAGES)


def test_the_papers_training_is_in_the_package():
    """So that an installation has it, without the sources."""
    text = (resources.files("ffpose.training.configs") / "paper.yaml").read_text()
    assert yaml.safe_load(text)["model"] == {"name": "base"}
    assert configs.names() == ["paper"]


def test_a_file_has_precedence_over_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = configs.resolve("paper")
    assert shipped.is_file()
    Path("paper").write_text("seed: 3")
    assert configs.resolve("paper") == Path("paper")


@pytest.mark.parametrize("words", [["--config", "papre"], ["--config=papre"]])
def test_an_unknown_configuration_is_refused(words, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["train", *words])
    assert leaving.value.code == 2
    expected = "config: expected a YAML file or a name (one of paper), got papre"
    assert expected in capsys.readouterr().err
