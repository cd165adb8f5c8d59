"""Killed at any moment and resumed, a training ends as one that nobody killed."""

import multiprocessing
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from ffpose.training import Stage
from ffpose.training.checkpoint import RunFolder
from ffpose.training.engine import train
from studies.table import read_results
from tiny_runs import train_config, write_set

KILLS = 10
STAGES = (Stage("joint", 5), Stage("translation", 15, ("backbone", "orientation_branch")))


def resume(config):
    torch.set_num_threads(1)
    train(config, resume=True, quiet=True)


def start(config):
    """Resume in a process of its own, which has torch already: kills shall meet the training."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["ffpose.training.engine", "tiny_runs", "test_kills"])
    process = context.Process(target=resume, args=(config,))
    process.start()
    return process


def losses(folder):
    return [row["train_loss"] for row in read_results(folder / "results.csv")]


def epochs_done(folder):
    """A table may be of an epoch whose checkpoint was not written: at most one more."""
    return len(losses(folder)) if (folder / "results.csv").exists() else 0


def kill_in_the_middle(process, folder, before, seconds):
    """Kill after some seconds, or once an epoch is done; return whether the time came first."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and epochs_done(folder) <= before:
        time.sleep(0.002)
    process.kill()
    process.join()
    return epochs_done(folder) <= before


@pytest.mark.slow
def test_ten_kills_change_nothing(tmp_path):
    image_set = write_set(tmp_path / "set")
    whole = train_config(image_set, tmp_path / "whole", epochs=None, stages=STAGES, ema=0.9)
    begun = time.monotonic()
    process = start(whole)
    process.join()
    assert process.exitcode == 0
    longest = 0.2 * (time.monotonic() - begun)

    config = replace(whole, out=tmp_path / "killed")
    generator = np.random.default_rng(0)
    before = 0
    for _ in range(KILLS):
        process = start(config)
        by_time = kill_in_the_middle(process, config.out, before, generator.uniform(0, longest))
        assert process.exitcode == -signal.SIGKILL, "the training ended before the last kill"
        longest *= 1.5 if by_time else 0.8  # about an epoch between two kills
        before = epochs_done(config.out)
    assert before > 2
    process = start(config)
    process.join()
    assert process.exitcode == 0
    assert losses(config.out) == losses(whole.out)
    for name in ("last", "best"):
        ours, theirs = (load_file(getattr(RunFolder(each.out), name)) for each in (config, whole))
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(ours[key], theirs[key]) for key in ours)
