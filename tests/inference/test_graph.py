"""Poses by an exported graph: those of torch, from every kind of image, without torch."""

import json
import pickle
import subprocess
import sys
from dataclasses import astuple, replace

import numpy as np
import pytest
import torch
from PIL import Image

from ffpose._internal.files import sha256
from ffpose._internal.seeds import CHOICES
from ffpose.cli import main
from ffpose.errors import DataError
from ffpose.evaluation.evaluate import evaluate
from ffpose.geometry import Camera
from ffpose.imaging.images import read_rgb
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.models import FilterformerPose, build_network, read_metadata
from ffpose.onnx import pose_graph
from ffpose.onnx.backends import openvino_takes_bfloat16
from ffpose.onnx.exporter import Exported
from ffpose.onnx.metadata import read_model_metadata, sealed
from ffpose.onnx.pose_graph import graph_entries
from ffpose.render import render
from tiny_runs import write_set

pytest.importorskip("onnxscript")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

VIEW = Camera(64, 64, 50.0, 60.0, 30.0, 33.0)
"""Camera of the network's input: 128x96 pixels of the images, squeezed."""

SMALL = {
    "image_size": (64, 64),
    "camera": astuple(VIEW)[2:],
    "dim": 16,
    "depth": 1,
    "heads": 2,
    "feed_forward": 16,
    "head_hidden": 16,
    "translation_mlp_dim": 4,
    "orientation_mlp_dim": 4,
}
NARROW = {"backbone": "compact_resnet_narrow", "translation_reduction": 16}
"""A backbone of few nodes, as the time of an export is that of the nodes."""

NETWORKS = {
    "tokens": ("tiny", {**SMALL, **NARROW, "filter": "tokens", "orientation_head": "quaternion"}),
    "grid": ("tiny", {**SMALL, **NARROW, "filter": "grid", "pooling": "mean"}),
    "polar": (
        "polar",
        {
            "image_size": SMALL["image_size"],
            "camera": SMALL["camera"],
            "first_stride": 2,
            "object_size": (16, 96),
            "object_width": 32,
            "channels": (4, 8, 12),
            "blocks": (1, 1),
            "directions": 50,
            "looks": 1,
            "candidates": 1,
            "doubt_sigma": (3.0, 2.0),
            "truncation_sigma": (2.0, 1.0),
            "degrees_of_freedom": (5.0, 3.5),
        },
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("graphs")


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("grid", "polar")]


@pytest.fixture(scope="module", params=["tokens", *SLOW])
def files(request, folder):
    """Weights, and the graph of standard operators that was made of them."""
    torch.manual_seed(0)
    weights = folder / f"{request.param}.safetensors"
    graph = weights.with_suffix(".onnx")
    if not graph.is_file():
        preset, fields = NETWORKS[request.param]
        model = build_network(preset, backbone_weights="none", **fields)
        model.save_pretrained(
            weights,
            preprocessing=Preprocessing((64, 64)),
            data={"image_size": [96, 128]},
            in_view_threshold=0.5,
        )
        arguments = [str(weights), "--out", str(graph), "--filter", "matmul"]
        arguments += ["--track"] if preset == "polar" else []
        assert main(["export", *arguments]) == 0
    return weights, graph


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "view.png"
    pixels = np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def assert_same_pose(pose, expected):
    np.testing.assert_allclose(pose.t, expected.t, rtol=0, atol=1e-4)
    assert abs(pose.q @ expected.q) == pytest.approx(1, abs=1e-6)
    assert (pose.uncertainty is None) == (expected.uncertainty is None)
    if expected.uncertainty is not None:
        for name in ("translation_covariance", "rotation_covariance", "in_view", "probabilities"):
            got, wanted = (getattr(p.uncertainty, name) for p in (pose, expected))
            np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4)
        got, wanted = (p.uncertainty.alternative for p in (pose, expected))
        assert abs(got @ wanted) == pytest.approx(1, abs=1e-6)
        assert pose.uncertainty.degrees_of_freedom == expected.uncertainty.degrees_of_freedom


