"""The configuration: readings of the paper, checks, JSON."""

from dataclasses import asdict, fields, replace
from inspect import getdoc

import pytest

from ffpose.models import CONFIGS, FilterformerPoseConfig


def test_base_is_the_paper():
    base = CONFIGS["base"]
    assert base == FilterformerPoseConfig()
    assert base.image_size == (224, 224)  # section 4.3
    assert base.depth == 7  # Table 2
    assert (base.translation_mlp_dim, base.orientation_mlp_dim) == (128, 256)  # Table 1
    assert base.filter == "tokens"  # Eq. 1-3
    assert base.grid(base.translation_reduction) == (14, 14)  # section 3.1
    assert base.grid(base.orientation_reduction) == (28, 28)


@pytest.mark.parametrize("name", CONFIGS)
def test_json_there_and_back(name):
    config = replace(CONFIGS[name], translation_mean=(0.1, 0.2, 1 / 3))
    assert FilterformerPoseConfig.from_json(config.to_json()) == config


def test_lists_become_tuples():
    config = FilterformerPoseConfig.from_json('{"image_size": [64, 96]}')
    assert config.image_size == (64, 96)
    hash(config)


def test_a_grid_covers_the_image():
    assert replace(CONFIGS["base"], image_size=(97, 128)).grid(16) == (7, 8)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("filter", "fourier", r"filter: expected one of tokens, grid, none"),
        ("norm", "both", "norm: expected one of"),
        ("position", None, "position: expected one of"),
        ("orientation_head", "euler", "orientation_head: expected one of .*, got 'euler'"),
        ("pooling", "max", "pooling: expected one of"),
        ("depth", 0, "depth: expected a whole number, at least 1, got 0"),
        ("dim", 2.5, "dim: expected a whole number, at least 1, got 2.5"),
        ("depth", True, "depth: expected a whole number"),
        ("heads", 3, "heads: expected a divisor of dim 256, got 3"),
        ("dropout", 1.0, "dropout: expected 0 <= dropout < 1, got 1.0"),
        ("dropout", float("nan"), "dropout: expected"),
        ("filter_std", -1.0, "filter_std: expected at least 0"),
        ("bins_width_deg", 0.0, "bins_width_deg: expected a finite number above 0, got 0.0"),
        (
            "bins_width_deg",
            float("inf"),
            "bins_width_deg: expected a finite number above 0, got inf",
        ),
        ("image_size", (224,), r"image_size: expected 2 numbers, got \(224,\)"),
        ("image_size", 224, "image_size: expected 2 numbers, got 224"),
        ("image_size", (224, 8), "image_size: expected each at least 16"),
        ("image_size", (224.5, 224), "image_size: expected whole numbers"),
        ("translation_mean", (0, 0, float("nan")), "translation_mean: expected finite"),
        ("translation_mean", "abc", "translation_mean: expected 3 numbers"),
        ("translation_std", (1, 1, 0), "translation_std: expected finite numbers above 0"),
    ],
)
def test_refused_values(name, value, text):
    with pytest.raises(ValueError, match=text):
        replace(CONFIGS["base"], **{name: value})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "expected a JSON object, got list"),
        ("{", "Expecting property name"),
        ('{"depht": 3}', r"fields out of .*depth.*got depht \(did you mean depth\?\)"),
        ('{"depth": -3}', "depth: expected"),
    ],
)
def test_refused_json(text, message):
    with pytest.raises(ValueError, match=message):
        FilterformerPoseConfig.from_json(text)


def test_every_field_is_saved_and_documented():
    names = {field.name for field in fields(FilterformerPoseConfig)}
    assert set(asdict(CONFIGS["base"])) == names
    text = "\n".join(getdoc(each) or "" for each in FilterformerPoseConfig.__mro__)
    assert all(f"\n    {name}: " in text for name in names)
