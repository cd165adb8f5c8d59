"""The poses of the program without Python are those of Python's runtime."""

import re
from pathlib import Path

import pytest

from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.onnx.library import get_library_path
from networks import MODEL_FIELDS
from onboard_program import CRATE, assert_same, expected, picture, png

LOCATED = {"transformerpose": "object", "ursonet": "object", "posenet": "camera"}
"""What the poses of each network locate."""


def test_a_network_with_filters_gives_its_pose(run, folder, tmp_path):
    pytest.importorskip("onnxscript")
    torch = pytest.importorskip("torch")
    from ffpose.cli import main
    from ffpose.models import FilterformerPose

    torch.manual_seed(0)
    small = {"image_size": (64, 64), "dim": 16, "depth": 1, "heads": 2, "feed_forward": 16}
    small |= {"head_hidden": 16, "translation_mlp_dim": 4, "orientation_mlp_dim": 4}
    small |= {"backbone": "compact_resnet_narrow"}
    network = FilterformerPose.from_config("tiny", backbone_weights="none", **small)
    weights, graph = tmp_path / "small.safetensors", tmp_path / "small.onnx"
    network.save_pretrained(weights, preprocessing=Preprocessing((64, 64)))
    assert main(["export", str(weights), "--out", str(graph)]) == 0
    images = folder({"a.png": png(picture()), "b.png": png(picture(64, 48, "L"))})

    code, documents, errors = run(graph, "--images", images)
    assert (code, documents, len(errors)) == (1, [], 1)
    assert "expected --operators" in errors[0]
    code, documents, errors = run(graph, "--images", images, "--operators", get_library_path())
    assert (code, errors) == (0, [])
    estimator = load(graph, threads=1)
    for document in documents:
        assert "in_view" not in document
        assert_same(document, expected(estimator, Path(document["image"])), 1e-5)


@pytest.mark.parametrize(("name", "locates"), LOCATED.items())
def test_every_network_gives_its_pose(run, folder, tmp_path, name, locates):
    pytest.importorskip("onnxscript")
    pytest.importorskip("torch")
    from ffpose.cli import main
    from ffpose.models import build_network

    network = build_network(name, backbone_weights="none", **MODEL_FIELDS[name])
    weights, graph = tmp_path / "small.safetensors", tmp_path / "small.onnx"
    network.save_pretrained(
        weights, preprocessing=Preprocessing((64, 64)), data={"locates": locates}
    )
    assert main(["export", str(weights), "--out", str(graph)]) == 0
    code, (document,), errors = run(graph, "--images", folder({"a.png": png(picture())}))
    assert (code, errors) == (0, [])
    assert ("camera_center_m" in document) == (locates == "camera")
    assert_same(document, expected(load(graph), Path(document["image"])), 1e-5)


def test_no_network_is_left_out():
    assert LOCATED.keys() == MODEL_FIELDS.keys()


def test_it_needs_nothing_of_python_and_no_core():
    lock = (CRATE / "Cargo.lock").read_text()
    names = set(re.findall(r'^name = "(.*)"$', lock, re.MULTILINE))
    assert "ort" in names
    assert not names & {"ffpose-core", "ffpose-ort", "ffpose-py", "pyo3"}
