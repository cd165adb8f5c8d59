"""`ffpose.load`: the shipped weights from Python, and what computes them."""

import copy
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple

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


@pytest.mark.parametrize("backend", ["torch", "onnxruntime"])
def test_copies_and_pickles_give_the_same_pose(backend, monkeypatch, tmp_path):
    if backend == "onnxruntime":
        pytest.importorskip("onnxruntime")
    estimate = ffpose.load("soyuz", backend=backend, device="cpu", threads=1)
    expected = estimate(UNSEEN)
    sent = pickle.dumps(estimate)
    monkeypatch.chdir(tmp_path)
    for other in (pickle.loads(sent), copy.deepcopy(estimate)):
        assert other.metadata == estimate.metadata
        assert other.session is not estimate.session
        np.testing.assert_array_equal(other(UNSEEN).vector, expected.vector)


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


class Sums(NamedTuple):
    sums: torch.Tensor


class Summing(torch.nn.Module):
    def forward(self, images):
        return Sums(images.sum(dim=(1, 2)))


def test_torch_takes_any_array():
    """Such as a flipped view, or the part of a file that is mapped for reading."""
    x = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    x.flags.writeable = False
    for each in (x, x[::-1, :, ::-1]):
        found = TorchSession(Summing(), device="cpu").run(each)["sums"]
        np.testing.assert_array_equal(found, each.sum(axis=(1, 2)))


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


def test_threads_whose_runs_overlap_leave_torch_s_number_as_it_was():
    before = torch.get_num_threads()
    with ExitStack() as stack:
        pools = [stack.enter_context(ThreadPoolExecutor(1)) for _ in range(4)]

        def number(thread):
            return pools[thread].submit(torch.get_num_threads).result()

        def call(thread, function, *arguments):
            pools[thread].submit(function, *arguments).result()

        assert number(0) == before
        runs = [torch_threads(before + 1 + thread) for thread in range(3)]
        for thread, run in enumerate(runs):  # torch tells the second and third of the one before
            call(thread, run.__enter__)
            assert number(thread) == before + 1 + thread
        for thread, run in enumerate(runs):
            call(thread, run.__exit__, None, None, None)
            assert number(thread) == before
        assert number(3) == before  # what threads begin with
    assert torch.get_num_threads() == before


def test_a_run_within_a_run_leaves_that_one_its_number():
    before = torch.get_num_threads()
    with torch_threads(before + 1):
        with torch_threads(before + 2):
            assert torch.get_num_threads() == before + 2
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before


# The child has neither the threads that torch has used, nor the one that changes their number.
FORK_AFTER_USE = """
import os, signal, sys, threading, warnings
import numpy as np
import torch
import ffpose
from ffpose.inference.in_torch import torch_threads
change = torch.set_num_threads
change(2)
torch.exp(torch.ones(2000, 2000))
inside, done = threading.Event(), threading.Event()
def slow_change(count):
    inside.set()
    done.wait()
    change(count)
def hold():
    with torch_threads(3):
        pass
torch.set_num_threads = slow_change
thread = threading.Thread(target=hold)
thread.start()
inside.wait()
torch.set_num_threads = change
child = os.fork()
if child == 0:
    signal.alarm(100)  # where it waits, it ends by this signal
    assert torch.get_num_threads() == 1
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        estimator = ffpose.load("soyuz", backend="torch", threads=int(sys.argv[1]) or None)
        estimator(np.zeros((384, 512, 3), np.uint8))
    assert torch.get_num_threads() == 1
    said = {str(warning.message)[:47] for warning in told}
    os._exit(0 if said == set(sys.argv[2:]) else 1)
code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
done.set()
thread.join()
sys.exit(code)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.parametrize(
    ("threads", "said"), [(0, []), (2, ["torch uses 1 thread in a forked process, not 2:"])]
)
def test_a_forked_child_runs_on_one_thread_and_says_so(threads, said):
    command = [sys.executable, "-W", "ignore", "-c", FORK_AFTER_USE, str(threads), *said]
    assert subprocess.run(command, timeout=120, check=False).returncode == 0


FORK_WITH_SESSION = """
import os, signal, sys
import numpy as np
import ffpose
estimator = ffpose.load("soyuz", backend="onnxruntime", threads=2)
image = np.zeros((384, 512, 3), np.uint8)
pose = estimator(image)
child = os.fork()
if child == 0:
    signal.alarm(100)  # where it waits, it ends by this signal
    same = np.array_equal(estimator(image).t, pose.t)
    del estimator
    os._exit(0 if same else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_session_of_onnx_runtime_gives_its_pose_in_a_forked_child_and_ends():
    pytest.importorskip("onnxruntime")
    command = [sys.executable, "-W", "ignore", "-c", FORK_WITH_SESSION]
    assert subprocess.run(command, timeout=120, check=False).returncode == 0


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
