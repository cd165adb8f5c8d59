"""``ffpose bench model``, on a network that takes no time."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ffpose.bench import model as bench
from ffpose.cli import main
from ffpose.config import CONFIGS, PRESETS
from ffpose.models import read_metadata

pytest.importorskip("onnxscript")


@pytest.fixture(autouse=True)
def _speck(monkeypatch):
    fields = {"dim": 8, "depth": 1, "heads": 2, "feed_forward": 8, "head_hidden": 8}
    fields |= {"backbone": "test_efficientnet", "image_size": (32, 64)}
    monkeypatch.setitem(CONFIGS, "speck", replace(CONFIGS["tiny"], **fields))
    monkeypatch.setitem(PRESETS, "speck", CONFIGS["speck"])


@pytest.fixture(scope="module")
def graphs(tmp_path_factory):
    """A folder and the graphs of the speck in it, exported by the first test that needs each."""
    return tmp_path_factory.mktemp("speck"), {}


@pytest.fixture
def at_once(monkeypatch, graphs):
    """Few calls, and one export of a kind for all."""
    measures, export, (folder, made) = bench.take_turns, bench.export_weights, graphs

    def copied(weights, out, filter="custom", **fields):
        if filter not in made:
            made[filter] = export(weights, folder / f"{filter}.onnx", filter, **fields)
        return replace(made[filter], path=Path(shutil.copy(made[filter].path, out)))

    monkeypatch.setattr(bench, "take_turns", lambda calls, _: measures(calls, 0.001))
    monkeypatch.setattr(bench, "export_weights", copied)


@pytest.mark.slow
@pytest.mark.usefixtures("at_once")
def test_a_document_a_table_and_a_plot(tmp_path, capsys):
    begun = torch.get_num_threads()
    plot = tmp_path / "model.png"
    words = ["--batch", "1", "2", "--threads", "1", "--plot", str(plot)]
    assert main(["bench", "model", "speck", "--json", *words]) == 0
    assert torch.get_num_threads() == begun
    document = json.loads(capsys.readouterr().out)
    assert document["network"] == "speck"
    assert [(each["batch"], each["threads"]) for each in document["results"]] == [(1, 1), (2, 1)]
    for each in document["results"]:
        assert {"torch", "onnxruntime"} <= set(each["latencies"])
        assert each["differences"]["torch"] == 0.0
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main(["bench", "model", "speck", "--quick"]) == 0
    assert "onnxruntime" in capsys.readouterr().out


@pytest.mark.usefixtures("at_once")
def test_another_graph_takes_turns(tmp_path, capsys):
    other = tmp_path / "other.onnx"
    bench.export_weights(bench.weights_of("speck", tmp_path), other)
    words = ["--quick", "--json", "--compare", str(other)]
    assert main(["bench", "model", "speck", *words]) == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert list(result["latencies"])[-1] == "other.onnx"
    assert "other.onnx" not in result["differences"]


@pytest.mark.usefixtures("at_once")
def test_graphs_of_one_name_are_told_apart(tmp_path, capsys):
    paths = [tmp_path / folder / "model.onnx" for folder in ("old", "new")]
    for path in paths:
        path.parent.mkdir()
        bench.export_weights(bench.weights_of("speck", tmp_path), path)
    words = ["--quick", "--json", "--compare", *map(str, paths)]
    assert main(["bench", "model", "speck", *words]) == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert list(result["latencies"])[-2:] == [*map(str, paths)]


@pytest.mark.usefixtures("at_once")
def test_a_backend_that_computes_other_poses_is_refused(monkeypatch, capsys):
    monkeypatch.setattr(bench, "APART", -1.0)
    assert main(["bench", "model", "speck", "--quick"]) == 1
    assert "poses by torch differ from torch's by" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["speck", "--plot", "absent/a.png"], 1, "expected an existing folder"),
        (["nowhere"], 1, "weights: expected a file or a name"),
        (["speck", "--compare", "nowhere.onnx"], 1, "compare: expected an exported graph, got now"),
    ],
)
def test_what_cannot_be_measured_is_refused(words, code, message, capsys):
    assert main(["bench", "model", *words]) == code
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--threads", "--batch"])
def test_numbers_below_one_are_wrong_usage(option, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["bench", "model", "speck", option, "0"])
    assert option.strip("-") in capsys.readouterr().err


@pytest.mark.parametrize("network", ["small", "polar", "ursonet"])
def test_any_preset_has_random_weights(network, tmp_path):
    assert read_metadata(bench.weights_of(network, tmp_path)).config == PRESETS[network]
