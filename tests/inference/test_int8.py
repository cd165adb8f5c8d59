"""Quantization to int8, of a graph made by hand: what is quantized, what is lost."""

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ffpose.arrays import has_vnni
from ffpose.cli import main
from ffpose.config import CONFIGS
from ffpose.errors import DataError
from ffpose.geometry import Camera
from ffpose.imaging.images import image_files
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.inference.load import load
from ffpose.onnx.metadata import ModelMetadata, read_model_metadata, sealed

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnx.helper")  # without the package `onnx` is this project's tests/onnx
pytest.importorskip("onnxruntime")
int8 = pytest.importorskip("ffpose.inference.int8")

SIZE = (16, 32)
CHANNELS = 8


def node(kind, inputs, output, scope, **attributes):
    made = onnx.helper.make_node(kind, inputs, [output], name=f"node_{output}", **attributes)
    entry = made.metadata_props.add()
    entry.key, entry.value = "pkg.torch.onnx.name_scopes", repr(["", *scope, output])
    return made


@pytest.fixture
def graph(tmp_path):
    """A convolution in the backbone, and a linear head to position and quaternion."""
    random = np.random.default_rng(0)
    constants = {
        "kernel": random.normal(size=(CHANNELS, 3, 3, 3)).astype(np.float32),
        "weight": random.normal(size=(CHANNELS, 7)).astype(np.float32),
        "ends": np.array([3, 4]),
    }
    head = ["translation_branch", "translation_branch.head"]
    nodes = [
        node("Conv", ["images", "kernel"], "maps", ["backbone"], pads=[1, 1, 1, 1]),
        node("Relu", ["maps"], "bright", ["backbone"]),
        node("GlobalAveragePool", ["bright"], "means", ["translation_branch"]),
        node("Flatten", ["means"], "latent", ["translation_branch"]),
        node("MatMul", ["latent", "weight"], "numbers", head),
        onnx.helper.make_node("Split", ["numbers", "ends"], ["translation", "raw"], axis=1),
        onnx.helper.make_node("LpNormalization", ["raw"], ["orientation"], axis=1),
    ]
    kinds = {"images": ["b", 3, *SIZE], "translation": ["b", 3], "orientation": ["b", 4]}
    images, *outputs = (
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
        for name, shape in kinds.items()
    )
    body = onnx.helper.make_graph(
        nodes,
        "g",
        [images],
        outputs,
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = onnx.helper.make_model(
        body, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=10
    )
    config = replace(CONFIGS["tiny"], image_size=SIZE)
    metadata = ModelMetadata(config, Preprocessing(SIZE), "none", weights_sha256=64 * "a")
    onnx.helper.set_model_props(model, metadata.to_entries())
    path = tmp_path / "float.onnx"
    path.write_bytes(sealed(model.SerializeToString()))
    return path


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    (folder / "labels.csv").write_text("no image")
    random = np.random.default_rng(1)
    for name in ("b.PNG", "a.png", "c.jpg"):
        Image.fromarray(random.integers(0, 256, (*SIZE, 3), np.uint8)).save(folder / name)
    return image_files(folder, "calibrate")


def test_the_backbone_is_int8_and_the_head_float(graph, images, tmp_path):
    out = tmp_path / "int8.onnx"
    quantized = int8.quantize_graph(graph, out, images)
    model = onnx.load(out)
    onnx.checker.check_model(model, full_check=True)
    makers = {output: node for node in model.graph.node for output in node.output}
    convolution, product = (
        next(node for node in model.graph.node if node.op_type == kind)
        for kind in ("Conv", "MatMul")
    )
    assert {makers[name].op_type for name in convolution.input} == {"DequantizeLinear"}
    scales = {each.name: each for each in model.graph.initializer}
    weight = makers[convolution.input[1]]
    assert scales[weight.input[0]].data_type == onnx.TensorProto.INT8
    assert list(scales[weight.input[1]].dims) == [CHANNELS]  # by channel
    assert product.input[1] == "weight"
    assert "DequantizeLinear" not in {makers[name].op_type for name in product.input[:1]}
    assert quantized.nodes == 1
    assert quantized.bytes == out.stat().st_size


def test_the_loss_is_that_of_the_poses(graph, images, tmp_path):
    out = tmp_path / "int8.onnx"
    quantized = int8.quantize_graph(graph, out, images)
    single, eight = load(graph), load(out)
    for place, image in enumerate(images):
        a, b = single(image), eight(image)
        apart = np.linalg.norm(a.t - b.t)
        assert quantized.translation_m[place] == pytest.approx(apart)
        assert 0 < apart < 0.02 * np.linalg.norm(a.t)
        angle = np.degrees(2 * np.arccos(min(1.0, abs(a.q @ b.q))))
        assert quantized.rotation_deg[place] == pytest.approx(angle, abs=1e-4)


def test_median_and_largest_loss_in_words(tmp_path):
    values = np.array([1.0, 5.0, 2.0])
    assert int8.Quantized(tmp_path, 0, 0, values, values / 10).lines() == [
        "int8 against float32, translation: median 2 m, largest 5 m",
        "int8 against float32, rotation: median 0.2 deg, largest 0.5 deg",
    ]


def test_the_metadata_names_precision_and_images(graph, images, tmp_path):
    out = tmp_path / "int8.onnx"
    int8.quantize_graph(graph, out, images)
    before, after = read_model_metadata(graph), read_model_metadata(out)
    digests = [hashlib.sha256(image.read_bytes()).hexdigest() for image in images]
    digest = hashlib.sha256("".join(digests).encode()).hexdigest()
    assert before.precision == "float32"
    assert after == replace(before, precision="int8", calibration_sha256=digest)


def test_numbers_that_float16_holds_are_stored_so(graph, images, tmp_path):
    """As in the float32 graph; ONNX Runtime makes them float32 as it folds batch norms."""
    int8.quantize_graph(graph, tmp_path / "int8.onnx", images)
    for tensor in onnx.load(tmp_path / "int8.onnx").graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= 1024:
            assert (values.astype(np.float16) != values).any(), tensor.name


def describe(graph, metadata):
    """Write other metadata into a graph."""
    model = onnx.load(graph)
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, metadata.to_entries())
    graph.write_bytes(sealed(model.SerializeToString()))


