"""A long life: answers in turn, memory that stays, and no input that holds it up."""

import json
import os
import signal
import sys

import pytest

from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.onnx.metadata import sealed
from onboard_program import (
    SIZE,
    ask,
    assert_same,
    expected,
    jpeg,
    kilobytes,
    picture,
    png,
    projections,
)

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's account of memory")


def test_each_answer_comes_before_the_next_question(flying, folder, model):
    image = folder({"a.png": png(picture())}) / "a.png"
    wanted = expected(load(model, threads=1), image)
    for _ in range(3):
        assert_same(ask(flying, image), wanted, 0)
    assert "error" in ask(flying, "nowhere.png")
    flying.send_signal(signal.SIGKILL)
    assert flying.stdout.read() == ""  # what was answered is out, whole


@linux
def test_memory_does_not_grow(flying, folder):
    good, bad = png(picture(320, 240)), png(picture(320, 240))[:-5000]
    images = folder({"a.png": good, "b.jpg": jpeg(picture(320, 240)), "c.png": bad})
    names = sorted(images.iterdir())

    for step in range(1, 901):
        ask(flying, names[step % 3])
        if step == 300:
            early = kilobytes(flying, "VmRSS")
    assert kilobytes(flying, "VmRSS") - early < 3000  # a leaked image a frame would be 130,000


@linux
def test_of_a_thin_image_only_the_window_is_computed(fly, folder, tmp_path):
    graph = tmp_path / "model.onnx"
    graph.write_bytes(sealed(projections(Preprocessing(SIZE, "center_crop"))))
    sizes = [(1, 60_000), (60_000, 1), (1, 1000), (1500, 1)]
    images = folder({f"{w}x{h}.png": png(picture(w, h)) for w, h in sizes})
    flying = fly(graph, "--resize")
    estimator = load(graph, resize=True, threads=1)
    for w, h in sizes[2:]:
        image = images / f"{w}x{h}.png"
        assert_same(ask(flying, image), expected(estimator, image), 0)
    early = kilobytes(flying, "VmHWM")
    for w, h in sizes[:2]:
        assert "translation_m" in ask(flying, images / f"{w}x{h}.png")
    assert kilobytes(flying, "VmHWM") - early < 20_000  # its frame would be 960,000


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_no_image_and_keeps_nobody_waiting(flying, folder):
    images = folder({"b.png": png(picture())})
    os.mkfifo(images / "a.png")
    pipe = ask(flying, images / "a.png")
    assert pipe["error"] == "expected a regular file, got a named pipe"
    assert "translation_m" in ask(flying, images / "b.png")


def test_an_endless_line_is_told_and_passed_over(flying, folder):
    image = folder({"a.png": png(picture())}) / "a.png"
    flying.stdin.write("a" * 5000)  # and no end
    flying.stdin.flush()
    beginning = json.loads(flying.stdout.readline())
    assert beginning["image"] == "a" * 4096
    assert beginning["error"] == "expected a line of at most 4096 bytes, got a longer one"
    flying.stdin.write("a" * 100_000 + "\n")
    assert "translation_m" in ask(flying, image)
