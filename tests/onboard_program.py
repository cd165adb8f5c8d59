"""Images, models and questions for the program without Python; the answers of Python's runtime."""

import io
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL
import pytest
from PIL import Image

from ffpose.config import PRESETS
from ffpose.geometry import Camera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.prediction import Prediction
from ffpose.onnx.metadata import ModelMetadata

ROOT = Path(__file__).parents[1]
CRATE = ROOT / "crates" / "ffpose-onboard"
CAMERA = Camera(128, 96, 100.0, 100.0, 64.0, 48.0)
SIZE = (48, 64)
PILLOW = int(PIL.__version__.split(".")[0])


def projections(how=None, view=(50.0, 50.0, 32.0, 24.0), **entries):
    """The bytes of a graph whose outputs are random projections of its input, 32 numbers of it.

    Two inputs that differ by one level in one pixel have other projections.
    """
    onnx = pytest.importorskip("onnx")
    rng = np.random.default_rng(0)
    helper = onnx.helper
    shapes = {
        "translation": (3,),
        "orientation": (4,),
        "translation_covariance": (3, 3),
        "rotation_covariance": (3, 3),
        "in_view": (),
        "alternative": (4,),
        "probabilities": (2,),
    }
    length = 3 * SIZE[0] * SIZE[1]
    nodes = [helper.make_node("Flatten", ["images"], ["flat"], axis=1)]
    constants, outputs = [], []
    for name, shape in shapes.items():
        count = int(np.prod(shape))
        weight = rng.standard_normal((length, count), np.float32) / np.float32(length) ** 0.5
        constants.append(onnx.numpy_helper.from_array(weight, f"{name}_weight"))
        constants.append(onnx.numpy_helper.from_array(np.array([-1, *shape]), f"{name}_shape"))
        last = {
            "orientation": "LpNormalization",
            "alternative": "LpNormalization",
            "in_view": "Sigmoid",
            "probabilities": "Sigmoid",
        }.get(name, "Identity")
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
    config = replace(PRESETS["tiny"], image_size=SIZE, camera=view)
    metadata = ModelMetadata(config, how or Preprocessing(SIZE), "none", CAMERA, 0.5)
    helper.set_model_props(model, metadata.to_entries() | entries)
    return model.SerializeToString()


