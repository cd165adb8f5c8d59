"""Several processes that train together do what one does on the same batches."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import chain

import pytest
import torch
from safetensors.torch import load_file

from ffpose import DataError
from ffpose.training import DataConfig, OptimizerConfig, Stage
from ffpose.training.checkpoint import RunFolder, TrainState
from ffpose.training.config import TrainConfig
from ffpose.training.engine import train
from ffpose.training.options import dump_config
from ffpose.training.processes import Processes, count_processes, joined, started
from studies.table import read_results
from tiny_runs import MODEL_FIELDS, train_config, write_set

FIELDS = {**MODEL_FIELDS, "dropout": 0.0}

# Batch norm counts in evaluation: its statistics would be those of each process's own half.
STAGES = (Stage("branches", 7, freeze=("backbone",)),)


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("processes") / "set")


def config_of(image_set, out, **fields):
    # With so large an epsilon Adam does not blow the rounding of zero gradients up to whole steps.
    optimizer = OptimizerConfig(learning_rate=0.02, eps=1.0)
    fields |= {"model_fields": FIELDS, "epochs": None, "stages": STAGES, "optimizer": optimizer}
    config = train_config(image_set, out, **fields)
    return replace(config, data=DataConfig("urso", image_set, augment=False))


@pytest.fixture(scope="module")
def alone(image_set, tmp_path_factory):
    """A training by one process."""
    return train(config_of(image_set, tmp_path_factory.mktemp("one"), batch_size=4), quiet=True)


@pytest.fixture(scope="module")
def together(image_set, tmp_path_factory):
    """A training by two processes."""
    out = tmp_path_factory.mktemp("two")
    return train(config_of(image_set, out, batch_size=2, processes=2), quiet=True)


def are_one(both, alone):
    """Their means over halves of a batch have the mean of the whole: in 21 steps here."""
    assert len(both.history) == 7
    for one, two in zip(alone.history, both.history, strict=True):
        for name in ("train_loss", "val_mean_translation_error_m", "val_median_rotation_error_deg"):
            assert two[name] == pytest.approx(one[name], rel=1e-5), name
    ours, theirs = load_file(both.folder.last), load_file(alone.folder.last)
    for name, tensor in ours.items():
        torch.testing.assert_close(tensor, theirs[name], rtol=1e-4, atol=1e-5, msg=name)


@pytest.mark.slow
def test_two_processes_are_one_of_twice_the_batch(alone, together):
    are_one(together, alone)


@pytest.mark.slow
def test_two_processes_that_accumulate_are_one_of_four_times_the_batch(image_set, tmp_path, alone):
    config = config_of(image_set, tmp_path / "two", batch_size=1, processes=2, accumulate=2)
    are_one(train(config, quiet=True), alone)


@pytest.mark.slow
def test_what_one_process_cannot_do_ends_all(tmp_path):
    config: TrainConfig = config_of(tmp_path / "nothing", tmp_path / "run", processes=2)
    with pytest.raises((DataError, FileNotFoundError)):
        train(config, quiet=True)


def test_shares_are_all_of_it_and_apart():
    shares = [list(Processes(rank, 3).share(11)) for rank in range(3)]
    assert sorted(chain.from_iterable(shares)) == list(range(11))
    assert [len(share) for share in shares] == [4, 4, 3]


def test_a_machines_workers_are_shared_among_its_processes():
    assert Processes(0, 4, 2).workers(5) == 3  # each has enough
    assert Processes().workers(5) == 5
    assert Processes(0, 4, 2).workers(0) == 0


def test_one_process_is_alone_and_starts_none(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with started(1, None), joined("cpu") as processes:
        assert processes == Processes(0, 1)
        assert not torch.distributed.is_initialized()


def test_several_processes_have_a_device_each(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("LOCAL_RANK", "0")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    expected = r"device: expected cuda:0 or cuda, as each process has a GPU of .* got 'cuda:1'"
    with pytest.raises(ValueError, match=expected), joined("cuda:1"):
        pass


def test_processes_of_torchrun_start_no_others(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    with started(2, None):
        assert multiprocessing.active_children() == []
    assert [count_processes(asked) for asked in (1, 2)] == [2, 2]
    with pytest.raises(ValueError, match=r"processes: expected 1 or 2 under torchrun, .* got 3"):
        count_processes(3)


def test_a_run_does_not_go_on_with_another_number_of_processes_of_torchrun(
    image_set, tmp_path, monkeypatch
):
    config = config_of(image_set, tmp_path / "run")
    folder = RunFolder(config.out)
    folder.begin(replace(config, processes=2))
    folder.save_state(TrainState())
    monkeypatch.setenv("WORLD_SIZE", "3")
    with pytest.raises(ValueError, match="processes: expected 2, got 3"):
        train(config, quiet=True, resume=True)


TOGETHER = """
import functools, os, sys, time, torch
from datetime import timedelta
from ffpose.training import processes

