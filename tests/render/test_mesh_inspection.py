"""A mesh is described before it is learned: what it measures, and what may be wrong with it."""

import json
import math
import re

import numpy as np
import pytest
import trimesh
from PIL import Image

from ffpose.cli import main
from ffpose.geometry.symmetry import IDENTITY
from ffpose.render import inspection, load_craft
from ffpose.render.inspection import (
    DIRECTIONS,
    TILE,
    _view,
    find_doubts,
    inspect_mesh,
    is_y_up,
    studio_view,
)
from ffpose.render.spacecraft.craft import bounding_sphere
from ffpose.render.symmetry import Symmetries


def write_box(folder, size=(2.0, 1.0, 0.5), shift=(0.0, 0.0, 0.0), invert=False, drop=0):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(shift)
    if invert:
        mesh.invert()
    if drop:
        mesh.update_faces(np.arange(12) >= drop)
    path = folder / "box.ply"
    mesh.export(path)
    return path


@pytest.fixture
def described(monkeypatch):
    """Nothing is searched for symmetries, or drawn, of which the first test has all."""
    monkeypatch.setattr(inspection, "find_symmetries", lambda _: Symmetries(IDENTITY, [], []))
    monkeypatch.setattr(inspection, "view_sheet", lambda *_: Image.new("RGB", (1, 1)))


def doubts(folder, scale=1.0, **box):
    summary = inspect_mesh(load_craft(write_box(folder, **box), scale), folder / "out")
    return " ".join(summary["doubts"])


def test_a_sound_mesh_is_measured_and_not_doubted(tmp_path):
    summary = inspect_mesh(load_craft(write_box(tmp_path)), tmp_path / "out")
    np.testing.assert_allclose(summary["size_m"], (2, 1, 0.5))
    assert summary["triangles"] == 12
    assert summary["radius_m"] == pytest.approx(np.linalg.norm((1, 0.5, 0.25)), rel=2e-3)
    assert summary["origin_offset_m"] == pytest.approx(0, abs=5e-3)
    assert summary["inside_seen"] == 0
    assert summary["doubts"] == []
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == summary
    with Image.open(tmp_path / "out" / "views.png") as sheet:
        assert sheet.width == 4 * TILE
        assert len(DIRECTIONS) == 12


@pytest.mark.usefixtures("described")
def test_colors_of_faces_are_those_of_their_material(tmp_path):
    """Half of the faces red, half white: sRGB codes of 255 and 0 are light of 1 and 0."""
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    mesh.visual.face_colors = np.where(np.arange(12)[:, None] < 6, (255, 0, 0, 255), (255,) * 4)
    mesh.export(tmp_path / "box.ply")
    (material,) = inspect_mesh(load_craft(tmp_path / "box.ply"), tmp_path / "out")["materials"]
    np.testing.assert_allclose(material["color"], (1, 0.5, 0.5))


@pytest.mark.usefixtures("described")
@pytest.mark.parametrize(
    ("box", "scale", "doubt"),
    [
        ({}, 1000.0, r"2\.29e\+03 m across.*--mesh-scale 0\.001 .*millimeters"),
        ({}, 200.0, r"0\.001 makes it 0\.458 m .* 0\.0254 makes it 11\.6 m if .* in inches"),
        ({}, 0.001, r"0\.00229 m across.*--mesh-scale \d+"),
        ({"shift": (90.0, 0, 0)}, 1.0, r"origin lies 90 m.*--mesh-center"),
        ({"invert": True}, 1.0, "most faces are inside out: 100%"),
        ({"drop": 4}, 1.0, r"faces are inside out or missing: \d+%"),
    ],
)
def test_what_is_doubtful_is_said(tmp_path, box, scale, doubt):
    assert re.search(doubt, doubts(tmp_path, scale, **box))


@pytest.mark.parametrize(
    ("name", "up", "said"),
    [("a.glb", "z", True), ("a.GLTF", "z", True), ("a.glb", "y", False), ("a.obj", "z", False)],
)
def test_a_format_whose_y_is_up_is_doubted(tmp_path, name, up, said):
    trimesh.creation.box((2, 1, 1)).export(tmp_path / "box.ply")
    y_up = is_y_up(tmp_path / name, up)
    found = find_doubts(load_craft(tmp_path / "box.ply"), y_up=y_up)
    assert ("--mesh-up y" in " ".join(found)) == y_up == said