def test_the_pose_is_that_of_torch(files, picture):
    weights, graph = files
    expected = load(weights)(read_rgb(picture))
    assert_same_pose(load(graph, threads=1)(picture), expected)
    if expected.uncertainty is not None:
        assert expected.uncertainty.degrees_of_freedom == (5.0, 3.5)


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
def test_a_located_camera_is_taken_to_the_origin(files, tmp_path, picture):
    """A graph of the same network says so in its metadata alone."""
    weights, graph = tmp_path / "scene.safetensors", tmp_path / "scene.onnx"
    network = FilterformerPose.from_pretrained(files[0])
    network.save_pretrained(
        weights, preprocessing=Preprocessing((64, 64)), data={"locates": "camera"}
    )
    model = onnx.load(files[1])
    entries = graph_entries(weights, read_metadata(weights))("matmul")
    onnx.helper.set_model_props(model, entries)
    graph.write_bytes(sealed(model.SerializeToString()))
    image = read_rgb(picture)
    with torch.inference_mode():
        center = network.eval()(Preprocessing((64, 64))(image)[None]).translation[0]
    estimates = (
        load(weights, resize=True),
        load(graph, resize=True),
    )
    for estimate in estimates:
        np.testing.assert_allclose(estimate(image).transform(center), np.zeros(3), atol=1e-4)


def test_the_graph_knows_what_it_is_of(files):
    weights, graph = files
    source, metadata = read_metadata(weights), read_model_metadata(graph)
    assert (metadata.config, metadata.preprocessing) == (source.config, source.preprocessing)
    assert (metadata.camera, metadata.in_view_threshold) == (source.camera, 0.5)
    digest = weights.with_suffix(".safetensors.sha256").read_text().split()[0]
    assert metadata.weights_sha256 == digest
    model = onnx.load(graph)
    onnx.checker.check_model(model)
    assert {opset.domain for opset in model.opset_import} == {""}
    assert model.graph.input[0].type.tensor_type.shape.dim[0].dim_param  # any batch


@pytest.mark.parametrize("files", [SLOW[1]], indirect=True)
def test_the_graph_beside_gives_the_looks_of_torch(files):
    weights, graph = files
    beside = graph.with_suffix(".track.onnx")
    assert read_model_metadata(beside).takes_point
    assert read_model_metadata(beside).filter == "matmul"
    assert not read_model_metadata(graph).takes_point
    assert read_model_metadata(graph).track_sha256 == sha256(beside)
    network, ours = (load(each, track=True, warm_up=1) for each in (weights, graph))
    patches = np.random.default_rng(0).integers(0, 256, (3, 12, 16, 3), dtype=np.uint8)
    images = [Image.fromarray(p).resize((128, 96), Image.Resampling.BICUBIC) for p in patches]
    x = np.stack([network.preprocess(image) for image in images])
    points = np.array([[1.0, -0.5, 14.0], [0.0, 0.0, 9.0], [-3.0, 2.0, 30.0]])
    got, wanted = ours.run(x, points), network.run(x, points)
    np.testing.assert_allclose(got["translation"], wanted["translation"], atol=1e-4)
    signs = np.sign((got["orientation"] * wanted["orientation"]).sum(1, keepdims=True))
    np.testing.assert_allclose(signs * got["orientation"], wanted["orientation"], atol=1e-5)
    with pytest.raises(DataError, match="expected a graph of whole frames, got one of single"):
        load(beside)


def test_every_kind_of_image_gives_one_pose(files, picture):
    estimator = load(files[1])
    expected = estimator(picture)
    image = read_rgb(picture)
    array = np.asarray(image)
    assert estimator(str(picture)) == estimator(image) == estimator(array) == expected
    flipped = np.ascontiguousarray(array[:, ::-1])
    for poses in (estimator([picture, flipped]), estimator((array, Image.fromarray(flipped)))):
        assert_same_pose(poses[0], expected)
        assert_same_pose(poses[1], estimator(flipped))
    assert estimator([]) == []


