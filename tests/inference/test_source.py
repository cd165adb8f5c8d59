"""What a user names, and the file that is opened for it."""

import shutil

import pytest

from ffpose._internal.zoo import FOLDER
from ffpose.inference import source as module
from ffpose.inference.source import Source, find_source


@pytest.fixture
def folder(tmp_path):
    """A function that makes a folder of empty files."""

    def make(*names):
        for name in names:
            (tmp_path / name).write_bytes(b"")
        return tmp_path

    return make


def test_a_file_is_of_the_kind_that_its_suffix_says(tmp_path):
    assert find_source(tmp_path / "a.onnx") == Source(tmp_path / "a.onnx", is_graph=True)
    assert find_source(str(tmp_path / "a.ONNX")).is_graph
    weights = find_source(tmp_path / "a.safetensors")
    assert weights == Source(tmp_path / "a.safetensors", is_graph=False)


@pytest.fixture
def without_torch(monkeypatch):
    """An installation whose torch is not there."""
    find_spec = module.find_spec
    absent = {"torch"}
    monkeypatch.setattr(module, "find_spec", lambda n: None if n in absent else find_spec(n))


def test_a_name_is_of_a_shipped_network():
    weights = Source(FOLDER / "soyuz.safetensors", is_graph=False)
    assert find_source("soyuz") == find_source("soyuz", "torch") == weights
    graph = Source(FOLDER / "soyuz.onnx", is_graph=True)
    assert find_source("soyuz", "onnxruntime") == graph
    with pytest.raises(FileNotFoundError, match=r"a file or a name \(.*soyuz.*\), got moon"):
        find_source("moon")


@pytest.mark.parametrize(
    ("names", "backend", "found"),
    [
        (["a.safetensors", "a.safetensors.sha256", "results.csv"], None, "a.safetensors"),
        (["a.onnx", "card.md"], None, "a.onnx"),
        (["a.onnx", "a.safetensors"], None, "a.safetensors"),
        (["a.onnx", "a.safetensors"], "torch", "a.safetensors"),
        (["a.onnx", "a.safetensors"], "onnxruntime", "a.onnx"),
        (["a.onnx", "a.safetensors"], "openvino", "a.onnx"),
        (["best.safetensors", "last.safetensors"], None, "best.safetensors"),
    ],
)
def test_a_folder_holds_one(folder, names, backend, found):
    root = folder(*names)
    source = find_source(root, backend)
    assert source == Source(root / found, is_graph=found.endswith("onnx"))


@pytest.mark.parametrize(
    ("names", "backend", "error", "message"),
    [
        (["results.csv"], None, FileNotFoundError, "expected a folder with weights"),
        (["a.onnx"], "torch", FileNotFoundError, "backend torch"),
        (["a.safetensors"], "openvino", FileNotFoundError, "backend openvino"),
        (["a.onnx", "b.onnx"], None, ValueError, r"one network, .* got a\.onnx, b\.onnx"),
        (["a.safetensors", "b.safetensors"], "torch", ValueError, r"got a\.safetensors, b"),
    ],
)
def test_a_folder_of_none_or_several_is_refused(folder, names, backend, error, message):
    with pytest.raises(error, match=message):
        find_source(folder(*names), backend)


@pytest.mark.usefixtures("without_torch")
def test_graphs_go_first_without_torch(folder):
    assert find_source("soyuz") == Source(FOLDER / "soyuz.onnx", is_graph=True)
    assert find_source(folder("a.onnx", "a.safetensors")).path.name == "a.onnx"


def test_a_folder_is_a_name_too_unless_it_holds_a_network(folder, monkeypatch):
    monkeypatch.chdir(folder())
    mine = folder() / "soyuz"
    mine.mkdir()
    assert find_source("soyuz").path == FOLDER / "soyuz.safetensors"
    shutil.copy(FOLDER / "soyuz.safetensors", mine)
    assert find_source("soyuz").path.resolve() == mine / "soyuz.safetensors"


@pytest.mark.parametrize(
    ("name", "backend", "message"),
    [
        ("a.onnx", "torch", r"backend: expected onnxruntime or openvino for the graph a\.onnx"),
        ("a.safetensors", "openvino", "backend: expected torch for the weights a.safe.*, got 'op"),
        ("soyuz", "tensorrt", r"backend: expected one of \('torch', .*, got 'tensorrt'"),
    ],
)
def test_a_backend_that_is_not_for_the_file_is_refused(name, backend, message):
    with pytest.raises(ValueError, match=message):
        find_source(name, backend)
