"""The benchmark of a network's deployment, on one that takes no time."""

import importlib.util
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks.__main__ import main
from benchmarks.model import contenders as serving
from benchmarks.model import deployment
from benchmarks.model import plan as deployment_plan
from benchmarks.model.contenders import (
    COMPILED,
    COMPILED_ALONE,
    CUSTOM,
    DFT,
    INT8,
    MATMUL,
    OPENVINO,
    PLAIN,
    TORCH,
    TORCH_ALONE,
    TORCH_BEFORE,
    TORCH_BFLOAT16,
    WITHOUT,
    GraphKind,
    with_torch_fft,
    write_graphs,
)
from benchmarks.model.networks import TorchFftFilter
from benchmarks.model.operators import shares
from benchmarks.model.pipeline import (
    STAGES,
    TOTAL,
    ColdStart,
    Pipeline,
    Start,
    measure_starts,
    write_image,
)
from benchmarks.model.plan import DeploymentPlan, make_plan
from benchmarks.model.subjects import GFNET, GlobalFilterNetwork, subject
from ffpose.config import CONFIGS, PRESETS
from ffpose.models import PolarPose, read_metadata
from ffpose.nn import GlobalFilter
from ffpose.onnx import library
from ffpose.onnx.library import ELF_NAME, NAMES, get_library_path

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
runtime = pytest.importorskip("onnxruntime")

FOLDER = Path(library.__file__).parent
HAS_LIBRARY = any((FOLDER / name).is_file() for name in (ELF_NAME, *NAMES.values()))
NAMES_HERE = [
    *(TORCH_ALONE, TORCH, TORCH_BEFORE),
    *([CUSTOM] if HAS_LIBRARY else []),
    *(MATMUL, WITHOUT),
    *([INT8] if HAS_LIBRARY else []),
    *([OPENVINO] if importlib.util.find_spec("openvino") else []),
]


@pytest.fixture(autouse=True)
def _speck(monkeypatch):
    """Networks so small that their images take a millisecond."""
    fields = {"dim": 8, "depth": 1, "heads": 2, "feed_forward": 8, "head_hidden": 8}
    fields |= {"backbone": "test_efficientnet", "image_size": (32, 64)}
    monkeypatch.setitem(CONFIGS, "speck", replace(CONFIGS["tiny"], **fields))
    monkeypatch.setitem(PRESETS, "speck", CONFIGS["speck"])
    small = GlobalFilterNetwork((64, 64), dim=4, depth=1, classes=3)
    monkeypatch.setattr("benchmarks.model.subjects.GlobalFilterNetwork", lambda: small)


@pytest.fixture(scope="module")
def recorded():
    """Graphs that were recorded, by network and options."""
    return {}


@pytest.fixture(autouse=True)
def _recorded_once(monkeypatch, recorded):
    """The weights are always the same, and recording them takes most of the time of the tests."""
    ir, record = pytest.importorskip("onnx_ir"), serving.record

    def once(model, args, *rest, **named):
        state = b"".join(tensor.numpy().tobytes() for tensor in model.state_dict().values())
        key = repr(model), state, repr((rest, named))
        if key not in recorded:
            recorded[key] = ir.to_proto(record(model, args, *rest, **named))
        return ir.from_proto(recorded[key])

    monkeypatch.setattr(serving, "record", once)