@pytest.mark.usefixtures("described")
def test_the_share_of_the_disk_is_that_of_the_silhouette(tmp_path):
    """Views along the edges of a unit cube show 1, those along its diagonals the root of 3."""
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "cube.ply")
    share = inspect_mesh(load_craft(tmp_path / "cube.ply"), tmp_path / "out")["disk_seen"]
    assert share == pytest.approx((1 + 3**0.5) / 2 / (math.pi * 0.75), rel=0.1)  # perspective


@pytest.mark.usefixtures("described")
@pytest.mark.parametrize(("far", "said"), [(200.0, True), (10.0, False)])
def test_parts_that_widen_the_bounding_sphere_are_doubted(tmp_path, far, said):
    """A cube of a meter and a grain that is so far away."""
    box, grain = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((0.01, 0.01, 0.01))
    grain.apply_translation((far, 0, 0))
    trimesh.util.concatenate([box, grain]).export(tmp_path / "box.ply")
    summary = inspect_mesh(load_craft(tmp_path / "box.ply"), tmp_path / "out")
    assert ("--distance NEAR FAR" in " ".join(summary["doubts"])) == said


@pytest.mark.usefixtures("described")
@pytest.mark.parametrize(("alpha", "said"), [(0.75, True), (1.0, False)])
def test_a_spacecraft_that_one_sees_through_is_doubted(tmp_path, alpha, said):
    """Models drawn as holograms have such materials."""
    path = tmp_path / "box.obj"
    text = trimesh.exchange.obj.export_obj(trimesh.creation.box((2, 1, 0.5)))
    path.write_text("mtllib box.mtl\nusemtl glass\n" + text)
    (tmp_path / "box.mtl").write_text(f"newmtl glass\nKd 0.2 0.5 0.8\nd {alpha}\n")
    doubts = " ".join(inspect_mesh(load_craft(path), tmp_path / "out")["doubts"])
    assert ("12 of 12 triangles are of materials that one sees through" in doubts) == said


def test_the_bounding_sphere_holds_all_and_is_the_least():
    rng = np.random.default_rng(0)
    for _ in range(5):
        axis = rng.standard_normal(3)
        ends = np.stack([axis, -axis]) + np.array([1, 2, 3])
        inner = (1, 2, 3) + 0.5 * np.linalg.norm(axis) * rng.uniform(-1, 1, (500, 3)) / 3**0.5
        center, radius = bounding_sphere(np.concatenate([inner, ends]))
        np.testing.assert_allclose(center, (1, 2, 3), atol=2e-3 * np.linalg.norm(axis))
        assert radius == pytest.approx(np.linalg.norm(axis), rel=2e-3)


def test_a_view_shows_the_side_that_its_name_says(tmp_path):
    """A box with one red end: it fills the view from +x, and is not seen from −x."""
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    end = mesh.triangles_center[:, 0] > 0.49
    mesh.visual.face_colors = np.where(end[:, None], (230, 20, 20, 255), (20, 20, 230, 255))
    mesh.export(tmp_path / "box.ply")
    craft = load_craft(tmp_path / "box.ply")
    for name, red in (("+x", True), ("-x", False)):
        pose, camera = _view(name, np.zeros(3), 0.87)
        pixel = studio_view(craft, pose, camera)[TILE // 2, TILE // 2].astype(int)
        assert (pixel[0] > pixel[2]) == red


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    path = write_box(tmp_path, shift=(9.0, 0, 0))
    assert main(["inspect", str(path), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "size: 2 x 1 x 0.5 m" in shown
    assert "--mesh-center" in shown
    words = ["inspect", str(path), "--out", str(tmp_path / "out"), "--mesh-center", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["doubts"] == []
    assert main(["inspect", "--out", str(tmp_path / "out")]) == 2
    assert "expected a mesh file, or --data.kind" in capsys.readouterr().err


def test_a_spacecraft_that_is_invisible_is_doubted_and_not_symmetric(tmp_path):
    mesh = trimesh.creation.box((2.0, 1.0, 0.5))
    mesh.visual = trimesh.visual.TextureVisuals(
        np.zeros((8, 2)),
        trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.new("RGBA", (2, 2), (255, 255, 255, 0)), alphaMode="BLEND"
        ),
    )
    mesh.export(tmp_path / "box.glb")
    summary = inspect_mesh(load_craft(tmp_path / "box.glb"), tmp_path / "out")
    assert summary["disk_seen"] == 0
    assert summary["symmetry"] is None
    assert "covers 0.0%" in summary["doubts"][0]
    assert "transparent" in summary["doubts"][-1]
