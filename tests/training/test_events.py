"""Events for TensorBoard: what the table of results has, also where a run is resumed."""

import sys
from dataclasses import replace

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from ffpose.errors import MissingExtraError
from ffpose.training.engine import train
from ffpose.training.progress import events
from tiny_runs import train_config, write_set


def scalars(folder):
    written = EventAccumulator(str(folder / "tensorboard"))
    written.Reload()
    return {
        name: [(event.step, event.value) for event in written.Scalars(name)]
        for name in written.Tags()["scalars"]
    }


def test_a_training_writes_its_table(tmp_path):
    config = train_config(write_set(tmp_path / "set"), tmp_path / "run")
    result = train(replace(config, tensorboard=True), quiet=True)
    written = scalars(tmp_path / "run")
    numbers = [name for name in result.history[0] if name not in ("epoch", "stage")]
    assert sorted(written) == sorted(numbers)
    for name in numbers:
        assert [epoch for epoch, _ in written[name]] == [row["epoch"] for row in result.history]
        values = [row[name] for row in result.history]
        assert [value for _, value in written[name]] == pytest.approx(values, rel=1e-6)


def test_a_resumed_run_has_each_epoch_once(tmp_path):
    with events(tmp_path, 0, wanted=True) as write:
        for epoch in (1, 2, 3):  # the last was not finished by a checkpoint
            write({"epoch": epoch, "stage": "joint", "loss": float(epoch)})
    with events(tmp_path, 2, wanted=True) as write:
        write({"epoch": 3, "stage": "joint", "loss": 30.0})
    assert scalars(tmp_path) == {"loss": [(1, 1.0), (2, 2.0), (3, 30.0)]}


def test_a_run_that_goes_on_may_write_from_then_on(tmp_path):
    config = replace(train_config(write_set(tmp_path / "set"), tmp_path / "run"), epochs=1)
    train(config, quiet=True)
    train(replace(config, epochs=2, tensorboard=True), resume=True, quiet=True)
    assert {epoch for epoch, _ in scalars(tmp_path / "run")["train_loss"]} == {2}


def test_nothing_is_written_unasked(tmp_path):
    with events(tmp_path, 0, wanted=False) as write:
        write({"epoch": 1, "loss": 1.0})
    assert not list(tmp_path.iterdir())


def test_what_is_missing_is_named_before_the_training(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    config = train_config(tmp_path / "absent", tmp_path / "run", tensorboard=True)
    with pytest.raises(MissingExtraError, match=r"tensorboard.*tb"):
        train(config, quiet=True)
    assert not (tmp_path / "run").exists()
