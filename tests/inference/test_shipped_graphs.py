"""The graphs in the package: those of the weights beside them, and enough without torch."""

import subprocess
import sys

import numpy as np
import pytest

import ffpose
from ffpose._internal.files import sha256
from ffpose._internal.zoo import GRAPH, WEIGHTS, names, resolve
from ffpose.onnx.metadata import read_model_metadata
from pages import ROOT

pytest.importorskip("onnxruntime")

UNSEEN = ROOT / "docs/images/soyuz_unseen.jpg"
MOST_BYTES = 3_000_000


@pytest.mark.parametrize("name", names())
def test_a_graph_is_of_the_weights_beside_it(name):
    graph = resolve(name, GRAPH)
    wanted = sha256(resolve(name, WEIGHTS))
    assert read_model_metadata(graph).weights_sha256 == wanted, "run `make graphs`"
    assert graph.stat().st_size <= MOST_BYTES


def test_a_graph_has_every_weights_name():
    assert [path.stem for path in sorted(resolve("soyuz", GRAPH).parent.glob("*.onnx"))] == names()


@pytest.mark.parametrize("name", names())
def test_its_poses_are_those_of_torch(name):
    """Of three images: a spacecraft, that image turned and mirrored, and nothing."""
    in_torch, graph = (ffpose.load(name, backend=each) for each in ("torch", "onnxruntime"))
    first = in_torch.preprocess(UNSEEN)
    inputs = np.stack([first, first[:, ::-1, ::-1], np.full_like(first, -1.0)])
    got, expected = graph.run(inputs), in_torch.run(inputs)
    assert got.keys() == expected.keys()
    np.testing.assert_allclose(got["translation"], expected["translation"], atol=2e-3)
    np.testing.assert_allclose(got["in_view"], expected["in_view"], atol=1e-3)
    shown = slice(2)  # of nothing, no attitude is likelier than others
    for key in ("orientation", "alternative"):
        same = np.abs((got[key] * expected[key]).sum(-1))
        np.testing.assert_allclose(same[shown], 1, atol=1e-5)
    got_p, expected_p = (each["probabilities"][shown] for each in (got, expected))
    np.testing.assert_allclose(got_p, expected_p, atol=1e-3)
    for key in ("translation_covariance", "rotation_covariance"):
        np.testing.assert_allclose(got[key], expected[key], rtol=0.02, atol=1e-6)


WITHOUT_TORCH = """
import sys
for name in ("torch", "torchvision", "timm", "safetensors", "matplotlib"):
    sys.modules[name] = None
import ffpose
print(*ffpose.load("soyuz")(sys.argv[1]).vector)
"""


def test_a_name_is_enough_without_torch():
    command = [sys.executable, "-c", WITHOUT_TORCH, str(UNSEEN)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    pose = ffpose.load("soyuz")(UNSEEN)
    got = np.array(done.stdout.split(), float)
    got[3:] *= np.sign(got[3:] @ pose.q)
    np.testing.assert_allclose(got, pose.vector, atol=1e-3)