@pytest.mark.parametrize("camera", [None, Camera(32, 16, 20.0, 20.0, 16.0, 8.0)])
def test_images_for_a_network_of_undistorted_ones_are_taken_as_such(
    graph, images, tmp_path, camera
):
    plain = int8.quantize_graph(graph, tmp_path / "plain.onnx", images)
    metadata = replace(read_model_metadata(graph), undistorted=True, camera=camera)
    describe(graph, metadata)
    quantized = int8.quantize_graph(graph, tmp_path / "int8.onnx", images)
    assert read_model_metadata(quantized.path).undistorted
    np.testing.assert_array_equal(quantized.translation_m, plain.translation_m)
    np.testing.assert_array_equal(quantized.rotation_deg, plain.rotation_deg)


def test_calibration_images_are_of_the_camera_beside_them(graph, images, tmp_path):
    """Images of another focal length are reprojected, as by predict; an error names the image."""
    view = Camera(32, 16, 20.0, 20.0, 16.0, 8.0)
    config = replace(read_model_metadata(graph).config, camera=(20.0, 20.0, 16.0, 8.0))
    metadata = replace(read_model_metadata(graph), config=config, camera=view)
    describe(graph, metadata)
    plain = int8.quantize_graph(graph, tmp_path / "plain.onnx", images)
    longer = Camera(32, 16, 30.0, 30.0, 16.0, 8.0)
    (images[0].parent / "camera.json").write_text(json.dumps(asdict(longer)))
    turned = int8.quantize_graph(graph, tmp_path / "int8.onnx", images)
    expected = [load(path, camera=longer)(images) for path in (graph, turned.path)]
    lost = [np.linalg.norm(one.t - other.t) for one, other in zip(*expected, strict=True)]
    np.testing.assert_allclose(turned.translation_m, lost, rtol=0, atol=1e-6)
    assert np.abs(turned.translation_m - plain.translation_m).max() > 1e-6


def refused(graph, images, out):
    with pytest.raises(ValueError, match="camera") as error:
        int8.quantize_graph(graph, out, images)
    return str(error.value)


