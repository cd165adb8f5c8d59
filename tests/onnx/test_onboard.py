"""The program without Python: the poses of Python's runtime, and a life through bad input."""

import ctypes
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import zlib
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL
import pytest
from PIL import Image

from ffpose.config import CONFIGS
from ffpose.geometry import Camera
from ffpose.inference.load import load
from ffpose.onnx.library import get_library_path
from ffpose.onnx.metadata import ModelMetadata, sealed
from ffpose.prediction import Prediction
from ffpose.preprocessing import Preprocessing
from networks import MODEL_FIELDS

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")

ROOT = Path(__file__).parents[2]
CRATE = ROOT / "crates" / "ffpose-onboard"
TARGET = ROOT / "target" / "onboard"
CAMERA = Camera(128, 96, 100.0, 100.0, 64.0, 48.0)
SIZE = (48, 64)

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's account of memory")


@pytest.fixture(scope="session")
def program():
    """The program, as `make onboard` builds it; a build that is up to date takes no time."""
    if not shutil.which("cargo"):
        pytest.skip("cargo is not installed")
    (needed,) = re.findall(r'rust-version = "1\.(\d+)"', (CRATE / "Cargo.toml").read_text())
    version = subprocess.run(["cargo", "--version"], capture_output=True, text=True, check=True)
    if int(version.stdout.split(".")[1]) < int(needed):
        pytest.skip(f"the program needs Rust 1.{needed}, got {version.stdout.strip()}")
    folders = ["--manifest-path", str(CRATE / "Cargo.toml"), "--target-dir", str(TARGET)]
    command = ["cargo", "build", "--locked", "--release", "--quiet", *folders]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return TARGET / "release" / "ffpose-onboard"


