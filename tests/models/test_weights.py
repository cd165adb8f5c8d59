"""Weights on disk: what is written comes back, and anything else is refused with the reason."""

import hashlib
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

import ffpose
from ffpose import DataError
from ffpose._internal import zoo
from ffpose.geometry import URSO_CAMERA, Camera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import (
    FilterformerPose,
    PoseNetConfig,
    WeightsMetadata,
    load_network,
    read_metadata,
)
from ffpose.models import weights as files
from ffpose.models.registry import open_weights
from ffpose.models.weights import checksum_path, copy_weights, load_weights

FIELDS = {
    "backbone": "test_efficientnet",
    "image_size": (64, 96),
    "dim": 16,
    "depth": 1,
    "heads": 2,
    "translation_mean": (0.1, 0.2, 1 / 3),
}
PREPROCESSING = Preprocessing(size=(64, 96), mode="center_crop", mean=(0.1, 0.2, 0.3))


def build(**fields):
    return FilterformerPose.from_config("tiny", backbone_weights="none", **(FIELDS | fields))


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = build()
    model(torch.randn(4, 3, 64, 96))  # moves the batch norm's statistics
    return model.eval()


@pytest.fixture
def path(model, tmp_path):
    path = tmp_path / "weights.safetensors"
    model.save_pretrained(path, preprocessing=PREPROCESSING)
    return path


def test_float16_keeps_tensors_beyond_its_range(tmp_path):
    """Its largest number is 65,504: variances of batch norms may be larger."""
    model, path = build().eval(), tmp_path / "half.safetensors"
    names = [name for name, _ in model.named_buffers() if name.endswith("running_var")]
    model.get_buffer(names[0]).fill_(70_000.0)
    model.save_pretrained(path, dtype=torch.float16)
    saved = load_file(path)
    assert [saved[name].dtype for name in names[:2]] == [torch.float32, torch.float16]
    read = load_network(path).get_buffer(names[0])
    torch.testing.assert_close(read, model.get_buffer(names[0]), rtol=0, atol=0)


def rewrite_header(path, change):
    """Change the metadata of a safetensors file, and give it the checksum that it then has."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    change(header["__metadata__"])
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
    sign(path)


def sign(path):
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    checksum_path(path).write_text(f"{digest}  {path.name}\n")


def test_there_and_back(model, path):
    loaded = FilterformerPose.from_pretrained(path)
    assert not loaded.training
    assert loaded.config == model.config
    images = torch.randn(2, 3, 64, 96)
    for got, expected in zip(loaded(images), model(images), strict=True):
        assert torch.equal(got, expected)


@pytest.mark.parametrize("linked", [(), (".sha256",)], ids=["weights", "checksum too"])
def test_weights_written_through_a_link_are_those_of_both_names(model, path, tmp_path, linked):
    link = tmp_path / "link.safetensors"
    for suffix in ("", *linked):
        Path(f"{link}{suffix}").symlink_to(f"{path.name}{suffix}")
    model.save_pretrained(link, preprocessing=replace(PREPROCESSING, mode="resize"))
    assert link.is_symlink()
    for each in (path, link):
        assert read_metadata(each).preprocessing.mode == "resize"
        FilterformerPose.from_pretrained(each)  # which verifies the checksum
    names = [checksum_path(each).read_text().split()[1] for each in (path, link)]
    assert names == [path.name, path.name if linked else link.name]


def test_metadata(model, path):
    metadata = read_metadata(path)
    assert metadata.config == model.config
    assert metadata.preprocessing == PREPROCESSING
    assert metadata.version == ffpose.__version__


ORIGIN = {
    "backbone_source": {"name": "test_efficientnet", "source": "file.pt", "sha256": "ab" * 32},
    "recipe": {"loss": {"s_t": -3.0}, "stages": [{"name": "joint", "epochs": 2}], "seed": 7},
    "data": {"kind": "urso", "count": 10, "digest": "cd" * 32, "image_size": [480, 640]},
    "in_view_threshold": 0.25,
}


def test_the_header_tells_where_the_weights_come_from(model, tmp_path):
    path = tmp_path / "w.safetensors"
    model.save_pretrained(path, **ORIGIN)
    metadata = read_metadata(path)
    assert {name: getattr(metadata, name) for name in ORIGIN} == ORIGIN
    assert metadata.config.architecture == "FilterformerPose"
    with safe_open(path, framework="numpy") as file:
        assert file.metadata()["format"] == "4"
        assert file.metadata()["architecture"] == "FilterformerPose"
        assert json.loads(file.metadata()["recipe"]) == ORIGIN["recipe"]


def test_what_is_not_told_is_not_known(path):
    metadata = read_metadata(path)
    assert [getattr(metadata, name) for name in ORIGIN] == [None] * 4
    assert metadata.camera is None


@pytest.mark.parametrize(
    ("fields", "error", "text"),
    [
        ({"in_view_threshold": 1.5}, ValueError, "in_view_threshold: expected a probability"),
        ({"in_view_threshold": float("nan")}, ValueError, "expected a probability, got nan"),
        ({"data": {"image_size": [640]}}, ValueError, r"image_size \[height, width\], got \[640\]"),
        ({"data": {"image_size": [0, 480]}}, ValueError, r"got \[0, 480\]"),
        ({"recipe": {"rate": float("inf")}}, ValueError, "not JSON compliant"),
        ({"recipe": {"seed": torch.ones(1)}}, TypeError, "not JSON serializable"),
    ],
)
def test_an_origin_that_cannot_be_is_not_written(model, tmp_path, fields, error, text):
    with pytest.raises(error, match=text):
        model.save_pretrained(tmp_path / "w.safetensors", **fields)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", ["resize", "center_crop"])
def test_the_camera_is_that_of_the_images_trained_on(model, tmp_path, mode):
    """64 x 96 pixels of URSO's 1280x960, worked out by hand."""
    preprocessing = Preprocessing(size=(64, 96), mode=mode)
    view = preprocessing.camera(URSO_CAMERA)
    seen = (96 / 1280 if mode == "resize" else 96 * 256 / 224 / 1280) * 640
    assert view.fx == pytest.approx(seen, rel=0.01)
    config = replace(model.config, camera=(view.fx, view.fy, view.cx, view.cy))
    data = {"image_size": [480, 640]}
    got = WeightsMetadata(config, preprocessing, data=data).camera
    assert (got.width, got.height) == (640, 480)
    np.testing.assert_allclose(
        [got.fx, got.fy, got.cx, got.cy], [320.0, 320.2315, 320.0, 240.0], rtol=1e-12
    )