def test_the_input_is_that_of_training(files, picture):
    weights, graph = files
    expected = load(weights).preprocess(picture)
    got = load(graph).preprocess(picture)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-5)


def test_the_camera_is_checked_and_turned_as_with_torch(files, picture):
    weights, graph = files
    wide = Image.open(picture).resize((128, 64))
    with pytest.raises(ValueError, match=r"aspect ratio .* 128x64 pixels"):
        load(graph)(wide)
    camera = Camera(128, 64, 90.0, 95.0, 60.0, 31.0)
    for options in ({"camera": camera}, {"resize": True}):
        expected = load(weights, **options)(wide)
        assert_same_pose(load(graph, **options)(wide), expected)
    with pytest.raises(ValueError, match=r"camera: expected one .*, or resize; got both"):
        load(graph, camera=camera, resize=True)


def test_a_graph_is_evaluated_as_its_weights_are(files, tmp_path):
    images = write_set(tmp_path / "set")
    of_weights, of_graph = (evaluate(path, "urso", images, reproject=True) for path in files)
    np.testing.assert_allclose(of_graph.predicted[:, :3], of_weights.predicted[:, :3], atol=1e-4)
    np.testing.assert_allclose(of_graph.baseline, of_weights.baseline)
    cosines = (of_graph.predicted[:, 3:] * of_weights.predicted[:, 3:]).sum(axis=1)
    np.testing.assert_allclose(abs(cosines), 1, atol=1e-6)
    assert (of_graph.in_view is None) == (of_weights.in_view is None)
    if of_weights.in_view is not None:
        np.testing.assert_allclose(of_graph.in_view, of_weights.in_view, atol=1e-4)
        np.testing.assert_allclose(
            of_graph.translation_covariance, of_weights.translation_covariance, rtol=1e-3
        )
    with pytest.raises(ValueError, match="device: expected auto or cpu for an exported graph"):
        evaluate(files[1], "urso", images, device="cuda")


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (np.zeros((96, 128, 3)), TypeError, "array of uint8, got float64"),
        (np.full((96, 128, 3), np.nan, np.float32), TypeError, "array of uint8, got float32"),
        (np.zeros((96, 128), np.uint8), ValueError, r"\(H, W, 3\), got shape \(96, 128\)"),
        (np.zeros((96, 128, 4), np.uint8), ValueError, r"got shape \(96, 128, 4\)"),
        (np.zeros((0, 128, 3), np.uint8), ValueError, r"got shape \(0, 128, 3\)"),
        (np.zeros((96, 96, 3), np.uint8), ValueError, "aspect ratio .* 96x96"),
        (Image.new("L", (128, 96)), ValueError, "mode RGB, got L"),
        (7, TypeError, "a path, a Pillow image or an array, got int"),
        ("nowhere.png", FileNotFoundError, "nowhere.png"),
    ],
)
def test_what_is_no_image_is_refused(files, image, error, message):
    with pytest.raises(error, match=message):
        load(files[1])(image)


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
def test_what_is_no_input_is_refused(files):
    estimator = load(files[1])
    good = np.zeros((1, 3, 64, 64), np.float32)
    for inputs, error, message in (
        (good.astype(np.float64), TypeError, "expected float32, got float64"),
        (good[:, :, 1:], ValueError, r"\(B, 3, 64, 64\), got \(1, 3, 63, 64\)"),
        (good[0], ValueError, r"got \(3, 64, 64\)"),
        (good + np.float32("nan"), ValueError, "got NaN or infinity"),
    ):
        with pytest.raises(error, match=message):
            estimator.run(inputs)


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backend": "tensorrt"}, r"backend: expected one of .*, got 'tensorrt'"),
        ({"precision": "int4"}, r"precision: expected one of .*, got 'int4'"),
        ({"threads": 0}, "threads: expected at least 1, got 0"),
        ({"providers": ["MadeUp"]}, r"providers: expected some of .*, got \['MadeUp'\]"),
        (
            {"backend": "openvino", "providers": ["CPUExecutionProvider"]},
            "providers: expected with",
        ),
    ],
)
def test_unknown_choices_are_refused(files, options, message):
    with pytest.raises(ValueError, match=message):
        load(files[1], **options)


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
def test_a_missing_library_is_named(files, folder, monkeypatch):
    _, graph = files
    metadata = replace(read_model_metadata(graph), filter="custom")
    model = onnx.load(graph)
    onnx.helper.set_model_props(model, metadata.to_entries())
    path = folder / "custom.onnx"
    path.write_bytes(sealed(model.SerializeToString()))
    monkeypatch.setattr("ffpose.onnx.library.ELF_NAME", "nowhere.so")
    monkeypatch.setattr("ffpose.onnx.library.NAMES", {})
    with pytest.raises(FileNotFoundError, match=r"nowhere\.so.*--filter matmul"):
        load(path)
    wrong = folder / "wrong.so"
    wrong.write_bytes(b"no library")
    monkeypatch.setattr("ffpose.onnx.backends.get_library_path", lambda: str(wrong))
    with pytest.raises(RuntimeError, match=r"cannot load the custom operator.*wrong\.so"):
        load(path)
    with pytest.raises(ValueError, match="OpenVINO expected a graph of standard operators"):
        load(path, backend="openvino")