impatient = functools.partial(torch.distributed.init_process_group, timeout=timedelta(seconds=10))
processes.distributed.init_process_group = impatient

def work(leads):
    with processes.joined("cpu") as own:
        with own.leader_first():
            time.sleep(14 * leads)
        assert own.total(torch.ones(1)) == 2

def die(leads):
    if not leads:
        os._exit(9)
    work(leads)

if __name__ == "__main__":
    together = {"work": work, "die": die}[sys.argv[1]]
    with processes.started(2, together, False):
        together(True)
"""


def run_together(tmp_path, what):
    (tmp_path / "together.py").write_text(TOGETHER)
    command = [sys.executable, tmp_path / "together.py", what]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


@pytest.mark.slow
def test_processes_wait_for_the_leader_for_longer_than_for_gradients(tmp_path):
    done = run_together(tmp_path, "work")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_where_a_process_ends_before_it_joins_the_leader_ends(tmp_path):
    done = run_together(tmp_path, "die")
    assert done.returncode == 1
    assert "process 1 of 1 beside this one ended with code 9 before the" in done.stderr


LEADER = """
import os, sys, time
from pathlib import Path
from ffpose.training.processes import joined, started

def follow(path):
    Path(path).write_text(f"{os.getpid()}\\n")
    time.sleep(600)

if __name__ == "__main__":
    with started(2, follow, sys.argv[1]), joined("cpu"):  # the other never does
        raise AssertionError
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM ends a process at once")
def test_where_the_leader_is_terminated_the_others_end(tmp_path):
    (tmp_path / "leader.py").write_text(LEADER)
    told = tmp_path / "follower"
    with subprocess.Popen([sys.executable, tmp_path / "leader.py", told]) as leader:
        until = time.monotonic() + 120
        while not (told.exists() and told.read_text().endswith("\n")):
            assert time.monotonic() < until
            time.sleep(0.1)
        leader.terminate()
        assert leader.wait(60) == 128 + signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(int(told.read_text()), 0)


INTERRUPTED = """
import signal, sys
from pathlib import Path
from ffpose.training.processes import started

def follow(path):
    Path(path).touch()

if __name__ == "__main__":
    with started(2, follow, sys.argv[1]):
        pass
else:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="holds no signal back")
def test_an_interrupt_is_left_to_the_leader_while_the_others_import(tmp_path):
    (tmp_path / "leader.py").write_text(INTERRUPTED)
    command = [sys.executable, tmp_path / "leader.py", tmp_path / "followed"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "followed").exists()


WORKER = """
import os, signal, sys, time
from pathlib import Path
from ffpose.training import engine
from ffpose.training.options import load_config

take_step, steps = engine._step, 0

def until_killed(run, rate):
    global steps
    steps += 1
    if steps == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    take_step(run, rate)

if os.environ["TORCHELASTIC_RESTART_COUNT"] == "1":
    time.sleep(float(os.environ["RANK"]))  # rank 0 is early, and looks for rank 1
elif os.environ["RANK"] == "1":
    Path(sys.argv[2]).touch()
    engine._step = until_killed
engine.train(load_config(Path(sys.argv[1])), resume=True, quiet=True)
"""


@pytest.mark.slow
def test_a_killed_rank_is_restarted_and_the_run_finishes(image_set, tmp_path, together):
    """Three steps an epoch: the second of two ranks is killed in the second epoch."""
    config = config_of(image_set, tmp_path / "killed", batch_size=2)
    (tmp_path / "config.yaml").write_text(dump_config(config))
    (tmp_path / "worker.py").write_text(WORKER)
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    words = [str(tmp_path / name) for name in ("worker.py", "config.yaml", "begun")]
    done = subprocess.run(
        [sys.executable, *launch, "--max-restarts=1", *words],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "begun").exists()
    rows = read_results(tmp_path / "killed/results.csv")
    assert [row["epoch"] for row in rows] == [1, 2, 3, 4, 5, 6, 7]
    for row, expected in zip(rows, together.history, strict=True):
        assert row["train_loss"] == pytest.approx(expected["train_loss"], rel=1e-5)
    assert "exitcode: -9" in done.stderr