def test_images_of_unknown_size_have_the_inputs_shape(model):
    config = replace(model.config, camera=(50.0, 51.0, 48.0, 32.0))
    metadata = WeightsMetadata(config, Preprocessing(size=(64, 96)))
    assert metadata.camera == Camera(96, 64, 50.0, 51.0, 48.0, 32.0)


def test_a_copy_has_a_checksum_of_its_own(path, tmp_path):
    """Whatever became of that of the original."""
    checksum_path(path).unlink()
    copy = tmp_path / "copy.safetensors"
    checksum_path(copy).write_text("of another file\n")
    copy_weights(path, copy)
    assert copy.read_bytes() == path.read_bytes()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert checksum_path(copy).read_text() == f"{digest}  copy.safetensors\n"


def test_checksum_is_that_of_sha256sum(path):
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert checksum_path(path).read_text() == f"{expected}  weights.safetensors\n"
    assert sorted(each.name for each in path.parent.iterdir()) == [
        "weights.safetensors",
        "weights.safetensors.sha256",
    ]


def test_the_same_weights_are_the_same_bytes(model, path):
    """The checksum of two equal trainings is one; safetensors shuffles the metadata."""
    before = path.read_bytes()
    for _ in range(5):
        model.save_pretrained(path, preprocessing=PREPROCESSING)
        assert path.read_bytes() == before


def test_any_safetensors_reader_reads_it(model, path):
    with safe_open(path, framework="numpy") as file:
        assert set(file.keys()) == set(model.state_dict())
        assert json.loads(file.metadata()["config"])["backbone"] == "test_efficientnet"


def test_a_resize_as_the_backbone_expects_is_recorded_by_default(model, tmp_path):
    model.save_pretrained(tmp_path / "w.safetensors")
    expected = Preprocessing(size=(64, 96), interpolation="bicubic")  # and ImageNet's statistics
    assert read_metadata(tmp_path / "w.safetensors").preprocessing == expected


def test_preprocessing_of_another_size(model, tmp_path):
    with pytest.raises(ValueError, match=r"expected size \(64, 96\), got \(96, 64\)"):
        model.save_pretrained(
            tmp_path / "w.safetensors", preprocessing=replace(PREPROCESSING, size=(96, 64))
        )


def test_overwriting_replaces_both_files(model, path):
    with torch.no_grad():
        other = build()
    other.save_pretrained(path)
    assert FilterformerPose.from_pretrained(path).config == other.config


def test_a_write_that_fails_leaves_the_old_file(model, path, monkeypatch):
    def fail(*_args, **_kwargs):
        raise OSError("disk full")

    monkeypatch.setattr("pathlib.Path.write_bytes", fail)
    with pytest.raises(OSError, match="disk full"):
        model.save_pretrained(path)
    monkeypatch.undo()
    FilterformerPose.from_pretrained(path)
    assert len(list(path.parent.iterdir())) == 2


def test_missing_file(tmp_path):
    for function in (FilterformerPose.from_pretrained, read_metadata):
        with pytest.raises(FileNotFoundError, match="none"):
            function(tmp_path / "none.safetensors")


@pytest.mark.parametrize("keep", [0, 4, 100, 0.5, -1])
def test_truncated(path, keep):
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(DataError, match=r"weights\.safetensors: expected .* truncated"):
        FilterformerPose.from_pretrained(path)


