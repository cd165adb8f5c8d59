"""Studies run variant by variant, and are stopped and continued."""

import csv
import json
import shutil
from dataclasses import replace

import pytest
import torch

from cambridge_sets import write_landmarks
from ffpose.training import PAPER_STAGES, Stage
from ffpose.training.engine import train
from studies import STUDIES, Variant, run
from studies.__main__ import main
from studies.table import read_results
from tiny_study import tiny_study, write_sets

RUNS = ("grid-seed0", "none-seed0", "grid-seed1", "none-seed1")


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    return write_sets(tmp_path_factory.mktemp("sets"))


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def trained(monkeypatch):
    """The names of the runs that were trained since."""
    names = []

    def counted(config, **options):
        names.append(config.out.name)
        return train(config, **options)

    monkeypatch.setattr(run, "train", counted)
    return names


def ablated(out, sets, **options):
    return run.ablate(tiny_study(), out, sets=sets, quiet=True, **options)


@pytest.fixture(scope="module")
def finished(sets, tmp_path_factory, one_thread):
    """The folder of a study of one run, which stays as it is."""
    out = tmp_path_factory.mktemp("study")
    ablated(out, sets, seeds=1, variants=["none"])
    return out


def rows_of(out):
    with (out / "ablation.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_study_is_gone_on_with_after_the_runs_that_are_there(tmp_path, sets, trained):
    out = tmp_path / "study"
    assert ablated(out, sets, seeds=1).done == RUNS[:2]
    before = (out / "grid-seed0/results.json").read_bytes()
    outcome = ablated(out, sets, seeds=2)
    assert outcome.done == RUNS[2:]
    assert tuple(trained) == RUNS
    assert (out / "grid-seed0/results.json").read_bytes() == before
    assert [f"{row['variant']}-seed{row['seed']}" for row in rows_of(out)] == sorted(RUNS)
    assert {row["samples"] for row in rows_of(out)} == {"20.0"}  # two epochs of ten images
    assert outcome.table.read_text().startswith("# Ablation: tiny")


def test_an_interrupted_run_is_taken_up_after_its_last_epoch(tmp_path, sets, monkeypatch):
    def interrupted(config, **options):
        train(replace(config, stages=(Stage("joint", 1),), epochs=None), **options)
        raise KeyboardInterrupt

    out = tmp_path / "study"
    with monkeypatch.context() as patch:
        patch.setattr(run, "train", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ablated(out, sets, seeds=1, variants=["none"], epochs=2)
    first = (out / "none-seed0/results.csv").read_text().splitlines()
    assert not (out / "none-seed0/results.json").exists()
    ablated(out, sets, seeds=1, variants=["none"], epochs=2)
    again = (out / "none-seed0/results.csv").read_text().splitlines()
    assert (again[:2], len(again)) == (first, 3)


def test_the_images_alone_are_rendered_before_a_job_array(tmp_path, sets, trained):
    outcome = ablated(tmp_path / "study", sets, seeds=1, prepare=True)
    assert (outcome.done, trained) == ((), [])
    assert "No run has finished" in outcome.table.read_text()


@pytest.mark.parametrize(
    "options", [{"epochs": 3}, {"changes": {"batch_size": 5}}, {"cpu_minutes": 1.0}]
)
def test_runs_of_other_settings_are_not_mixed(tmp_path, sets, finished, trained, options):
    out = shutil.copytree(finished, tmp_path / "study")
    with pytest.raises(ValueError, match=r"none-seed0: expected (stages|epochs|batch_size) "):
        ablated(out, sets, **options)
    assert trained == []


def test_a_budget_of_time_ends_after_the_epoch_that_uses_it_up(tmp_path, sets):
    ablated(tmp_path, sets, seeds=1, variants=["none"], cpu_minutes=1e-6)
    assert rows_of(tmp_path)[0]["epochs"] == "1"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"epochs": 1, "cpu_minutes": 1.0}, "budget: expected epochs or minutes"),
        ({"cpu_minutes": 0.0}, "minutes: expected more than 0"),
        (
            {"cpu_minutes": 1.0, "changes": {"optimizer": {"schedule": "cosine"}}},
            "minutes: expected optimizer.schedule step",
        ),
        ({"seeds": 0}, "seeds: expected at least 1, got 0"),
        ({"variants": ["nothing"]}, "variants: expected one of grid, none, got 'nothing'"),
        ({"changes": {"model_fields": {"depths": 1}}}, "expected fields out of"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_written(tmp_path, sets, options, text):
    with pytest.raises(ValueError, match=text):
        ablated(tmp_path / "study", sets, **options)
    assert not (tmp_path / "study").exists()


def test_landmarks_cannot_be_rendered(tmp_path):
    with pytest.raises(ValueError, match="sets: expected the folder that holds KingsCollege"):
        run.ablate(STUDIES["table5"], tmp_path / "study", quiet=True)


def test_table_5_is_of_landmarks_on_disk(tmp_path):
    write_landmarks(tmp_path / "sets/ShopFacade")
    fields = {"image_size": [64, 64], "backbone": "compact_resnet_narrow", "reduction": 16}
    outcome = run.ablate(
        STUDIES["table5"],
        tmp_path / "study",
        seeds=1,
        epochs=3,
        variants=["ShopFacade-posenet"],
        changes={
            "model_fields": fields,
            "backbone_weights": "none",
            "data": {"workers": 0, "cache": False},
        },
        sets=tmp_path / "sets",
        quiet=True,
    )
    assert outcome.done == ("ShopFacade-posenet-seed0",)
    result = json.loads((tmp_path / "study/ShopFacade-posenet-seed0/results.json").read_text())
    assert result["test"]["images"] == 4
    stages = [
        row["stage"]
        for row in read_results(tmp_path / "study/ShopFacade-posenet-seed0/results.csv")
    ]
    assert stages == ["joint", "translation", "orientation"]
    median = result["test"]["median_translation_error_m"]
    line = next(x for x in outcome.table.read_text().splitlines() if "1.46 m | 8.08°" in x)
    assert line.startswith(f"| ShopFacade-posenet | {median:.2f} m")


SMALL = {
    "data": {"count": 8, "empty": 2, "decoys": 2, "validation": 4, "calibration": 4, "workers": 0},
    "batch_size": 4,
    "epochs": 1,
    "device": "cpu",
    "model_fields": {
        "image_size": [96, 128],
        "first_stride": 4,
        "object_size": [16, 96],
        "channels": [8, 16, 24],
        "blocks": [1, 1],
        "latent": 32,
        "directions": 50,
    },
}


@pytest.mark.slow
def test_one_look_and_two_train_and_are_tested_on_the_same_scenes(tmp_path):
    mixers = STUDIES["mixers"]
    frame = {"model_fields": {"image_size": [96, 128], "dim": 16, "head_hidden": 16}}
    once = replace(mixers, base=replace(mixers.base, model="tiny", model_fields={}))
    once = replace(once, variants=(Variant("frame", ""),))
    for study, fields in ((mixers, SMALL), (once, SMALL | frame)):
        run.ablate(
            study,
            tmp_path / study.variants[0].name,
            seeds=1,
            variants=[study.variants[0].name],
            changes=fields,
            test_images=5,
            quiet=True,
        )
    first, second = (
        json.loads((tmp_path / name / f"{name}-seed0/results.json").read_text())["test"]
        for name in ("filter", "frame")
    )
    assert first["images"] == second["images"] == 5
    poses = [each["mean_pose_baseline"]["pose"] for each in (first, second)]
    assert poses[0] == pytest.approx(poses[1], abs=1e-9)  # means of the same labels
    assert first["median_rotation_error_deg"] != second["median_rotation_error_deg"]


def test_the_command_prints_the_table(tmp_path, sets, monkeypatch, capsys):
    study = tiny_study()
    monkeypatch.setattr("studies.STUDIES", {"tiny": study})
    words = ["tiny", "--out", str(tmp_path / "study"), "--sets", str(sets)]
    changes = ["--changes", "model.dropout=0.0", "data.workers=0"]
    assert main([*words, *changes, "--seeds", "1", "--epochs", "1", "--variants", "none"]) == 0
    said = capsys.readouterr()
    assert said.out == (tmp_path / "study/ablation.md").read_text()
    assert "1 of 1: none-seed0, no filter" in said.err
    result = json.loads((tmp_path / "study/none-seed0/results.json").read_text())
    assert result["settings"]["model_fields"]["dropout"] == 0.0


def test_the_command_lists_the_studies(tmp_path, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["mixer", "--out", str(tmp_path)])
    assert leaving.value.code == 2
    assert "'mixers', 'networks', 'table1', 'table2'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (['{"data": {"count": 8}}'], "FIELD=VALUE, as data.count=8, got"),
        (["data.count", "8"], "FIELD=VALUE, as data.count=8, got"),
        (["batch_size=8"], "expected hyphens, --batch-size, got --batch_size"),
        (["batch-size=many"], "batch_size"),
        (["data.cuont=8"], "cuont"),
    ],
)
def test_changes_in_another_style_are_refused(changes, expected, tmp_path, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["mixers", "--out", str(tmp_path / "a"), "--changes", *changes])
    assert leaving.value.code == 2
    assert expected in capsys.readouterr().err


