"""The attitude and the twist of the camera: none by cells of the last map, on any weights."""

import pytest
import torch

from benchmarks import twist
from benchmarks.__main__ import main
from ffpose.models import build_network, polar_pose
from polar_networks import CELL, build_polar


@pytest.fixture
def model():
    return some(looks=1)


def some(**fields):
    return build_polar(first_channels=64, candidates=1, **fields)  # by whose draws a twist shows


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
    assert "view_at" not in vars(model)


@pytest.mark.parametrize("looks", [2, 3])
def test_a_twist_by_a_part_of_a_cell_permutes_as_many_looks(model, looks, monkeypatch):
    """The mean of looks at one place in one view stays, where each look alone changes."""
    image = torch.rand(1, 3, 96, 128, generator=torch.Generator().manual_seed(1))
    point, parts = torch.tensor([1.0, -2.0, 14.0]), torch.tensor([1, 3 * looks + 1]) * CELL / looks
    monkeypatch.setattr(polar_pose, "FARTHER", 1.0)
    monkeypatch.setattr(polar_pose, "AGREEMENT_DEG", 180.0)
    several = some(looks=looks)
    head = several.orientation_branch
    torch.nn.init.zeros_(head.vectors.weight)
    torch.nn.init.zeros_(head.vectors.bias)
    torch.nn.init.zeros_(head.scalars[-1].weight)
    torch.nn.init.zeros_(head.scalars[-1].bias)
    model.load_state_dict(several.state_dict())
    alone = twist.changes(model, image, point, parts)["attitude"]
    assert alone.min() > 0.5
    assert twist.changes(several, image, point, parts)["attitude"].max() < alone.min() / 5


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
