"""Weights on disk: what is written comes back, and anything else is refused with the reason."""

import hashlib
import json
import struct
from dataclasses import replace

import pytest
import torch
from safetensors import safe_open

import ffpose
from ffpose import DataError
from ffpose.models import FilterformerPose, read_metadata
from ffpose.models.weights import checksum_path, load_weights
from ffpose.transforms import Preprocessing

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


def test_metadata(model, path):
    metadata = read_metadata(path)
    assert metadata.config == model.config
    assert metadata.preprocessing == PREPROCESSING
    assert metadata.version == ffpose.__version__


def test_checksum_is_that_of_sha256sum(path):
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert checksum_path(path).read_text() == f"{expected}  weights.safetensors\n"
    assert sorted(each.name for each in path.parent.iterdir()) == [
        "weights.safetensors",
        "weights.safetensors.sha256",
    ]


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


def test_newer_format(path):
    rewrite_header(path, lambda header: header.update(format="2", ffpose_version="9.0"))
    with pytest.raises(DataError, match=r"expected weights of format 1.*format 2.*ffpose 9\.0"):
        FilterformerPose.from_pretrained(path)


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
        ("preprocessing", "[]", "header"),
        ("preprocessing", "{}", "header"),
        ("preprocessing", '{"size": "large"}', "header"),
    ],
)
def test_header_that_makes_no_sense(path, key, value, text):
    rewrite_header(path, lambda header: header.update({key: value}))
    with pytest.raises(DataError, match=text):
        FilterformerPose.from_pretrained(path)


def test_header_without_config(path):
    rewrite_header(path, lambda header: header.pop("config"))
    with pytest.raises(DataError, match="config"):
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