@pytest.mark.parametrize("place", [-1, 0.6])
def test_altered(path, place):
    data = bytearray(path.read_bytes())
    data[place if place == -1 else int(place * len(data))] ^= 1
    path.write_bytes(data)
    with pytest.raises(DataError, match="the file was altered: expected SHA-256"):
        FilterformerPose.from_pretrained(path)


@pytest.mark.parametrize("text", ["", "nonsense", "\xff\n"])
def test_checksum_that_is_none(path, text):
    checksum_path(path).write_text(text, encoding="latin-1")
    with pytest.raises(DataError):
        FilterformerPose.from_pretrained(path)


def test_missing_checksum_is_said(path, caplog):
    checksum_path(path).unlink()
    FilterformerPose.from_pretrained(path)
    assert "not verified, there is no weights.safetensors.sha256" in caplog.text


@pytest.mark.parametrize("other", ["3", "5"])
def test_another_format(other, path):
    rewrite_header(path, lambda header: header.update(format=other, ffpose_version="9.0"))
    with pytest.raises(DataError, match=rf"format 4.*got format {other}.*ffpose 9\.0"):
        FilterformerPose.from_pretrained(path)


@pytest.mark.parametrize("name", zoo.names())
def test_shipped_weights_know_images_of_landscape_format(name):
    """They were trained on images of URSO's camera: 4 : 3, and 90 degrees across."""
    metadata = read_metadata(name)
    height, width = metadata.data["image_size"]
    assert 4 * height == 3 * width
    assert (metadata.camera.width, metadata.camera.height) == (width, height)
    assert metadata.camera.fx == metadata.camera.cx == width / 2
    assert metadata.preprocessing.size == (384, 512)


def test_weights_of_another_network(path):
    config = PoseNetConfig().to_json()
    rewrite_header(path, lambda header: header.update(architecture="PoseNet", config=config))
    with pytest.raises(DataError, match=r"expected weights of a FilterformerPose, got .* PoseNet"):
        FilterformerPose.from_pretrained(path)


def test_weights_of_an_unknown_network_are_told_the_names(path):
    rewrite_header(path, lambda header: header.update(architecture="HyperPose"))
    with pytest.raises(DataError, match=r"one of FilterformerPose, .*, PoseNet, .*HyperPose"):
        load_network(path)


def test_safetensors_of_someone_else(path):
    rewrite_header(path, lambda header: header.clear())
    with pytest.raises(DataError, match="expected weights written by ffpose"):
        FilterformerPose.from_pretrained(path)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("config", "{", "header"),
        ("config", '{"depht": 1}', "depht"),
        ("config", '{"depth": "many"}', "depth"),
        ("config", '{"backbone": "no_such_model"}', "no_such_model"),
        ("recipe", "[1]", r"recipe: expected a JSON object, got \[1\]"),
        ("recipe", "{", "header"),
        ("data", '{"image_size": "large"}', "image_size"),
        ("data", '"none"', "data: expected a JSON object, got 'none'"),
        ("backbone_source", '"timm"', "backbone_source: expected a JSON object"),
        ("in_view_threshold", "2", "expected a probability"),
        ("in_view_threshold", '"high"', "header"),
        ("preprocessing", "[]", "header"),
        ("preprocessing", "{}", "header"),
        ("preprocessing", '{"size": "large"}', "header"),
    ],
)
def test_header_that_makes_no_sense(path, key, value, text):
    rewrite_header(path, lambda header: header.update({key: value}))
    with pytest.raises(DataError, match=text):
        FilterformerPose.from_pretrained(path)


@pytest.mark.parametrize("name", ["config", "recipe"])
def test_header_without_an_entry(path, name):
    rewrite_header(path, lambda header: header.pop(name))
    with pytest.raises(DataError, match=name):
        read_metadata(path)


def test_another_architecture_names_the_differences(path):
    with pytest.raises(DataError, match=r"orientation_branch\.encoder.* is missing"):
        load_weights(path, build(depth=2))
    with pytest.raises(DataError, match=r"has shape \(16,\), expected \(32,\)"):
        load_weights(path, build(dim=32))
    with pytest.raises(DataError, match=r"pose_token is unknown"):
        load_weights(path, build(pooling="mean"))


def test_refused_weights_change_nothing(path):
    model = build(depth=2)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with pytest.raises(DataError):
        load_weights(path, model)
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_a_header_is_read_once(tmp_path, monkeypatch):
    model = FilterformerPose.from_config("tiny", backbone_weights="none", depth=1)
    model.save_pretrained(tmp_path / "a.safetensors")
    opened, safe_open = [], files.safe_open

    def counted(path, **options):
        opened.append(path)
        return safe_open(path, **options)

    monkeypatch.setattr(files, "safe_open", counted)
    found, metadata = open_weights(tmp_path / "a.safetensors")
    assert opened == [tmp_path / "a.safetensors"]
    assert metadata.config == found.config
