"""The attitude and the twist of the camera: none by cells of the last map, on any weights."""

import pytest
import torch

from benchmarks import twist
from benchmarks.__main__ import main
from ffpose.models import build_network
from polar_networks import CELL, build_polar


@pytest.fixture
def model():
    return build_polar(first_channels=64)  # by whose draws a twist shows well


def test_a_twist_by_cells_changes_nothing_and_another_something(model):
    coarse = torch.rand(1, 3, 12, 16, generator=torch.Generator().manual_seed(1))
    image = torch.nn.functional.interpolate(coarse, (96, 128), mode="bicubic")
    point = torch.tensor([1.0, -2.0, 14.0])
    cells = twist.changes(model, image, point, torch.tensor([1.0, 5.0, 11.0]) * CELL)
    between = twist.changes(model, image, point, torch.tensor([0.3, 4.5]) * CELL)
    assert set(cells) == {"attitude", "in-plane", "out-of-plane"}
    for part, values in cells.items():
        assert values.max() < 0.05, part
    assert between["attitude"].min() > 2 * cells["attitude"].max()


def test_a_twist_by_half_a_cell_exchanges_two_looks(model):
    """Their mean stays, on any weights, where either look alone changes."""
    image = torch.rand(1, 3, 96, 128, generator=torch.Generator().manual_seed(1))
    point, half = torch.tensor([1.0, -2.0, 14.0]), torch.tensor([0.5, 3.5]) * CELL
    assert twist.changes(model, image, point, half, looks=2)["attitude"].max() < 0.05
    assert twist.changes(model, image, point, half)["attitude"].min() > 0.5


def test_quantiles_are_printed(model, tmp_path, capsys):
    weights = tmp_path / "own.safetensors"
    model.save_pretrained(weights)
    assert main(["twist", str(weights), "--count", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["attitude", "in-plane", "out-of-plane"]


def test_another_network_is_refused(tmp_path, capsys):
    weights = tmp_path / "tiny.safetensors"
    fields = {"image_size": (64, 64), "backbone": "test_efficientnet"}
    build_network("tiny", backbone_weights="none", **fields).save_pretrained(weights)
    assert main(["twist", str(weights)]) == 1
    assert "expected a PolarPose, got FilterformerPose" in capsys.readouterr().err
