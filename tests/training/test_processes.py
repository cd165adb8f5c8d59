"""Several processes that train together do what one does on the same batches."""

from dataclasses import replace
from itertools import chain

import pytest
import torch
from safetensors.torch import load_file

from ffpose import DataError
from ffpose.training import DataConfig, OptimizerConfig, Stage, train
from ffpose.training.config import TrainConfig
from ffpose.training.processes import Processes, joined, started
from tiny_runs import MODEL_FIELDS, train_config, write_set

FIELDS = {**MODEL_FIELDS, "dropout": 0.0}

# Batch norm counts in evaluation: its statistics would be those of each process's own half.
STAGES = (Stage("branches", 2, freeze=("backbone",)),)


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("processes") / "set")


def config_of(image_set, out, **fields):
    # With so large an epsilon Adam does not blow the rounding of zero gradients up to whole steps.
    optimizer = OptimizerConfig(learning_rate=0.02, eps=1.0)
    fields |= {"model_fields": FIELDS, "epochs": None, "stages": STAGES, "optimizer": optimizer}
    config = train_config(image_set, out, **fields)
    return replace(config, data=DataConfig("urso", image_set, augment=False))


@pytest.mark.parametrize("accumulate", [1, 2])
def test_two_processes_are_one_of_twice_the_batch(image_set, tmp_path, accumulate):
    """Their means over halves of a batch have the mean of the whole."""
    alone = train(config_of(image_set, tmp_path / "one", batch_size=4), quiet=True)
    batch_size = 2 // accumulate
    together = config_of(
        image_set, tmp_path / "two", batch_size=batch_size, processes=2, accumulate=accumulate
    )
    both = train(together, quiet=True)
    assert len(both.history) == 2
    for one, two in zip(alone.history, both.history, strict=True):
        for name in ("train_loss", "val_mean_translation_error_m", "val_median_rotation_error_deg"):
            assert two[name] == pytest.approx(one[name], rel=1e-5), name
    ours, theirs = load_file(both.folder.last), load_file(alone.folder.last)
    for name, tensor in ours.items():
        torch.testing.assert_close(tensor, theirs[name], rtol=1e-4, atol=1e-5, msg=name)


def test_what_one_process_cannot_do_ends_all(tmp_path):
    config: TrainConfig = config_of(tmp_path / "nothing", tmp_path / "run", processes=2)
    with pytest.raises((DataError, FileNotFoundError)):
        train(config, quiet=True)


def test_shares_are_all_of_it_and_apart():
    shares = [list(Processes(rank, 3).share(11)) for rank in range(3)]
    assert sorted(chain.from_iterable(shares)) == list(range(11))
    assert [len(share) for share in shares] == [4, 4, 3]


def test_one_process_is_alone_and_starts_none(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with started(1, None), joined("cpu") as processes:
        assert processes == Processes(0, 1)
        assert not torch.distributed.is_initialized()