def test_a_value_that_cannot_be_is_one_line(tmp_path, capsys):
    """It is wrong usage, as an unknown variant is."""
    for words, expected in (
        (["--seeds", "0"], "seeds: expected at least 1, got 0\n"),
        (
            ["--variants", "nothing"],
            "variants: expected one of filter, depthwise3, depthwise7, attention, filterformer,"
            " got 'nothing'\n",
        ),
    ):
        with pytest.raises(SystemExit) as leaving:
            main(["mixers", "--out", str(tmp_path / "a"), *words])
        assert leaving.value.code == 2
        assert capsys.readouterr().err.endswith(f"error: {expected}")


@pytest.mark.parametrize(
    ("epochs", "expected"), [(3, [1, 1, 1]), (19, [11, 4, 4]), (1603, [1001, 301, 301])]
)
def test_shortened_stages_keep_their_proportions(epochs, expected):
    stages = run.shortened(PAPER_STAGES, epochs)
    assert [stage.epochs for stage in stages] == expected
    assert [stage.freeze for stage in stages] == [stage.freeze for stage in PAPER_STAGES]


def test_too_few_epochs_for_the_stages_are_refused():
    with pytest.raises(ValueError, match="expected at least 3, one a stage, got 2"):
        run.shortened(PAPER_STAGES, 2)