@pytest.mark.slow
def test_run_prints_tables_or_a_document_and_draws(tmp_path, monkeypatch, capsys):
    plan = DeploymentPlan(NAMES_HERE, (1, 2), (1,), 0.001, 1, ["a note"])
    monkeypatch.setattr(deployment, "make_plan", lambda *_: plan)
    cold = {TORCH: ColdStart(4.0, 8e8, 1), MATMUL: ColdStart(1.0, 2e8, 1)}
    monkeypatch.setattr(deployment, "measure_starts", lambda *_: cold)
    begun = torch.get_num_threads()
    words = ["--json", "--plot", str(tmp_path / "d.png")]
    assert main(["model", "speck", *words]) == 0
    assert torch.get_num_threads() == begun
    document = json.loads(capsys.readouterr().out)
    assert (document["network"], document["baseline"]) == ("speck", TORCH_ALONE)
    assert document["environment"]["onnxruntime"] == runtime.__version__
    assert [(each["batch"], each["threads"]) for each in document["results"]] == [(1, 1), (2, 1)]
    for each in document["results"]:
        assert list(each["latencies"]) == NAMES_HERE
        medians = {name: latency["p50"] for name, latency in each["latencies"].items()}
        assert each["ratio"][MATMUL] == pytest.approx(medians[MATMUL] / medians[TORCH_ALONE])
        apart = each["largest_difference"]
        assert apart.pop(WITHOUT) is None
        assert apart.pop(INT8, 1.0) > 1e-4  # 8 bits
        assert max(apart.values()) < 1e-4
    assert set(document["operator_shares"]) == {CUSTOM, INT8} & set(NAMES_HERE)
    for found in document["operator_shares"].values():
        assert sum(found.values()) == pytest.approx(1)
        assert {"Conv", "FusedConv", "QLinearConv"} & set(found)
    (stages,) = document["image_file_to_pose"]
    for latencies in stages["latencies"].values():
        assert set(latencies) == {*STAGES, TOTAL}
        assert latencies[TOTAL]["p99"] >= max(latencies[stage]["p50"] for stage in STAGES)
    assert document["cold_starts"][MATMUL] == {"seconds": 1.0, "peak_bytes": 2e8, "runs": 1}
    assert main(["model", "speck"]) == 0
    printed = capsys.readouterr().out
    for text in ("batch 2, 1 thread", "image file to pose", "first pose", "0.25", "a note"):
        assert text in printed
    with Image.open(tmp_path / "d.png") as picture:
        assert picture.size[0] > 500


@pytest.mark.slow
def test_every_graph_computes_what_it_says(tmp_path):
    """The graph without filters is the network with filters that let everything pass."""
    measured = subject(GFNET, tmp_path)
    kinds = [
        kind for kind in get_args(GraphKind) if kind != "int8" and (HAS_LIBRARY or kind != "custom")
    ]
    graphs = write_graphs(measured.model, measured.images(2), tmp_path, kinds)
    operators = {
        kind: {node.op_type for node in onnx.load(graph.path).graph.node}
        for kind, graph in graphs.items()
    }
    assert {kind for kind in operators if "DFT" in operators[kind]} == {"dft"}
    assert {kind for kind in operators if "SpectralFilter" in operators[kind]} <= {"custom"}
    images = measured.images(3)
    open_gate = with_torch_fft(measured.model)
    for module in open_gate.modules():
        if isinstance(module, TorchFftFilter):
            module.weight.data.copy_(torch.tensor([1.0, 0.0]))
    for kind, graph in graphs.items():
        model = open_gate if kind == "without" else with_torch_fft(measured.model)
        options = runtime.SessionOptions()
        if graph.filter == "custom":
            options.register_custom_ops_library(get_library_path())
        session = runtime.InferenceSession(graph.path, options, providers=["CPUExecutionProvider"])
        (got,) = session.run(None, {session.get_inputs()[0].name: images.numpy()})
        with torch.no_grad():
            expected = model.double()(images.double())
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-5)