def test_predict_takes_graph_and_weights_alike(files, picture, tmp_path, capsys):
    documents = []
    for network in files:
        arguments = [str(network), str(picture), "--json", "--overlay", str(tmp_path / "drawn")]
        assert main(["predict", *arguments]) == 0
        documents.append(json.loads(capsys.readouterr().out))
        assert (tmp_path / "drawn" / "view_pose.png").is_file()
    by_torch, by_graph = documents
    assert by_graph.keys() == by_torch.keys()
    np.testing.assert_allclose(by_graph["translation_m"], by_torch["translation_m"], atol=1e-4)


WITHOUT_TORCH = """
import sys

for name in ("torch", "torchvision", "timm", "safetensors"):
    sys.modules[name] = None  # its import is an error

import ffpose

graph, picture, backend = sys.argv[1:]
print(*ffpose.load(graph, backend=backend)(picture).vector)
from ffpose.cli import main

assert main(["predict", graph, picture]) == 0
"""


def test_no_torch_is_needed(files, picture):
    weights, graph = files
    command = [sys.executable, "-c", WITHOUT_TORCH, str(graph), str(picture), "onnxruntime"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    expected = load(weights)(read_rgb(picture))
    np.testing.assert_allclose([*map(float, first.split())][:3], expected.t, rtol=0, atol=1e-4)
    assert second.startswith(str(picture))


def test_openvino_gives_the_same_pose(files, picture):
    pytest.importorskip("openvino")
    weights, graph = files
    expected = load(weights)(read_rgb(picture))
    estimator = load(graph, backend="openvino", threads=1)
    assert_same_pose(estimator(picture), expected)
    assert_same_pose(pickle.loads(pickle.dumps(estimator))(picture), expected)
    for pose in estimator([picture, picture, picture]):
        assert_same_pose(pose, expected)


SIGNALS = """
import signal, subprocess, sys
import ffpose

heard = []
signal.signal(signal.SIGCHLD, lambda *_: heard.append(True))
first = ffpose.load(sys.argv[1], backend="openvino")
second = ffpose.load(sys.argv[1], backend="openvino")
del first
del second
subprocess.run([sys.executable, "-c", ""], check=True)
assert heard
"""


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
@pytest.mark.skipif(sys.platform != "linux", reason="of OpenVINO's code for Linux")
def test_signals_are_heard_after_estimators_in_openvino_have_gone(files):
    pytest.importorskip("openvino")
    _, graph = files
    command = [sys.executable, "-X", "faulthandler", "-c", SIGNALS, str(graph)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_bfloat16_where_the_cpu_has_it(files, picture):
    pytest.importorskip("openvino")
    weights, graph = files
    if not openvino_takes_bfloat16():
        with pytest.raises(ValueError, match="this CPU has no bfloat16"):
            load(graph, backend="openvino", precision="bfloat16")
        return
    pose = load(graph, backend="openvino", precision="bfloat16")(picture)
    expected = load(weights)(read_rgb(picture))
    np.testing.assert_allclose(pose.t, expected.t, rtol=0.05, atol=0.05)


@pytest.mark.slow
def test_shipped_weights_export_whole(tmp_path):
    """On its spacecraft: of a picture of nothing the pose is any, and round-off moves it.

    All shipped networks are one in other numbers (`test_shipped_graphs` has the graphs of all).
    """
    name = "soyuz"
    graph = tmp_path / "shipped.onnx"
    assert main(["export", name, "--out", str(graph)]) == 0
    assert read_model_metadata(graph).in_view_threshold == read_metadata(name).in_view_threshold
    image = Image.fromarray(render(f"{name}_hard", CHOICES.start, 0, size=(640, 480)).image)
    assert_same_pose(load(graph)(image), load(name)(image))


@pytest.mark.slow
def test_the_paper_s_network_exports(tmp_path):
    torch.manual_seed(0)
    weights, graph = tmp_path / "new.safetensors", tmp_path / "new.onnx"
    model = FilterformerPose.from_config("base", backbone_weights="none", depth=1)
    model.save_pretrained(weights)
    assert main(["export", str(weights), "--out", str(graph), "--filter", "matmul"]) == 0
    assert read_model_metadata(graph).filter == "matmul"


FEWER = ("--candidates", "1", "--looks", "1")


@pytest.mark.parametrize("files", ["tokens"], indirect=True)
def test_a_network_that_looks_once_has_no_fewer_looks(files, tmp_path):
    words = ["export", str(files[0]), "--out", str(tmp_path / "quick.onnx"), *FEWER]
    assert main(words) == 1


def test_an_export_that_fails_leaves_the_pair_that_is_there(tmp_path, monkeypatch, capsys):
    """The single look is written beside the graph that names it, or neither."""
    paths = [tmp_path / name for name in ("m.onnx", "m.track.onnx")]
    for path in paths:
        path.write_bytes(b"before")

    def export(weights, path, filter, *, takes_point=False, **_):
        if not takes_point:
            raise RuntimeError("graph and module differ")
        path.write_bytes(b"after")
        return Exported(path, "none", 0)

    monkeypatch.setattr(pose_graph, "export_weights", export)
    assert main(["export", "soyuz", "--track", "--out", str(paths[0])]) == 1
    assert "graph and module differ" in capsys.readouterr().err
    assert [path.read_bytes() for path in paths] == [b"before", b"before"]


def test_a_graph_is_exported_with_fewer_looks(tmp_path, monkeypatch):
    """Network and metadata have one second look; poses of such a graph are compared by `files`."""
    torch.manual_seed(0)
    weights, graph = tmp_path / "twice.safetensors", tmp_path / "quick.onnx"
    fields = NETWORKS["polar"][1] | {"looks": 2, "candidates": 2}
    build_network("polar", backbone_weights="none", **fields).save_pretrained(weights)
    configs = []

    def without_nodes(module, batches, path, filter, entries, *_, **__):
        configs.append(module.config)
        model = onnx.helper.make_model(onnx.helper.make_graph([], "none", [], []))
        onnx.helper.set_model_props(model, entries("none"))
        path.write_bytes(sealed(model.SerializeToString()))
        return Exported(path, "none", 0)

    monkeypatch.setattr(pose_graph, "write_graph", without_nodes)
    assert main(["export", str(weights), "--out", str(graph), *FEWER]) == 0
    quick = replace(read_metadata(weights).config, looks=1, candidates=1)
    assert configs == [quick]
    assert read_model_metadata(graph).config == quick