@pytest.fixture(scope="session")
def runtime():
    """ONNX Runtime's library, the one that Python uses a copy of."""
    found = sorted((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.*"))
    if not found:
        pytest.skip("onnxruntime holds no library for other programs here")
    return found[0]


@pytest.fixture
def run(program, runtime):
    """Runs the program on one thread; returns exit code, documents and lines of standard error."""

    def run(model, *arguments, lines=(), runtime=runtime):
        command = [program, "--model", model, "--runtime", runtime, "--threads", "1", *arguments]
        done = subprocess.run(
            command, input="\n".join(map(str, lines)), capture_output=True, text=True, check=False
        )
        documents = [json.loads(line) for line in done.stdout.splitlines()]
        return done.returncode, documents, done.stderr.splitlines()

    return run


def projections(how=None, **entries):
    """The bytes of a graph whose outputs are random projections of its input, 21 numbers of it.

    Two inputs that differ by one level in one pixel have other projections.
    """
    rng = np.random.default_rng(0)
    helper = onnx.helper
    shapes = {
        "translation": (3,),
        "orientation": (4,),
        "translation_covariance": (3, 3),
        "rotation_covariance": (3, 3),
        "in_view": (),
    }
    length = 3 * SIZE[0] * SIZE[1]
    nodes = [helper.make_node("Flatten", ["images"], ["flat"], axis=1)]
    constants, outputs = [], []
    for name, shape in shapes.items():
        count = int(np.prod(shape))
        weight = rng.standard_normal((length, count), np.float32) / np.float32(length) ** 0.5
        constants.append(onnx.numpy_helper.from_array(weight, f"{name}_weight"))
        constants.append(onnx.numpy_helper.from_array(np.array([-1, *shape]), f"{name}_shape"))
        last = {"orientation": "LpNormalization", "in_view": "Sigmoid"}.get(name, "Identity")
        nodes += [
            helper.make_node("MatMul", ["flat", f"{name}_weight"], [f"{name}_sum"]),
            helper.make_node(last, [f"{name}_sum"], [f"{name}_last"]),
            helper.make_node("Reshape", [f"{name}_last", f"{name}_shape"], [name]),
        ]
        outputs.append(helper.make_tensor_value_info(name, 1, ["batch", *shape]))
    images = helper.make_tensor_value_info("images", 1, ["batch", 3, *SIZE])
    graph = helper.make_graph(nodes, "projections", [images], outputs, constants)
    opsets = [helper.make_opsetid("", 18)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    config = replace(CONFIGS["tiny"], image_size=SIZE)
    metadata = ModelMetadata(config, how or Preprocessing(SIZE), "none", CAMERA, 0.5)
    helper.set_model_props(model, metadata.to_entries() | entries)
    return model.SerializeToString()


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("onboard") / "projections.onnx"
    path.write_bytes(sealed(projections()))
    return path


def picture(width=128, height=96, mode="RGB"):
    pixels = np.random.default_rng(width).integers(0, 256, (height, width, 4), dtype=np.uint8)
    return Image.fromarray(pixels).convert("RGB" if mode == "P" else mode).convert(mode)


def png(image):
    data = io.BytesIO()
    image.save(data, "png")
    return data.getvalue()


def jpeg(image, **options):
    data = io.BytesIO()
    image.save(data, "jpeg", quality=90, **options)
    return data.getvalue()


@pytest.fixture
def folder(tmp_path):
    """Makes a folder of image files of the given bytes."""

    def make(files):
        folder = tmp_path / "images"
        folder.mkdir()
        for name, data in files.items():
            (folder / name).write_bytes(data)
        return folder

    return make


def expected(estimator, image):
    locates = estimator.metadata.locates
    return Prediction(image, estimator(image), CAMERA, locates).to_dict()


def assert_same(got, wanted, tolerance):
    assert list(got) == list(wanted)
    words = {"image", "flagged", "locates"}
    assert all(got.get(name) == wanted.get(name) for name in words)
    for name in wanted.keys() - words - {"roll_pitch_yaw_deg"}:
        np.testing.assert_allclose(got[name], wanted[name], rtol=0, atol=tolerance)
    turn = np.subtract(got["roll_pitch_yaw_deg"], wanted["roll_pitch_yaw_deg"])
    np.testing.assert_allclose((turn + 180) % 360, 180, rtol=0, atol=1e-9 + 1e3 * tolerance)


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
@pytest.mark.parametrize("mode", ["resize", "center_crop"])
def test_the_input_is_that_of_python_to_the_bit(run, folder, tmp_path, mode, interpolation):
    graph = tmp_path / "model.onnx"
    preprocessing = Preprocessing(SIZE, mode, interpolation=interpolation)
    graph.write_bytes(sealed(projections(preprocessing)))
    sizes = [(128, 96), (64, 48), (333, 201), (20, 17), (1, 2)]
    if int(PIL.__version__.split(".")[0]) >= 13:  # before, tall images were resized across first
        sizes += [(9, 400), (128, 300), (120, 160), (120, 161)]
    files = {f"{w}x{h}.png": png(picture(w, h)) for w, h in sizes}
    files |= {f"{kind}.png": png(picture(mode=kind)) for kind in ("L", "LA", "P", "RGBA")}
    images = folder(files)
    code, documents, errors = run(graph, "--images", images, "--any-camera")
    assert (code, errors) == (0, [])
    assert [d["image"] for d in documents] == sorted(str(images / name) for name in files)
    estimator = load(graph, resize=True, threads=1)
    for document in documents:
        assert_same(document, expected(estimator, Path(document["image"])), 0)


def test_a_jpeg_is_decoded_as_by_python_but_for_rounding(run, folder, model):
    smooth = picture(16, 12).resize((128, 96), Image.Resampling.BICUBIC)
    gray = smooth.convert("L")
    images = folder(
        {
            "baseline.jpg": jpeg(smooth),
            "gray.jpeg": jpeg(gray),
            "progressive.JPG": jpeg(smooth, progressive=True),
            "whole.jpg": jpeg(smooth, subsampling=0),
        }
    )
    code, documents, _ = run(model, "--images", images)
    assert code == 0
    estimator = load(model, threads=1)
    for document in documents:
        path = Path(document["image"])
        assert_same(document, expected(estimator, path), 0.01 if "gray" in path.name else 0.1)


def test_a_network_with_filters_gives_its_pose(run, folder, tmp_path):
    pytest.importorskip("onnxscript")
    torch = pytest.importorskip("torch")
    from ffpose.cli import main
    from ffpose.models import FilterformerPose

    torch.manual_seed(0)
    small = {"image_size": (64, 64), "dim": 16, "depth": 1, "heads": 2, "feed_forward": 16}
    small |= {"head_hidden": 16, "translation_mlp_dim": 4, "orientation_mlp_dim": 4}
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


@pytest.mark.parametrize("locates", ["object", "camera"])
@pytest.mark.parametrize("name", MODEL_FIELDS)
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


def test_images_of_another_camera_are_refused_unless_asked_for(run, folder, model):
    images = folder({"same.png": png(picture(64, 48)), "wide.png": png(picture(128, 64))})
    code, (same, wide), errors = run(model, "--images", images)
    assert code == 3
    assert "translation_m" in same
    assert list(wide) == ["image", "error"]
    assert "the model's camera, 128x96, got an image of 128x64" in wide["error"]
    assert errors == ["ffpose-onboard: 1 of 2 images have no pose"]
    code, (_, wide), _ = run(model, "--images", images, "--any-camera")
    assert code == 0
    assert_same(wide, expected(load(model, resize=True, threads=1), images / "wide.png"), 0)


def test_bad_images_are_told_and_the_loop_goes_on(run, folder, model):
    whole, photo = png(picture()), jpeg(picture())
    deep = png(Image.fromarray(np.full((96, 128), 40_000, np.uint16)))
    altered = bytearray(whole)
    altered[len(whole) // 2] ^= 1
    files = {
        "a_cut.png": (whole[: len(whole) // 2], "damaged PNG"),
        "b_cut.jpg": (photo[:-30], "damaged JPEG file: it is cut short"),
        "c_text.png": (b"no image", 'expected a PNG or JPEG file, .* begins with "no image"'),
        "d_empty.jpeg": (b"", "expected a PNG or JPEG file"),
        "e_deep.png": (deep, "expected 8 bits a channel, got 16"),
        "f_print.jpg": (jpeg(picture(mode="CMYK")), "expected gray or color of RGB or YCbCr"),
        "g_altered.png": (bytes(altered), "damaged PNG"),
        "h_good.png": (whole, None),
    }
    images = folder({name: data for name, (data, _) in files.items()})
    (images / "labels.csv").write_text("not an image, and not meant as one")
    (images / "i_folder.png").mkdir()
    code, documents, errors = run(model, "--images", images)
    assert code == 3
    assert errors == ["ffpose-onboard: 8 of 9 images have no pose"]
    for document, (name, (_, message)) in zip(documents[:-1], files.items(), strict=True):
        assert document["image"] == str(images / name)
        assert (message is None) == ("error" not in document)
        assert message is None or re.search(message, document["error"]), document
    assert documents[-1]["error"] == "expected a regular file, got a folder"

    lines = [images / "h_good.png", "/nowhere/a.png", "", images / "h_good.png"]
    code, (first, missing, empty, last), _ = run(model, "--stdin", lines=[*lines, ""])
    assert (code, first) == (3, last)
    assert "cannot be read: No such file" in missing["error"]
    assert (empty["image"], "error" in empty) == ("", True)


def png_of_chunks(**chunks):
    """The bytes of a PNG file of the given chunks."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, data in chunks.items():
        body = name.encode() + data
        parts += [len(data).to_bytes(4), body, zlib.crc32(body).to_bytes(4)]
    return b"".join(parts)


def test_a_panic_of_a_decoder_is_the_error_of_its_image(run, folder, model):
    header = (4).to_bytes(4) + (3).to_bytes(4) + bytes([8, 3, 0, 0, 0])
    rows = zlib.compress(bytes(5 * 3))
    # Four bytes are no palette: png 0.18.1 takes three of the one that is left, and panics.
    torn = png_of_chunks(IHDR=header, PLTE=b"\x07" * 4, IDAT=rows, IEND=b"")
    images = folder({"a.png": png(picture()), "b.png": torn, "c.png": png(picture())})
    code, (first, second, third), errors = run(model, "--images", images, "--any-camera")
    assert (code, errors[-1]) == (3, "ffpose-onboard: 1 of 3 images have no pose")
    assert first | {"image": ""} == third | {"image": ""}
    assert "got a panic, a bug of this program: range end index 3" in second["error"]


@pytest.fixture
def fly(program, runtime):
    """Starts the program in its loop; asked for one image, it answers with one line."""
    with ExitStack() as stack:

        def fly(model, *arguments):
            command = [program, "--model", model, "--runtime", runtime, "--threads", "1", "--stdin"]
            process = stack.enter_context(
                subprocess.Popen(
                    [*command, *arguments],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    bufsize=1,
                )
            )
            stack.callback(process.kill)
            return process

        yield fly


@pytest.fixture
def flying(fly, model):
    return fly(model)


def ask(process, path):
    process.stdin.write(f"{path}\n")
    return json.loads(process.stdout.readline())


def kilobytes(process, name):
    """An entry of Linux's account of a process's memory: VmRSS now, VmHWM at most."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(re.search(rf"{name}:\s+(\d+) kB", status)[1])


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
    flying = fly(graph, "--any-camera")
    estimator = load(graph, resize=True, threads=1)
    for w, h in sizes[2:]:
        image = images / f"{w}x{h}.png"
        assert_same(ask(flying, image), expected(estimator, image), 0)
    early = kilobytes(flying, "VmHWM")
    for w, h in sizes[:2]:
        assert "translation_m" in ask(flying, images / f"{w}x{h}.png")
    assert kilobytes(flying, "VmHWM") - early < 20_000  # its frame would be 960,000


def test_a_large_image_is_refused_by_its_header(run, folder, model):
    files = {"long.png": png(picture(65_536, 1)), "wide.png": bytearray(png(picture(4, 4)))}
    files["wide.png"][16:24] = (60_000).to_bytes(4) * 2
    files["wide.png"][29:33] = zlib.crc32(files["wide.png"][12:29]).to_bytes(4)
    code, (long, wide), _ = run(model, "--images", folder(files), "--any-camera")
    assert code == 3
    limits = "expected an image of 1 to 65535 pixels a side and at most 89478485 in all"
    assert long["error"] == f"{limits}, got 65536x1"
    assert wide["error"] == f"{limits}, got 60000x60000"


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


NEWER = {"ffpose_format": "2", "ffpose_version": "9.9"}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (None, "cannot be read: No such file"),
        (b"no model", "expected an ONNX file, got one that is cut short or none"),
        (onnx.ModelProto(ir_version=9).SerializeToString(), "without its metadata"),
        (projections(), "the file was altered: expected its SHA-256 in it, got none"),
        (sealed(projections()).replace(b"wxyz", b"xyzw"), "the file was altered"),
        (sealed(projections(**NEWER)), "format 1, .* got format 2, written by ffpose 9.9"),
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


def test_wrong_usage_and_folders(run, program, model, tmp_path):
    code, _, errors = run(model)
    assert (code, len(errors)) == (2, 1)
    assert "expected --images or --stdin, got neither" in errors[0]
    code, documents, errors = run(tmp_path, "--stdin")
    assert (code, documents, len(errors)) == (1, [], 1)
    assert "expected a regular file, got a folder" in errors[0]
    for path, message in [(tmp_path / "nowhere", "No such file"), (tmp_path, "got none")]:
        code, _, errors = run(model, "--images", path)
        assert (code, len(errors)) == (1, 1)
        assert message in errors[0]
    shown = subprocess.run([program, "--help"], capture_output=True, text=True, check=True)
    assert "usage: ffpose-onboard --model FILE" in shown.stdout


def test_it_needs_nothing_of_python_and_no_core():
    lock = (CRATE / "Cargo.lock").read_text()
    names = set(re.findall(r'^name = "(.*)"$', lock, re.MULTILINE))
    assert "ort" in names
    assert not names & {"ffpose-core", "ffpose-ort", "ffpose-py", "pyo3"}
