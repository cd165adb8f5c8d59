"""Weights by name: a file goes first, an unknown name meets the list of names."""

import re
from pathlib import Path

import pytest

from ffpose import DataError
from ffpose._internal import zoo
from ffpose.models import FilterformerPose, load_network, read_metadata


@pytest.fixture
def shelf(tmp_path, monkeypatch):
    """A folder of shipped weights, empty, in place of the package's."""
    folder = tmp_path / "shelf"
    folder.mkdir()
    monkeypatch.setattr(zoo, "FOLDER", folder)
    return folder


def test_the_shelf_lies_in_the_package():
    assert zoo.FOLDER.parent == Path(zoo.__file__).parents[1]


def test_every_shipped_weight_has_its_checksum_and_can_be_read():
    for name in zoo.names():
        assert (zoo.FOLDER / f"{name}.safetensors.sha256").is_file()
        load_network(name)


def test_names_are_those_of_the_files(shelf):
    assert zoo.names() == []
    for file in ("b-hard.safetensors", "a-easy.safetensors", "a-easy.safetensors.sha256", "notes"):
        (shelf / file).touch()
    assert zoo.names() == ["a-easy", "b-hard"]


def test_an_installation_without_weights(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path / "none")
    assert zoo.names() == []
    with pytest.raises(FileNotFoundError, match=r"none is installed by name\), got soyuz"):
        zoo.resolve("soyuz")


def test_a_network_is_found_by_its_name(shelf):
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields)
    model.save_pretrained(shelf / "soyuz.safetensors")
    assert FilterformerPose.from_pretrained("soyuz").config == model.config
    assert read_metadata(Path("soyuz")).config == model.config


def test_an_unknown_name_meets_the_list(shelf):
    for name in ("dragon", "soyuz"):
        (shelf / f"{name}.safetensors").touch()
    expected = re.escape("a name (one of dragon, soyuz), got soyouz")
    for function in (zoo.resolve, read_metadata, FilterformerPose.from_pretrained):
        with pytest.raises(FileNotFoundError, match=expected):
            function("soyouz")


def test_a_file_goes_before_a_name(shelf, tmp_path, monkeypatch):
    (shelf / "mine.safetensors").touch()
    monkeypatch.chdir(tmp_path)
    assert zoo.resolve("mine") == shelf / "mine.safetensors"
    (tmp_path / "mine").write_text("my own")
    assert zoo.resolve("mine") == Path("mine")
    with pytest.raises(DataError, match="mine: expected a safetensors file"):
        read_metadata("mine")


@pytest.mark.parametrize("path", ["runs/best", "best.safetensors", "/best"])
def test_what_is_no_name_is_a_path(shelf, path):
    assert zoo.resolve(path) == Path(path)


def test_initial_weights_have_names_where_a_training_starts(shelf):
    assert zoo.resolve_initial("generic") == zoo.INITIAL / "generic.safetensors"
    with pytest.raises(FileNotFoundError, match=r"got generic, which poses no spacecraft"):
        zoo.resolve("generic")
    (shelf / "soyuz.safetensors").touch()
    assert zoo.resolve_initial("soyuz") == zoo.resolve("soyuz")
    with pytest.raises(FileNotFoundError, match=r"^init: .*\(one of generic, soyuz\), got soyouz$"):
        zoo.resolve_initial("soyouz")
