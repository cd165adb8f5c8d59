"""The configurations in configs/ are read as they stand, each by the network that it names."""

from dataclasses import replace
from pathlib import Path

import pytest

from ffpose.config import check_names
from ffpose.models import CONFIGS
from ffpose.training.config_file import load_config

FILES = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


def test_there_are_some():
    assert FILES


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_configuration_is_read(path):
    config = load_config(path)
    check_names(config.model_fields)
    replace(CONFIGS[config.model], **config.model_fields)
    assert config.out == Path("runs") / path.stem
