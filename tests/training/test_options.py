"""One style of options: what a field is, it is called by, and what it was called is refused."""

from argparse import ArgumentError

import pytest

from ffpose.cli import build_parser, main, words_of
from ffpose.training.options import to_config
from option_words import changes_of, options_of
from studies.changes import read_changes

REQUIRED = ["--data.kind", "urso", "--data.root", "set", "--out", "run"]


def parsed(*words):
    """Return the configuration of a command line."""
    parser = build_parser("train")
    values = vars(parser.instantiate(parser.parse_args(words_of("train", [*REQUIRED, *words]))))
    return to_config({k: v for k, v in values.items() if k not in ("config", "resume", "debug")})


def test_options_have_hyphens():
    config = parsed("--batch-size", "4", "--data.train-split", "all", "--optimizer.clip-norm=1")
    assert (config.batch_size, config.data.train_split) == (4, "all")
    assert config.optimizer.clip_norm == 1


def test_a_model_is_a_preset_and_its_fields_are_options():
    config = parsed("--model", "tiny", "--model.depth", "4", "--model.image-size", "96,128")
    assert config.model == "tiny"
    assert config.model_fields == {"depth": 4, "image_size": [96, 128]}
    assert parsed("--model.depth", "4").model == "base"
    fields = {"image_size": [48, 64], "filter": "none", "dropout": 0.25}
    assert parsed(*options_of(fields)).model_fields == fields


def test_options_change_the_fields_of_a_file(tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text("model: {name: small, depth: 3, dim: 64}\ndata: {augmentation: {roll: 9}}\n")
    given = ["--model.depth", "2", "--data.augmentation.pan", "5"]
    config = parsed("--config", str(path), *given)
    assert (config.model, config.model_fields) == ("small", {"depth": 2, "dim": 64})
    assert config.data.augmentation == {"roll": 9, "pan": 5}
    again = parsed("--config", str(path), "--model", "tiny")
    assert (again.model, again.model_fields) == ("tiny", {"depth": 3, "dim": 64})


def test_the_papers_images_are_two_fields_of_data():
    given = ["--data.mode", "center_crop", "--data.augmentation.random-crop", "--seed", "3"]
    config = parsed(*given)
    assert (config.data.mode, config.data.augmentation) == ("center_crop", {"random_crop": True})


def test_lists_have_commas():
    scenes = ["--data.kind", "scenes", "--data.scene", "a+b", "--data.count", "3000,2000"]
    config = parsed(*scenes, "--data.attitude-range-deg=1,2,3")
    assert config.data.counts == [3000, 2000]
    assert config.data.attitude_range_deg == (1, 2, 3)
    assert parsed("--data.root", "a,b").data.root.name == "a,b"


SCENES, CSV = ["--data.kind", "scenes"], ["--data.kind=csv"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            [*CSV, "--data.count", "5"],
            "--data.count: expected with --data.kind scenes, got it .*csv",
        ),
        (["--data.attitude-range-deg=1,2,3"], "expected with --data.kind scenes, got it with urso"),
        ([*SCENES, "--data.val-split", "a"], "expected with a set on disk, got it with scenes"),
        (["--views.jpeg", "0.3"], "expected with a network that looks twice, got it with base"),
        (["--model", "tiny", "--object-loss.mask=0"], "a network that looks twice, got .*tiny"),
        (["--model=polar", "--loss.antipodal"], "a network that looks once, got it with polar"),
        (["--config", "{}", "--data.augmentation.roll=9"], "looks once, got it with polar"),
    ],
)
def test_options_that_the_images_or_the_network_do_not_heed_are_refused(tmp_path, words, expected):
    path = tmp_path / "run.yaml"
    path.write_text("model: {name: polar}\ndata: {kind: scenes, count: 7}\nviews: {jpeg: 0.5}\n")
    with pytest.raises(ArgumentError, match=expected):
        parsed(*(word.format(path) for word in words))


