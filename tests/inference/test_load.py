"""`ffpose.load`: the shipped weights from Python, and what computes them."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

import ffpose
from ffpose._internal.zoo import FOLDER
from ffpose.inference.in_torch import TorchSession, torch_threads
from ffpose.models import load_network
from pages import ROOT

UNSEEN = ROOT / "docs/images/soyuz_unseen.jpg"


def test_the_pose_in_an_image_from_its_name():
    """The network's own answer, and the picture is one of a spacecraft."""
    estimate = ffpose.load("soyuz", threads=1)
    pose = estimate(UNSEEN)
    image = Image.open(UNSEEN).convert("RGB")
    model = load_network("soyuz")
    with torch.inference_mode():
        raw = model(estimate.preprocessing(image)[None])
    np.testing.assert_allclose(pose.t, raw.translation[0], atol=1e-5)
    assert abs(pose.q @ raw.orientation[0].double().numpy()) == pytest.approx(1, abs=1e-6)
    assert pose.uncertainty.in_view == pytest.approx(float(raw.in_view[0]), abs=1e-5)
    assert pose.flagged is False
    black = np.zeros((480, 640, 3), np.uint8)
    alone, beside = estimate([np.asarray(image), black])
    np.testing.assert_allclose(alone.vector, pose.vector, atol=1e-4)
    assert beside.flagged is True


def test_weights_are_opened_by_their_path_and_their_folder(tmp_path):
    file = FOLDER / "soyuz.safetensors"
    (tmp_path / "best.safetensors").symlink_to(file)
    by_name, by_path, by_folder = (
        ffpose.load(what, device="cpu", warm_up=0) for what in ("soyuz", str(file), tmp_path)
    )
    assert by_name.metadata == by_path.metadata == by_folder.metadata


def test_the_path_of_a_camera_is_none():
    message = r"^camera: expected a Camera, got str; Camera\.read reads a file$"
    with pytest.raises(TypeError, match=message):
        ffpose.load("soyuz", camera="cam.json")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threads": 0}, "threads: expected at least 1, got 0"),
        ({"precision": "bfloat16"}, "precision: expected float32 for weights, got 'bfloat16'"),
        ({"providers": ["CPU"]}, "providers: expected with a graph"),
        ({"device": "abacus"}, "device: expected auto, or a device that torch finds here"),
    ],
)
def test_what_torch_cannot_do_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ffpose.load("soyuz", **options)


class Counting(torch.nn.Module):
    """A network that tells how many threads it has."""

    def forward(self, images):
        self.threads = torch.get_num_threads()
        return torch.nn.functional  # has no _asdict


def test_runs_that_overlap_leave_the_number_of_threads_as_it_was():
    before = torch.get_num_threads()
    own, default = torch_threads(before + 1), torch_threads(None)
    own.__enter__()
    with default:
        own.__exit__(None, None, None)
        assert torch.get_num_threads() == before
    assert torch.get_num_threads() == before


def test_threads_are_the_networks_alone():
    """Torch's number is one of the process: it is as it was, even after an error."""
    before = torch.get_num_threads()
    model = Counting()
    session = TorchSession(model, threads=before + 1)
    with pytest.raises(AttributeError):
        session.run(np.zeros((1, 3, 8, 8), np.float32))
    assert (model.threads, torch.get_num_threads()) == (before + 1, before)


WITHOUT_PILLOW = """
import sys
sys.modules["PIL"] = None
import ffpose
try:
    ffpose.load(sys.argv[1])
except ImportError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.onnx", "soyuz"])
def test_a_missing_extra_is_named(name):
    call = [sys.executable, "-c", WITHOUT_PILLOW, name]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "pip install 'ffpose[onnx]'" in done.stdout
