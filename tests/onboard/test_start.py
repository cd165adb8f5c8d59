"""What cannot be used, model, libraries or arguments, is told in one line."""

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ffpose.onnx.library import get_library_path
from ffpose.onnx.metadata import sealed
from onboard_program import picture, png, projections

onnx = pytest.importorskip("onnx")

FULL = Path("/dev/full")
NEWER = {"ffpose_format": "3", "ffpose_version": "9.9"}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (None, "cannot be read: No such file"),
        (b"no model", "expected an ONNX file, got one that is cut short or none"),
        (onnx.ModelProto(ir_version=9).SerializeToString(), "without its metadata"),
        (projections(), "the file was altered: expected its SHA-256 in it, got none"),
        (sealed(projections()).replace(b"wxyz", b"xyzw"), "the file was altered"),
        (sealed(projections(**NEWER)), "format 2, .* got format 3, written by ffpose 9.9"),
        (sealed(projections(filter="fast")), "filter: expected one of custom, matmul, none"),
        (sealed(projections(preprocessing="{}")), "expected metadata that ffpose"),
        (sealed(projections()[60:]), "expected an ONNX file|without its metadata"),
        (
            sealed(projections().replace(b"LpNormalization", b"LqNormalization")),
            "ONNX Runtime: .*LqNormalization",
        ),
    ],
)
def test_a_model_that_cannot_be_used_is_told_in_one_line(run, tmp_path, data, message):
    path = tmp_path / "model.onnx"
    if data is not None:
        path.write_bytes(data)
    code, documents, errors = run(path, "--stdin", lines=["a.png"])
    assert (code, documents, len(errors)) == (1, [], 1)
    assert re.search(f"^ffpose-onboard: {re.escape(str(path))}.*{message}", errors[0]), errors[0]


def test_a_model_of_another_digest_is_refused(run, folder, model):
    images = folder({"a.png": png(picture())})
    digest = hashlib.sha256(model.read_bytes()).hexdigest()
    code, (document,), _ = run(model, "--images", images, "--sha256", digest.upper())
    assert (code, "translation_m" in document) == (0, True)
    signed = "0" * 64
    code, documents, errors = run(model, "--images", images, "--sha256", signed)
    assert (code, documents) == (1, [])
    refusal = f"{model}: expected SHA-256 {signed} (--sha256), got {digest}"
    assert errors == [f"ffpose-onboard: {refusal}"]
    code, _, errors = run(model, "--images", images, "--sha256", "0xff")
    assert code == 2
    assert "--sha256: expected 64 hexadecimal digits, got 0xff" in errors[0]


def test_weights_in_another_file_are_refused(run, folder, tmp_path):
    network = onnx.load_from_string(projections())
    weight = network.graph.initializer[0]
    (tmp_path / "weight.bin").write_bytes(weight.raw_data)
    onnx.external_data_helper.set_external_data(weight, "weight.bin")
    weight.ClearField("raw_data")
    graph = tmp_path / "model.onnx"
    graph.write_bytes(sealed(network.SerializeToString()))
    images = folder({"a.png": png(picture())})
    code, documents, errors = run(graph, "--images", images)
    assert (code, documents, len(errors)) == (1, [], 1)
    assert "expected all weights in this file, whose bytes are checked" in errors[0]
    assert f"got tensor {weight.name} with external data (location: weight.bin)" in errors[0]


@pytest.mark.skipif(sys.platform != "linux", reason="watches a file by inotify")
def test_the_model_is_read_once(run, folder, model):
    images = folder({"a.png": png(picture())})
    library = ctypes.CDLL(None, use_errno=True)
    watch = library.inotify_init1(os.O_NONBLOCK)
    opened_or_closed = 0x20 | 0x10  # IN_OPEN, IN_CLOSE_NOWRITE: repetitions of one are not told
    assert watch >= 0
    assert library.inotify_add_watch(watch, os.fsencode(model), opened_or_closed) >= 0
    try:
        assert run(model, "--images", images)[0] == 0
        events = os.read(watch, 4096)
    finally:
        os.close(watch)
    assert len(events) == 2 * 16  # opened and closed once: what is checked is what runs


@pytest.mark.parametrize("option", ["--runtime", "--operators"])
def test_a_wrong_library_is_told_in_one_line(run, model, tmp_path, runtime, option):
    text = tmp_path / "text.so"
    text.write_text("no library")
    cases = [(tmp_path / "nowhere.so", "No such file"), (text, "file too short|invalid ELF")]
    if option == "--runtime":
        cases.append((get_library_path(), "does not export `OrtGetApiBase`"))
    else:
        cases.append((runtime, "RegisterCustomOps"))
    for path, message in cases:
        arguments = {"runtime": path} if option == "--runtime" else {}
        extra = () if arguments else (option, path)
        code, documents, errors = run(model, "--stdin", *extra, **arguments)
        assert (code, documents, len(errors)) == (1, [], 1)
        assert re.search(f"{re.escape(str(path))}.*{option}|{option}.*cannot", errors[0]), errors
        assert re.search(message, errors[0]), errors


def start(folder, *words, **streams):
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DYLIB_PATH"}
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE} | streams
    done = subprocess.run(words, cwd=folder, env=environment, stderr=subprocess.PIPE, **streams)
    return done.returncode, done.stderr.decode()


def test_the_usual_library_is_not_that_of_the_working_folder(program, model, tmp_path, runtime):
    name = "libonnxruntime.dylib" if sys.platform == "darwin" else "libonnxruntime.so"
    (tmp_path / name).write_text("no library")
    code, error = start(tmp_path, program, "--model", model, "--stdin")
    assert (code, str(tmp_path) in error) in {(0, False), (1, False)}  # the system may have one
    shutil.copy(program, tmp_path / "program")
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to(runtime)
    assert start(tmp_path.parent, tmp_path / "program", "--model", model, "--stdin")[0] == 0


@pytest.mark.skipif(not FULL.exists(), reason="needs a disk that is full")
def test_output_that_cannot_be_written_has_its_code(program, model, runtime, tmp_path):
    with FULL.open("w") as full:
        code, error = start(tmp_path, program, "--help", stdout=full)
        assert code == 1
        assert error.startswith("ffpose-onboard: standard output cannot be written: No space left")
        words = [program, "--model", model, "--runtime", runtime, "--images"]
        (tmp_path / "a.png").write_bytes(b"no image")
        assert (
            subprocess.run([*words, tmp_path], stderr=full, stdout=subprocess.PIPE).returncode == 3
        )
        nowhere = tmp_path / "nowhere"
        assert subprocess.run([*words, nowhere], stderr=full).returncode == 1


def test_wrong_usage_and_folders(run, program, model, tmp_path):
    code, _, errors = run(model)
    assert (code, len(errors)) == (2, 1)
    assert "expected --images, --stdin or --track, got neither" in errors[0]
    code, documents, errors = run(tmp_path, "--stdin")
    assert (code, documents, len(errors)) == (1, [], 1)
    assert "expected a regular file, got a folder" in errors[0]
    for path, message in [(tmp_path / "nowhere", "No such file"), (tmp_path, "got none")]:
        code, _, errors = run(model, "--images", path)
        assert (code, len(errors)) == (1, 1)
        assert message in errors[0]
    shown = subprocess.run([program, "--help"], capture_output=True, text=True, check=True)
    assert "usage: ffpose-onboard --model FILE" in shown.stdout
