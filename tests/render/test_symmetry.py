"""Turns that leave the look the same are found from the looks: of shapes whose groups are known."""

from functools import partial

import numpy as np
import pytest
import trimesh
from trimesh.creation import box, cylinder, icosphere

from ffpose.geometry.symmetry import STEPS, Axis
from ffpose.render import load_craft
from ffpose.render.symmetry import Symmetry, _sorted, find_symmetries


def craft_of(folder, *parts):
    path = folder / "craft.ply"
    trimesh.util.concatenate(list(parts)).export(path)
    return load_craft(path)


def moved(mesh, shift):
    mesh.apply_translation(shift)
    return mesh


def turned(mesh):
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.5, 0.7))
    return mesh


SHAPES = {
    "a plain box": (lambda: [box((2, 1, 0.5))], 4),
    "a bus with two wings": (lambda: [box((1, 1, 1.5)), box((0.1, 6, 1))], 4),
    "a cube": (lambda: [box((1, 1, 1))], 24),
    "a cube that lies askew": (lambda: [turned(box((1, 1, 1)))], 24),
    "a cylinder": (lambda: [cylinder(0.5, 2, sections=128)], 2 * STEPS),
    "a cylinder with a nose": (
        lambda: [cylinder(0.5, 2, sections=128), moved(box((0.2, 0.2, 0.2)), (0, 0, 1.1))],
        4,
    ),
    **{
        f"{n} sides": (partial(lambda n: [cylinder(0.5, 2, sections=n)], n), 2 * n)
        for n in (5, 7, 8)
    },
    "a bus with one wing": (
        lambda: [box((2, 1, 1)), moved(box((0.6, 3, 0.05)), (0.3, 1.5, 0.2))],
        1,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_the_group_of_a_shape(tmp_path, shape):
    parts, count = SHAPES[shape]
    assert len(find_symmetries(craft_of(tmp_path, *parts())).group) == count


@pytest.mark.slow
@pytest.mark.parametrize(("side", "told"), [(0.06, True), (0.1, True), (0.2, False)])
def test_a_mark_on_one_side_breaks_it_and_is_told_where_it_is_small(tmp_path, side, told):
    """A dark plate on one end: half turns about the axis through it remain."""
    cube = box((1, 1, 1))
    cube.visual.face_colors = (200, 200, 200, 255)
    mark = moved(box((0.02, side, side)), (0.5, 0, 0))
    mark.visual.face_colors = (10, 10, 10, 255)
    found = find_symmetries(craft_of(tmp_path, cube, mark))
    assert len(found.group) == 4
    assert abs(found.group.axes[0].unit[0]) == pytest.approx(1)
    near = [each for each in found.near if abs(each.axis.unit[0]) < 0.1]
    assert bool(near) == told
    assert all(each.noise > 1 and each.contrast < 0.5 for each in near)


@pytest.mark.parametrize(("contrast", "told"), [(0.1, [2, 4]), (0.35, [4])])
def test_fewer_turns_are_told_beside_more_where_they_leave_the_look_more_alike(contrast, told):
    found = [
        Symmetry(Axis((0.0, 0.0, 1.0), fold), 5.0, differs, 0.0)
        for fold, differs in ((4, 0.4), (2, contrast))
    ]
    assert sorted(each.axis.fold for each in _sorted(found).near) == told


def test_an_axis_beside_the_origin_is_told_and_not_folded(tmp_path):
    found = find_symmetries(craft_of(tmp_path, moved(box((2, 1, 0.5)), (0, 0, 1))))
    assert len(found.group) == 2
    assert found.group.axes[0].unit == pytest.approx((0, 0, 1))
    assert len(found.near) == 2
    assert [each.offset_m for each in found.near] == pytest.approx([1.0, 1.0])


def test_a_sphere_has_no_attitude(tmp_path):
    with pytest.raises(ValueError, match="looks the same from all sides, as a sphere"):
        find_symmetries(craft_of(tmp_path, icosphere(subdivisions=4)))


def test_a_flat_mesh_is_refused(tmp_path):
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(ValueError, match="mesh: expected a spacecraft of some depth"):
        find_symmetries(craft_of(tmp_path, triangle))


def test_what_is_written_says_what_was_found(tmp_path):
    document = find_symmetries(craft_of(tmp_path, box((2, 1, 0.5)))).to_json()
    assert [each["fold"] for each in document["axes"]] == [2, 2]
    assert document["near"] == []
    for each in document["same"]:
        assert np.linalg.norm(each["axis"]) == pytest.approx(1)
        assert each["noise"] <= 1
        assert each["offset_m"] == 0