def test_operator_shares_by_hand(tmp_path):
    """The first run, up to 100 µs, counts for nothing."""
    node = {"cat": "Node", "dur": 30}
    events = [
        {"cat": "Session", "name": "model_run", "ts": 0, "dur": 100},
        {**node, "name": "a_kernel_time", "ts": 50, "args": {"op_name": "Conv"}},
        {**node, "name": "a_fence_before", "ts": 105, "args": {"op_name": "Conv"}},
        {**node, "name": "a_kernel_time", "ts": 110, "args": {"op_name": "Conv"}},
        {**node, "name": "b_kernel_time", "ts": 140, "args": {"op_name": "MatMul"}},
        {**node, "name": "c_kernel_time", "ts": 170, "args": {"op_name": "Conv"}},
        {"cat": "Session", "name": "model_run", "ts": 105, "dur": 100},
    ]
    (tmp_path / "profile.json").write_text(json.dumps(events))
    found = shares(tmp_path / "profile.json")
    assert list(found) == ["Conv", "MatMul"]
    assert found["Conv"] == pytest.approx(2 / 3)


@pytest.mark.slow
def test_pipelines_and_a_new_process_give_one_pose(tmp_path):
    measured = subject("speck", tmp_path)
    graphs = write_graphs(
        measured.model,
        measured.images(2),
        tmp_path,
        ["matmul"],
        entries=measured.entries,
        output_names=measured.outputs,
    )
    write_image(tmp_path / "a.png")
    image = Image.open(tmp_path / "a.png")
    cold = measure_starts(
        {"ours": Start("onnxruntime", graphs["matmul"].path)}, tmp_path / "a.png", 1, 2
    )["ours"]
    assert cold.runs == 2
    assert 1e7 < cold.peak_bytes < 1e9
    found = []
    for pipeline in (
        Pipeline.of(measured.weights),
        Pipeline.of(graphs["matmul"].path, 1),
    ):
        found.append(pipeline.run(pipeline.preprocess(image)[None]))
        assert len(pipeline.times(tmp_path / "a.png")) == len(STAGES)
    assert list(found[0]) == list(found[1])
    for name, values in found[0].items():
        np.testing.assert_allclose(values, found[1][name], rtol=0, atol=1e-5)


def test_the_plan_of_a_pose_network_and_of_gfnet(tmp_path, monkeypatch):
    monkeypatch.setattr(deployment_plan, "cores", lambda: 4)
    monkeypatch.setattr(deployment_plan, "get_library_path", lambda: "somewhere")
    monkeypatch.setattr(deployment_plan.shutil, "which", lambda _: "g++")
    pose, gfnet = subject("speck", tmp_path), subject(GFNET, tmp_path)
    whole, quick = make_plan(pose, quick=False), make_plan(pose, quick=True)
    assert (whole.batches, whole.threads) == ((1, 8), (1, 2, 4))
    assert (quick.batches, quick.threads) == ((1,), (1,))
    assert whole.names[:3] == [TORCH_ALONE, TORCH, TORCH_BEFORE]
    assert {COMPILED, COMPILED_ALONE, CUSTOM, MATMUL, DFT, WITHOUT, INT8} <= set(whole.names)
    assert set(whole.names) - set(quick.names) == {COMPILED, COMPILED_ALONE, DFT}
    assert any(DFT in note for note in quick.notes)
    assert INT8 not in make_plan(gfnet, quick=True).names
    assert {TORCH_ALONE, TORCH_BFLOAT16, CUSTOM} <= set(make_plan(gfnet, quick=True).names)
    chosen = make_plan(pose, quick=False, batches=[3], threads=[2])
    assert (chosen.batches, chosen.threads) == ([3], [2])


def test_what_is_missing_is_a_note(tmp_path, monkeypatch):
    measured = subject("speck", tmp_path)
    monkeypatch.setattr(deployment_plan.shutil, "which", lambda _: None)
    monkeypatch.setattr("ffpose.onnx.library.ELF_NAME", "nowhere.so")
    monkeypatch.setattr("ffpose.onnx.library.NAMES", {})
    plan = make_plan(measured, quick=False)
    assert not {CUSTOM, COMPILED, COMPILED_ALONE} & set(plan.names)
    assert {MATMUL, WITHOUT} <= set(plan.names)
    assert any("nowhere.so" in note for note in plan.notes)
    monkeypatch.setattr(deployment_plan.importlib.util, "find_spec", lambda _: None)
    plan = make_plan(measured, quick=False)
    assert plan.names == [TORCH_ALONE, TORCH, TORCH_BEFORE]
    for name in ("ONNX Runtime", OPENVINO, COMPILED):
        assert any(note.startswith(f"{name} is not measured") for note in plan.notes)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_LIBRARY, reason="needs the custom operator")