def test_errors_of_cameras_name_the_file_beside_the_images(graph, images, tmp_path):
    out, view = tmp_path / "int8.onnx", Camera(32, 16, 20.0, 20.0, 16.0, 8.0)
    config = replace(read_model_metadata(graph).config, camera=(20.0, 20.0, 16.0, 8.0))
    metadata = replace(read_model_metadata(graph), config=config, camera=view)
    describe(graph, replace(metadata, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)))
    (images[0].parent / "camera.json").write_text(json.dumps(asdict(view)))
    lens = refused(graph, images, out)
    assert "expected that of training, with the distortion (0.1" in lens
    assert lens.endswith("of calibration images it is the camera.json beside them, not an option")
    describe(graph, metadata)
    Image.new("RGB", (32, 32)).save(images[1])
    wrong = refused(graph, images, out)
    assert wrong.startswith(f"{images[1]}: expected the aspect ratio of its camera, Camera(")
    assert wrong.endswith("is the camera.json beside them, not an option")
    (tmp_path / "other").mkdir()
    Image.new("RGB", (32, 16)).save(tmp_path / "other" / "d.png")
    other = [images[0], tmp_path / "other" / "d.png"]
    assert "camera: expected one beside all images, got" in refused(graph, other, out)


def test_a_graph_has_the_suffix_by_which_it_is_opened(capsys):
    for words in (["--track"], ["--int8", "--calibrate", "images"]):
        assert main(["export", "soyuz", "--out", "model", *words]) == 2
        assert "out: expected a file that ends in .onnx, got model" in capsys.readouterr().err


def test_images_are_sorted_and_other_files_left_out(images):
    assert [image.name for image in images] == ["a.png", "b.PNG", "c.jpg"]


def test_what_cannot_be_calibrated_is_refused(graph, images, tmp_path):
    out = tmp_path / "int8.onnx"
    with pytest.raises(FileNotFoundError, match="calibrate: expected a folder of images, got"):
        image_files(tmp_path / "nowhere", "calibrate")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match=r"PNG, JPEG or PGM files in .*empty, got none"):
        image_files(tmp_path / "empty", "calibrate")
    with pytest.raises(ValueError, match="images: expected at least 1, got none"):
        int8.quantize_graph(graph, out, [])
    images[1].write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(DataError, match=r"b\.PNG"):
        int8.quantize_graph(graph, out, images)
    assert not out.exists()
    int8.quantize_graph(graph, out, images[:1])
    with pytest.raises(ValueError, match="graph: expected float32, got int8"):
        int8.quantize_graph(out, tmp_path / "again.onnx", images[:1])


def rewrite(graph, model):
    checksum = [entry for entry in model.metadata_props if entry.key == "ffpose_sha256"]
    model.metadata_props.remove(*checksum)
    graph.write_bytes(sealed(model.SerializeToString()))


def test_a_weight_that_two_nodes_share_is_copied(graph, images, tmp_path):
    """ONNX Runtime cannot load shared ones where the CPU has no VNNI."""
    model = onnx.load(graph)
    mixing = np.random.default_rng(2).normal(size=(SIZE[1], SIZE[1])).astype(np.float32)
    model.graph.initializer.append(onnx.numpy_helper.from_array(mixing, "mixing"))
    maps, *others = model.graph.node
    others[0].input[0] = "sum"
    added = [
        node("Conv", ["images", "kernel"], "maps_again", ["backbone"], auto_pad="SAME_UPPER"),
        node("Relu", ["maps_again"], "bright_again", ["backbone"]),
        node("MatMul", ["maps", "mixing"], "mixed", ["backbone"]),
        node("MatMul", ["bright_again", "mixing"], "mixed_again", ["backbone"]),
        onnx.helper.make_node("Add", ["mixed", "mixed_again"], ["sum"]),
    ]
    del model.graph.node[:]
    model.graph.node.extend([maps, *added, *others])
    rewrite(graph, model)
    out = tmp_path / "int8.onnx"
    assert int8.quantize_graph(graph, out, images).nodes == 4
    weights = {
        each.name
        for each in onnx.load(out).graph.initializer
        if each.data_type == onnx.TensorProto.INT8 and len(each.dims) > 1
    }
    read = [name for each in onnx.load(out).graph.node for name in each.input if name in weights]
    assert sorted(read) == sorted(weights)
    assert len(weights) == 4


