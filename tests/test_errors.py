"""Errors say where, and what to do."""

import pickle
from pathlib import Path

import pytest
import torch

from ffpose.errors import DataError, MissingExtraError, require, without_traceback


def test_a_data_error_begins_with_its_place():
    assert str(DataError("wrong", "gt.csv", 7)) == "gt.csv:7: wrong"
    assert str(DataError("wrong", Path("gt.csv"))) == "gt.csv: wrong"
    assert isinstance(DataError("wrong", "gt.csv"), ValueError)


def test_a_data_error_reaches_another_process():
    error = pickle.loads(pickle.dumps(DataError("wrong", "gt.csv", 7)))
    assert (error.message, error.file, error.line) == ("wrong", Path("gt.csv"), 7)


def test_require_gives_the_module():
    assert require("json.decoder", "pose").JSONDecoder


@pytest.mark.parametrize("module", ["embreeeex", "embreeeex.mesh"])
def test_a_missing_extra_names_the_command(module):
    with pytest.raises(MissingExtraError, match=r"embreeeex, .*pip install 'ffpose\[render\]'"):
        require(module, "render")


class Broken(torch.utils.data.Dataset):
    def __len__(self):
        return 1

    def __getitem__(self, index):
        raise DataError("truncated image", "0_rgb.png")


def test_a_data_error_comes_out_of_a_loaders_worker_as_itself():
    loader = torch.utils.data.DataLoader(Broken(), num_workers=1)
    with pytest.raises(DataError, match=r"0_rgb.png: truncated image") as raised:
        next(iter(loader))
    assert without_traceback(str(raised.value)) == "0_rgb.png: truncated image"
