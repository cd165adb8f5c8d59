import subprocess
import sys
from pathlib import Path

import pytest

from ffpose.errors import DataError
from ffpose.training import DataConfig, LossConfig, OptimizerConfig, Stage, TrainConfig
from ffpose.training.config import CalibrationImages
from ffpose.training.options import (
    dump_config,
    field_parser,
    flatten,
    load_config,
    read_words,
    to_config,
)


def config(**fields):
    return TrainConfig(data=DataConfig("urso", Path("set")), out=Path("run"), **fields)


def test_the_defaults_are_the_papers():
    paper = config()
    assert (paper.model, paper.batch_size, paper.resolved_stages[0].epochs) == ("base", 8, 500)
    assert (paper.loss.s_t, paper.loss.s_q) == (-3.0, -6.5)
    adam = paper.optimizer
    assert (adam.learning_rate, adam.weight_decay, adam.eps) == (1e-4, 1e-4, 1e-10)
    assert (adam.schedule, adam.step_epochs, adam.step_factor) == ("step", 200, 0.1)


def test_epochs_are_those_of_the_first_stage():
    stages = (Stage("a", 5), Stage("b", 7))
    assert config(stages=stages).resolved_stages == stages
    assert config(stages=stages, epochs=2).resolved_stages == (Stage("a", 2), stages[1])


def test_yaml_brings_back_what_was_written(tmp_path):
    original = config(
        model_fields={"depth": 3, "image_size": [32, 64]},
        stages=(Stage("a", 2), Stage("b", 1, ("backbone",))),
        optimizer=OptimizerConfig(schedule="cosine", warmup_epochs=0.5),
        loss=LossConfig(antipodal=True),
        epochs=4,
    )
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(original))
    assert load_config(path) == original


@pytest.mark.parametrize(
    "text",
    [
        "sed: 3",
        "data: [",
        "seed: many",
        "model: base",
        "model_fields: {depth: 3}",
        "{model: {name: huge}, data: {kind: urso, root: a}, out: b}",
        "{model: {depht: 3}, data: {kind: urso, root: a}, out: b}",
    ],
)
def test_a_file_that_is_no_configuration_is_named(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(DataError, match=r"config\.yaml: not a training configuration"):
        load_config(path)


def test_a_configuration_that_is_no_text_is_named(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_bytes(b"\xff\xd8\xff")
    for read in (load_config, lambda path: read_words(["--config", str(path)])):
        with pytest.raises(DataError, match=r"config\.yaml: expected text in UTF-8"):
            read(path)


def test_flat_names_reach_into_groups():
    flat = flatten(config())
    assert flat["data.kind"] == "urso"
    assert flat["optimizer.eps"] == 1e-10
    assert flat["model_fields"] == {}


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: config(batch_size=0), "batch_size: expected 1 or more, got 0"),
        (
            lambda: config(model="huge"),
            "one of base, small, .*posenet, got 'huge'",
        ),
        (lambda: config(epochs=0), "epochs: expected 1 or more, got 0"),
        (lambda: config(stages=()), "stages: expected at least one stage"),
        (lambda: DataConfig("urso", Path(), workers=-1), "data.workers: expected 0 or more"),
        (lambda: DataConfig("scenes", Path(), validation=0), "data.validation: expected 1 or"),
        (lambda: DataConfig("scenes", Path(), calibration=1), "data.calibration: expected 2 or"),
        (lambda: CalibrationImages(seed=101), "data.seed: expected 4000000 to 4999999, .* got 101"),
        (lambda: CalibrationImages(step=0), "data.step: expected 1 or more, got 0"),
        (lambda: CalibrationImages(split="test"), "data.split: expected val with kind scenes, got"),
        (
            lambda: CalibrationImages("csv", count=5),
            "data.count: expected 200 with kind csv, got 5",
        ),
        (
            lambda: CalibrationImages("csv", attitude_range_deg=(30.0, 30.0, 30.0)),
            r"data.attitude_range_deg: expected \(180.0, .*\) with kind csv, got \(30.0",
        ),
        (lambda: OptimizerConfig(learning_rate=0), "learning_rate: expected more than 0, got 0"),
        (lambda: DataConfig("scenes", Path(), seed=10**6), "0 to 999999, .* got 1000000"),
        (lambda: DataConfig("scenes", Path(), seed=-1), "data.seed: expected 0 to 999999"),
        (
            lambda: DataConfig("scenes", Path(), holdout=4),
            "data.holdout: expected 0 with kind scen",
        ),
        (
            lambda: DataConfig("scenes", Path(), undistort=True),
            "data.undistort: expected False with kind scenes, got True",
        ),
        (
            lambda: DataConfig("scenes", Path(), white=4095),
            "data.white: expected None with kind scenes, got 4095",
        ),
        (lambda: config(accumulate=0), "accumulate: expected 1 or more, got 0"),
        (lambda: config(ema=1.0), "ema: expected 0 <= ema < 1, got 1.0"),
        (lambda: config(autocast="float16"), "expected one of none, bfloat16, auto, got 'float16'"),
        (lambda: config(weights_dtype="int8"), "expected one of float32, float16, got 'int8'"),
        (lambda: OptimizerConfig(kind="sgd"), "expected one of adam, adamw, muon, got 'sgd'"),
        (lambda: OptimizerConfig(schedule="linear"), "expected one of step, cosine, got 'linear'"),
    ],
)
def test_bad_values_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_the_configuration_alone_does_not_load_torch():
    code = "import sys; from ffpose.training import TrainConfig; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(("word", "white"), [("4095", 4095.0), ("p99.5", "p99.5")])
def test_a_white_level_survives_the_command_line_and_yaml(tmp_path, word, white):
    parser = field_parser()
    words = ["--data.kind", "csv", "--data.root", "set", "--out", "run", "--data.white", word]
    given = parser.instantiate(parser.parse_args(words))
    assert given.data.white == white
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(to_config(vars(given))))
    assert load_config(path).data.white == white