def test_a_matrix_on_the_left_stays_float(graph, images, tmp_path):
    """ONNX Runtime before 1.32 refuses the scales of its channels."""
    model = onnx.load(graph)
    mixing = np.random.default_rng(2).normal(size=(SIZE[0], SIZE[0])).astype(np.float32)
    model.graph.initializer.append(onnx.numpy_helper.from_array(mixing, "mixing"))
    maps, bright, *others = model.graph.node
    bright.input[0] = "mixed"
    del model.graph.node[:]
    mixed = node("MatMul", ["mixing", "maps"], "mixed", ["backbone"])
    model.graph.node.extend([maps, mixed, bright, *others])
    rewrite(graph, model)
    out = tmp_path / "int8.onnx"
    assert int8.quantize_graph(graph, out, images).nodes == 1
    kept = {each.name: each.data_type for each in onnx.load(out).graph.initializer}
    assert kept["mixing"] == onnx.TensorProto.FLOAT


def test_a_relu_leaves_all_steps_to_what_is_positive(graph, images, tmp_path):
    """Between it and its convolution nothing is quantized, so ONNX Runtime makes one node."""
    out = tmp_path / "int8.onnx"
    int8.quantize_graph(graph, out, images)
    model = onnx.load(out)
    (convolution,) = (node for node in model.graph.node if node.op_type == "Conv")
    (reader,) = (node for node in model.graph.node if convolution.output[0] in node.input)
    values = {each.name: onnx.numpy_helper.to_array(each) for each in model.graph.initializer}
    assert reader.op_type == "QuantizeLinear"
    assert values[reader.input[2]] == 0  # so what is negative becomes 0
    assert "Relu" not in {node.op_type for node in model.graph.node}


def test_a_product_writes_float32_and_one_of_few_weights_stays_as_it_is(graph, images, tmp_path):
    model = onnx.load(graph)
    mixing = np.random.default_rng(2).normal(size=(SIZE[1], SIZE[1])).astype(np.float32)
    few = np.ones((SIZE[1], 3), np.float32)
    for name, value in (("mixing", mixing), ("few", few)):
        model.graph.initializer.append(onnx.numpy_helper.from_array(value, name))
    maps, bright, *others = model.graph.node
    others[0].input[0] = "narrow"
    del model.graph.node[:]
    added = [
        node("MatMul", ["bright", "mixing"], "mixed", ["backbone"]),
        node("MatMul", ["mixed", "few"], "narrow", ["backbone"]),
    ]
    model.graph.node.extend([maps, bright, *added, *others])
    rewrite(graph, model)
    out = tmp_path / "int8.onnx"
    assert int8.quantize_graph(graph, out, images).nodes == 2
    narrow = next(node for node in onnx.load(out).graph.node if "few" in node.input)
    assert list(narrow.input) == ["mixed", "few"]


def test_a_graph_without_a_backbone_is_refused(graph, images, tmp_path):
    model = onnx.load(graph)
    for each in model.graph.node:
        del each.metadata_props[:]
    rewrite(graph, model)
    with pytest.raises(RuntimeError, match="int8: expected a graph with Conv, Gemm, MatMul"):
        int8.quantize_graph(graph, tmp_path / "int8.onnx", images)


@pytest.mark.parametrize("words", [["--int8"], ["--calibrate", "images"]])
def test_int8_and_calibrate_belong_together(words, capsys):
    assert main(["export", "soyuz", "--out", "a.onnx", *words]) == 2
    assert "int8: expected with --calibrate DIR, both or neither" in capsys.readouterr().err


@pytest.mark.skipif(not has_vnni(), reason="this processor's sums of int8 products saturate")
def test_sums_are_the_same_with_vnni_and_with_the_kernels_that_do_without(
    graph, images, tmp_path, monkeypatch
):
    """Their arithmetic is in whole numbers."""
    out = tmp_path / "int8.onnx"
    int8.quantize_graph(graph, out, images)
    estimate = load(out)
    found = estimate(images[0])
    monkeypatch.setattr("ffpose.onnx.backends.has_vnni", lambda: False)
    assert load(out)(images[0]) == found


@pytest.mark.parametrize("has", [True, False])
def test_the_precise_mode_is_for_processors_without_vnni(graph, monkeypatch, has):
    monkeypatch.setattr("ffpose.onnx.backends.has_vnni", lambda: has)
    options = load(graph).session.session.get_session_options()
    if has:
        with pytest.raises(RuntimeError, match="x64quantprecision"):
            options.get_session_config_entry("session.x64quantprecision")
    else:
        assert options.get_session_config_entry("session.x64quantprecision") == "1"


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="Linux tells them there")
def test_vnni_is_what_linux_says():
    flags = Path("/proc/cpuinfo").read_text().split()
    assert has_vnni() == ("avx512_vnni" in flags or "avx_vnni" in flags)