def steady(variance, *, takes_point=False, rounds=0, sure=True, turned=0, rotation=None, **fields):
    """The bytes of a graph that tells a position by the level of its input, of this variance, m².

    ``rotation`` is the variance of its orientation, rad², the same number where there is none.
    A level above 180 shows no object, one above ``turned``, if any, one that is half a turn about
    its z axis farther. ``rounds`` of products of matrices make it slow; without
    ``sure`` it tells a pose alone; ``fields`` are of its metadata.
    """
    onnx = pytest.importorskip("onnx")
    helper, of_array = onnx.helper, onnx.numpy_helper.from_array
    eye = np.eye(3, dtype=np.float32)[None]
    constants = {
        "orientation": np.array([[1, 0, 0, 0]], np.float32),
        "alternative": np.array([[0, 1, 0, 0]], np.float32),
        "probabilities": np.array([[1, 0]], np.float32),
        "translation_covariance": np.float32(variance) * eye,
        "rotation_covariance": np.float32(rotation or variance) * eye,
    }
    tensors = {
        "axes": np.array([2, 3]),
        "middle": np.array([[0, 0, 10]], np.float32),
        "limit": np.array(180 / 255, np.float32),
        "nothing": np.zeros((512, 512), np.float32),
        "none": np.zeros((1, 3), np.float32),
    }
    node = helper.make_node
    nodes = [
        node("ReduceMean", ["images", "axes"], ["level"], keepdims=0),
        node("Add", ["level", "middle"], ["seen"]),
        node("Slice", ["level", "first", "second", "column"], ["red"]),
        node("Less", ["red", "limit"], ["is_there"]),
        node("Cast", ["is_there"], ["share"], to=1),
        node("Reshape", ["share", "flat"], ["in_view"]),
    ]
    for place, name in enumerate(("first", "second", "column")):
        tensors[name] = np.array([(0, 1, 1)[place]])
    tensors["flat"] = np.array([1])
    work = "none"
    if rounds:
        tensors["spread"] = np.zeros((3, 512), np.float32)
        tensors["gather"] = np.zeros((512, 3), np.float32)
        tensors["rows"] = np.array([512, 3])
        nodes += [
            node("Expand", ["level", "rows"], ["many"]),
            node("MatMul", ["many", "spread"], ["round0"]),
            *(node("MatMul", [f"round{n}", "nothing"], [f"round{n + 1}"]) for n in range(rounds)),
            node("MatMul", [f"round{rounds}", "gather"], ["gathered"]),
            node("ReduceSum", ["gathered", "zeroth"], ["work"], keepdims=1),
        ]
        tensors["zeroth"] = np.array([0])
        work = "work"
    nodes.append(node("Add", ["seen", work], ["translation"]))
    nodes += [node("Identity", [f"{name}_"], [name]) for name in constants]
    if turned:
        tensors["turned"] = np.array(turned / 255, np.float32)
        tensors["other"] = np.array([[0, 0, 0, 1]], np.float32)
        chosen = ["is_turned", "other", "orientation_"]
        nodes[-len(constants)] = node("Where", chosen, ["orientation"])
        nodes.insert(-len(constants) - 1, node("Greater", ["red", "turned"], ["is_turned"]))
    inputs = [helper.make_tensor_value_info("images", 1, ["batch", 3, *SIZE])]
    if takes_point:
        inputs.append(helper.make_tensor_value_info("point", 1, ["batch", 3]))
        nodes[-len(constants) - 1] = node("Add", ["seen", "unmoved"], ["translation"])
        nodes.insert(0, node("Mul", ["point", "none"], ["unmoved"]))
    shapes = {name: value.shape for name, value in constants.items()}
    shapes |= {"translation": (1, 3), "in_view": (1,)}
    if not sure:
        shapes = {name: shapes[name] for name in ("translation", "orientation")}
    outputs = [helper.make_tensor_value_info(name, 1, shape) for name, shape in shapes.items()]
    kept = [of_array(value, name) for name, value in tensors.items()]
    kept += [of_array(value, f"{name}_") for name, value in constants.items()]
    graph = helper.make_graph(nodes, "steady", inputs, outputs, kept)
    opsets = [helper.make_opsetid("", 18)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    config = replace(
        PRESETS["polar"], image_size=SIZE, first_stride=4, degrees_of_freedom=(5.0, 4.0)
    )
    plain = Preprocessing(SIZE, mean=(0, 0, 0), std=(1, 1, 1))
    told = {"weights_sha256": "ab" * 32, "tracking": {"attitude_angle": 18}} | fields
    metadata = ModelMetadata(config, plain, "none", CAMERA, 0.5, takes_point=takes_point, **told)
    helper.set_model_props(model, metadata.to_entries())
    return model.SerializeToString()


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


def pgm(levels, white):
    """The bytes of a PGM file of levels ``(h, w)``, of which ``white`` is white."""
    height, width = levels.shape
    header = f"P5\n# of a camera\n{width} {height}\n{white}\n".encode()
    return header + levels.astype(np.uint8 if white < 256 else ">u2").tobytes()


def png_of_chunks(**chunks):
    """The bytes of a PNG file of the given chunks."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, data in chunks.items():
        body = name.encode() + data
        parts += [len(data).to_bytes(4), body, zlib.crc32(body).to_bytes(4)]
    return b"".join(parts)


def expected(estimator, image):
    locates = estimator.metadata.locates
    return Prediction(image, estimator(image), CAMERA, locates).to_dict()


def assert_same(got, wanted, tolerance):
    assert list(got) == list(wanted)
    words = {"image", "flagged", "locates", "degrees_of_freedom"}
    assert all(got.get(name) == wanted.get(name) for name in words)
    for name in wanted.keys() - words - {"roll_pitch_yaw_deg"}:
        np.testing.assert_allclose(got[name], wanted[name], rtol=0, atol=tolerance)
    turn = np.subtract(got["roll_pitch_yaw_deg"], wanted["roll_pitch_yaw_deg"])
    np.testing.assert_allclose((turn + 180) % 360, 180, rtol=0, atol=1e-9 + 1e3 * tolerance)


def ask(process, path):
    process.stdin.write(f"{path}\n")
    return json.loads(process.stdout.readline())


def kilobytes(process, name):
    """An entry of Linux's account of a process's memory: VmRSS now, VmHWM at most."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(re.search(rf"{name}:\s+(\d+) kB", status)[1])