def test_a_file_has_fields_of_other_images_and_networks_too(tmp_path):
    """As that of a run on rendered scenes, from which a training on real images goes on."""
    path = tmp_path / "run.yaml"
    path.write_text("model: {name: polar}\ndata: {kind: scenes, count: 7}\nviews: {jpeg: 0.5}\n")
    tuned = parsed("--config", str(path), *CSV, "--object-loss.mask", "0", "--data.val-split", "b")
    assert (tuned.data.kind, tuned.data.val_split, tuned.views.jpeg) == ("csv", "b", 0.5)
    assert parsed("--config", str(path), "--model", "tiny", "--loss.s-t", "0").views.jpeg == 0.5
    assert parsed(*CSV, "--config", str(path), "--data.count", "5").data.counts == [5]
    assert parsed("--model.name", "polar", *CSV, "--views.jpeg", "0.2").views.jpeg == 0.2
    other = tmp_path / "data.yaml"
    other.write_text("kind: csv\nroot: real\n")
    files = ["--config", str(path), "--data", str(other)]
    assert parsed(*files, "--data.val-split", "b").data.val_split == "b"
    with pytest.raises(ArgumentError, match=r"--data\.count: expected with --data\.kind s"):
        parsed(*files, "--data.count", "5")


def test_what_is_true_is_a_switch():
    assert parsed("--data.cache", "--seed", "1").data.cache
    assert parsed("--tensorboard").tensorboard
    assert not parsed("--data.augment", "false").data.augment


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--batch_size", "4"], "expected hyphens, --batch-size, got --batch_size"),
        (["--data.train_split=a"], "expected hyphens, --data.train-split, got --data.train_split"),
        (
            ["--model.image_size", "8,8"],
            "expected hyphens, --model.image-size, got --model.image_size",
        ),
        (["--model", '{"name": "tiny"}'], "an option for each field, --model.FIELD VALUE, got"),
        (["--data.augmentation", "{roll: 9}"], "--data.augmentation.FIELD VALUE, got {roll: 9}"),
        (["--optimizer", '{"eps": 1}'], "an option for each field, --optimizer.FIELD VALUE, got"),
        (["--data.count", "[3,2]"], "expected a list as --data.count 1,2, got [3,2]"),
        (["--model.image-size=[8,8]"], "expected a list as --model.image-size 1,2, got [8,8]"),
        (["--stages", "[]"], "expected stages in a file, --config FILE, got --stages []"),
        (["--stages", "joint"], "expected stages in a file, --config FILE, got --stages joint"),
        (["--model", "tyni"], "model: expected one of base, small, tiny, "),
        (["--model.depht", "4"], "got depht (did you mean depth?)"),
        (["--batch-sise", "4"], "(did you mean --batch-size?)"),
    ],
)
def test_other_spellings_are_refused_with_the_right_one(words, expected, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["train", *REQUIRED, *words])
    assert leaving.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line


@pytest.mark.parametrize("text", ["model: tiny", "model_fields: {depth: 3}"])
def test_a_file_has_the_network_and_its_fields_together(text, tmp_path, capsys):
    (tmp_path / "old.yaml").write_text(text)
    with pytest.raises(SystemExit):
        main(["train", *REQUIRED, "--config", str(tmp_path / "old.yaml")])
    assert "expected model: {name: base, FIELD: VALUE}, got model" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["render", "soyuz_easy", "--eclipse_rate", "0"], "--eclipse-rate, got --eclipse_rate"),
        (["render", "soyuz_easy", "--mesh_scale=2"], "hyphens, --mesh-scale, got --mesh_scale"),
    ],
)
def test_all_commands_have_hyphens(command, expected, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(command)
    assert leaving.value.code == 2
    assert expected in capsys.readouterr().err


def test_changes_of_a_study_are_fields_with_their_values():
    changes = ["data.count=3,2", "data.augment=false", "model=tiny", "optimizer.learning-rate=1e-3"]
    assert read_changes([*changes, "model.image-size=8,16"]) == {
        "data": {"count": [3, 2], "augment": False},
        "model": "tiny",
        "model_fields": {"image_size": [8, 16]},
        "optimizer": {"learning_rate": 1e-3},
    }
    assert read_changes([]) == {}
    fields = {"data": {"workers": 0, "root": "b"}, "batch_size": 4}
    changed = read_changes(changes_of(fields))
    assert changed["batch_size"] == 4
    assert (changed["data"]["workers"], str(changed["data"]["root"])) == (0, "b")
