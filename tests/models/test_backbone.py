"""The backbone's maps, and where its weights come from."""

import hashlib

import pytest
import safetensors.torch
import timm
import torch

from ffpose import DataError
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import backbone_preprocessing, build_backbone

NAME = "test_efficientnet"


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture
def file(tmp_path):
    """Weights of the whole classifier, as they are published."""
    path = tmp_path / "classifier.safetensors"
    safetensors.torch.save_file(timm.create_model(NAME).state_dict(), path)
    return path


def test_the_papers_two_maps():
    backbone = build_backbone("efficientnet_b0", (16, 8)).eval()
    with torch.no_grad():
        maps = backbone(torch.randn(1, 3, 224, 224))
    assert [tuple(each.shape) for each in maps] == [(1, 112, 14, 14), (1, 40, 28, 28)]
    assert backbone.channels == (112, 40)


def test_maps_are_those_of_the_whole_network(file):
    whole = timm.create_model(NAME, features_only=True).eval()
    reductions = whole.feature_info.reduction()
    state = safetensors.torch.load_file(file)
    whole.load_state_dict({name: state[name] for name in whole.state_dict()})
    images = torch.randn(2, 3, 64, 96)
    expected = whole(images)
    maps = build_backbone(NAME, (16, 8), file).eval()(images)
    for reduction, ours in zip((16, 8), maps, strict=True):
        theirs = expected[reductions.index(reduction)]
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def test_one_map_may_be_read_twice():
    backbone = build_backbone(NAME, (16, 16))
    first, second = backbone(torch.randn(2, 3, 64, 96))
    assert first is second


@pytest.mark.parametrize("name", [NAME, "mobilenetv3_small_050", "resnet10t"])
def test_nothing_is_computed_for_nothing(name):
    backbone = build_backbone(name, (16, 8))
    sum(each.sum() for each in backbone(torch.randn(2, 3, 64, 64))).backward()
    assert all(parameter.grad is not None for parameter in backbone.parameters())


def test_unknown_model_and_map():
    with pytest.raises(ValueError, match=r"backbone: expected a model of timm .*efficientnet_b0"):
        build_backbone("efficientnet_b0_5", (16, 8))
    with pytest.raises(ValueError, match=r"gives reductions \[2, 4, 8, 16, 32\], expected \[12\]"):
        build_backbone("efficientnet_b0", (12, 8))


# What images the pretrained weights expect: written on their pages at huggingface.co/timm

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
HALVES = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


@pytest.mark.parametrize(
    ("name", "statistics", "interpolation"),
    [
        ("efficientnet_b0", IMAGENET, "bicubic"),
        ("efficientnet_lite0", IMAGENET, "bicubic"),
        ("mobilenetv4_conv_small_050", HALVES, "bicubic"),
        ("vgg11", IMAGENET, "bilinear"),
        ("a_network_of_ones_own", IMAGENET, "bilinear"),
    ],
)
def test_images_are_prepared_as_the_weights_expect(name, statistics, interpolation):
    preprocessing = backbone_preprocessing(name, (96, 128), "center_crop")
    assert preprocessing == Preprocessing((96, 128), "center_crop", *statistics, interpolation)


# Weights


def same_as(backbone, file):
    state = safetensors.torch.load_file(file)
    return all(
        torch.equal(value, state[name]) for name, value in backbone.features.state_dict().items()
    )


def test_weights_of_a_file(file, tmp_path):
    assert same_as(build_backbone(NAME, (16, 8), file), file)
    assert not same_as(build_backbone(NAME, (16, 8), "none"), file)
    pickled = tmp_path / "classifier.pth"
    torch.save({"state_dict": safetensors.torch.load_file(file)}, pickled)
    assert same_as(build_backbone(NAME, (16, 8), str(pickled)), file)


def test_weights_of_a_network_whose_stages_have_other_names_in_timms_extractor(tmp_path):
    """``stages.0`` of the classifier is ``stages_0`` there."""
    whole = timm.create_model("test_convnext").eval()
    path = tmp_path / "classifier.safetensors"
    safetensors.torch.save_file(whole.state_dict(), path)
    images = torch.randn(2, 3, 64, 96)
    with torch.no_grad():
        (ours,) = build_backbone("test_convnext", (16,), path).eval()(images)
        theirs = whole.stages[2](whole.stages[1](whole.stages[0](whole.stem(images))))
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


def test_file_of_another_model(file):
    with pytest.raises(DataError, match=r"classifier\.safetensors: expected the weights of resnet"):
        build_backbone("resnet10t", (16, 8), file)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        build_backbone(NAME, (16, 8), tmp_path / "none.pth")


@pytest.mark.parametrize("name", ["weights.safetensors", "weights.pth"])
@pytest.mark.parametrize("content", [b"", b"{}", b"\x80\x02junk", b"PK\x03\x04" + bytes(90)])
def test_file_that_cannot_be_read(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match="expected weights that can be read"):
        build_backbone(NAME, (16, 8), tmp_path / name)


def test_pickle_of_something_else(tmp_path):
    for content in ([1, 2], {"weights": [1, 2]}):
        torch.save(content, tmp_path / "list.pth")
        with pytest.raises(DataError, match="a mapping from names to tensors"):
            build_backbone(NAME, (16, 8), tmp_path / "list.pth")


def test_what_was_used_is_told(file):
    """The digest is that of ``sha256sum``; of a file no more than the name, not where it lay."""
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    random, of_file = (build_backbone(NAME, (16, 8), weights) for weights in ("none", file))
    assert random.source == "none"
    assert of_file.source == {"name": NAME, "source": "classifier.safetensors", "sha256": digest}
