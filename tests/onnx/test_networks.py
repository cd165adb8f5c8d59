"""Networks other than FilterformerPose as graphs: exported, described, and of the same poses."""

import numpy as np
import pytest
import torch

from ffpose.inference.load import load
from ffpose.models import build_network
from networks import MODEL_FIELDS

pytest.importorskip("onnxscript")
pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ursonet", "posenet"])
def test_the_graph_gives_the_poses_of_the_network(name, tmp_path, random_image):
    from ffpose.onnx.pose_graph import export_weights

    torch.manual_seed(0)
    model = build_network(name, backbone_weights="none", **MODEL_FIELDS[name]).eval()
    weights, graph = tmp_path / "a.safetensors", tmp_path / "a.onnx"
    model.save_pretrained(weights)
    exported = export_weights(weights, graph, "matmul")
    assert exported.filter == "none"
    estimator = load(graph)
    assert estimator.metadata.config == model.config
    got, expected = estimator(random_image), load(weights)(random_image)
    np.testing.assert_allclose(got.t, expected.t, atol=1e-4)
    assert abs(np.dot(got.q, expected.q)) > 1 - 1e-5


@pytest.fixture
def random_image():
    from PIL import Image

    pixels = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    return Image.fromarray(pixels)


def test_bins_at_the_edge_of_a_mode_are_no_difference():
    """A network that has hardly learned has probability there."""
    from ffpose.onnx.pose_graph import EDGE, pose_differences

    quaternion = np.array([[1.0, 0, 0, 0]])
    expected = {
        "translation": np.zeros((1, 3)),
        "orientation": quaternion,
        "alternative": quaternion,
        "probabilities": np.array([[0.2, 0.1]]),
    }
    for change, found in ((0.004, 0.0), (0.05, 0.05 - EDGE)):
        got = expected | {"probabilities": expected["probabilities"] + change}
        assert pose_differences(got, expected)["probabilities"] == pytest.approx(found)


def test_covariances_that_a_bin_at_the_edge_moves_are_no_difference():
    """Calibration lets them grow with the first mode's doubt, 1 - p: by (1 + 3 (1 - p))² here."""
    from ffpose.onnx.pose_graph import pose_differences

    def outputs(probability, rotation=1.0):
        growth = np.square(1 + (1 - probability) * 3)
        quaternion = np.array([[1.0, 0, 0, 0]])
        return {
            "translation": np.zeros((1, 3)),
            "orientation": quaternion,
            "translation_covariance": np.eye(3)[None] * 0.5,
            "rotation_covariance": np.eye(3)[None] * 0.8 * rotation * growth,
            "alternative": quaternion,
            "probabilities": np.array([[probability, 0.1]]),
        }

    doubt_sigma = (0.0, 3.0)
    moved = pose_differences(outputs(0.203), outputs(0.2), doubt_sigma)
    assert max(moved.values()) < 1e-12
    assert pose_differences(outputs(0.203), outputs(0.2))["rotation_covariance"] > 2e-3
    wrong = pose_differences(outputs(0.203, rotation=1.01), outputs(0.2), doubt_sigma)
    assert wrong["rotation_covariance"] == pytest.approx(0.8 * 0.01 / 2)