def test_no_process_is_started_where_none_is_asked_for(monkeypatch):
    monkeypatch.setattr(deployment, "measure_starts", lambda *_: pytest.fail("started"))
    plan = DeploymentPlan([TORCH_ALONE, TORCH, CUSTOM], (1,), (1,), 0.001, 0, [])
    results = deployment.measure("speck", lambda _: plan)
    assert (results.starts, results.baseline) == ({}, TORCH_ALONE)


def test_a_network_without_filters_has_one_graph(tmp_path, monkeypatch):
    monkeypatch.setitem(CONFIGS, "speck", replace(CONFIGS["speck"], filter="none"))
    monkeypatch.setitem(PRESETS, "speck", CONFIGS["speck"])
    names = make_plan(subject("speck", tmp_path), quick=True).names
    assert (PLAIN in names, names[0]) == (True, TORCH)
    assert not {CUSTOM, MATMUL, WITHOUT} & set(names)


def test_a_contender_that_computes_something_else_is_refused(tmp_path, monkeypatch):
    measured = subject(GFNET, tmp_path)
    monkeypatch.setattr(GlobalFilter, "forward", lambda self, x: 2 * x)
    calls = serving.contenders(measured, {}, [TORCH_ALONE, TORCH], 1, 1)
    with pytest.raises(RuntimeError, match=r"outputs by torch differ from torch alone's by"):
        serving.differences(calls, TORCH_ALONE)


def test_a_process_that_fails_is_named(tmp_path):
    broken = {"ours": Start("onnxruntime", tmp_path / "nowhere.onnx")}
    with pytest.raises(RuntimeError, match=r"the process of ours failed: .*nowhere\.onnx"):
        measure_starts(broken, tmp_path / "a.png", 1, 1)


@pytest.mark.slow
def test_a_process_in_torch_gives_a_pose(tmp_path):
    measured = subject("speck", tmp_path)
    write_image(tmp_path / "a.png")
    both = {"torch": Start("torch", measured.weights)}
    (found,) = measure_starts(both, tmp_path / "a.png", 1, 1).values()
    assert found.peak_bytes > 2e8


def test_the_process_of_a_graph_imports_no_torch():
    modules = "sys, benchmarks.model.start, ffpose.inference, ffpose.inference.estimator"
    code = f"import {modules}; assert 'torch' not in sys.modules"
    assert os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-c", code]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["speck", "--threads", "0"], "threads: expected numbers of at least 1, got [0]"),
        (["speck", "--plot", "absent/a.png"], "expected an existing folder"),
        (["nowhere"], "weights: expected a file or a name"),
    ],
)
def test_what_cannot_be_measured_is_refused(words, message, capsys):
    assert main(["model", *words]) == 1
    assert message in capsys.readouterr().err


def test_a_network_is_measured_with_fewer_looks(tmp_path, monkeypatch):
    weights = tmp_path / "twice.safetensors"
    fields = {"image_size": (64, 64), "first_stride": 2, "object_size": (16, 96), "directions": 50}
    PolarPose.from_config("polar", **fields).save_pretrained(weights, data={"name": "own"})
    measured = subject(str(weights), tmp_path, looks=1, candidates=3)
    assert (measured.model.config.looks, measured.model.config.candidates) == (1, 3)
    changed = read_metadata(measured.weights)
    assert changed == replace(read_metadata(weights), config=measured.model.config)
    with pytest.raises(ValueError, match="gfnet: expected no fields"):
        subject(GFNET, tmp_path, looks=1)
