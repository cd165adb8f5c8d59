"""Ray casting and meshes against geometry by hand."""

import numpy as np
import pytest

from ffpose.geometry import Camera, Pose
from ffpose.render.renderer import prepared
from ffpose.render.shading.rays import View, cast_rays, find_window
from ffpose.render.shading.reflection import LIFT_M
from ffpose.render.shading.tracer import Tracer
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh, ball, box, dish, lathe, merge, tube, turn

CAMERA = Camera(64, 48, 32.0, 32.0, 32.0, 24.0)


def depth_image(mesh, pose):
    view = cast_rays(Tracer(mesh), find_window(mesh.vertices, pose, CAMERA), CAMERA, pose, 1)
    return view.hits.distance, view.rays


def test_sphere_distance_is_analytic():
    mesh, pose = ball((0, 0, 0), 1.0, 0, 256), Pose((0.3, -0.2, 6.0), (0.6, 0.8, 0, 0))
    distance, rays = depth_image(mesh, pose)
    eye = -pose.rotation.T @ pose.t
    b = rays.T @ eye
    root = b**2 - (eye @ eye - 1)
    sure = root > 0.02
    assert sure.sum() > 50
    expected = -b - np.sqrt(np.maximum(root, 0))
    np.testing.assert_allclose(distance[sure], expected[sure], atol=3e-3)


def test_box_distance_is_analytic():
    mesh, pose = box((2, 2, 2), 0), Pose((0, 0, 5.0), (1, 0, 0, 0))
    distance, rays = depth_image(mesh, pose)
    np.testing.assert_allclose(distance * rays[2], 4.0, atol=1e-5)
    assert len(distance) == 16 * 16  # 2 m at 4 m and f = 32 pixels


def test_shadow_rays_see_what_is_between():
    tracer = Tracer(box((1, 1, 1), 0))
    places = np.array([[0, 0, -3], [2, 0, -3], [0, 0, 0.5 + LIFT_M]], dtype=np.float32)
    blocked = tracer.blocked(places, np.array([0, 0, 1], dtype=np.float32))
    assert blocked.tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box((1, 2, 3), 0), 6.0),
        (tube((0, 0, 0), (0, 3, 0), 0.5, 0, 256), 3 * np.pi / 4),
        (ball((1, 2, 3), 1.0, 0, 256), 4 / 3 * np.pi),
        (lathe([(0, 0), (0, 1), (2, 0)], 0, 256), 2 / 3 * np.pi),
    ],
)
def test_solids_are_closed_and_face_outwards(mesh, volume):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-3)


def test_normals_are_smooth_on_a_ball_and_sharp_on_a_box():
    sphere = ball((0, 0, 0), 2.0, 0, 64)
    radial = sphere.vertices[sphere.faces] / 2.0
    assert (np.einsum("fck,fck->fc", sphere.corner_normals, radial) > 0.999).all()
    cube = box((1, 1, 1), 0)
    assert np.allclose(np.abs(cube.corner_normals).max(axis=2), 1)


def test_turn_is_right_handed():
    np.testing.assert_allclose(turn("z", 90) @ (1, 0, 0), (0, 1, 0), atol=1e-15)
    np.testing.assert_allclose(turn("y", 90) @ (0, 0, 1), (1, 0, 0), atol=1e-15)
    np.testing.assert_allclose(turn("x", 90) @ (0, 1, 0), (0, 0, 1), atol=1e-15)


def test_merge_keeps_every_face_where_it_was():
    parts = [box((1, 1, 1), 3), dish((5, 0, 0), (0, 0, 1), 1.0, 0.3, 1, 2)]
    whole = merge(parts)
    np.testing.assert_array_equal(
        whole.vertices[whole.faces],
        np.concatenate([part.vertices[part.faces] for part in parts]),
    )
    assert set(whole.material) == {1, 2, 3}


def plates(material):
    """Build a square meter at z = 0 twice: up, and then down, cut along the other diagonal."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) - (0.5, 0.5, 0)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 0, 3], [3, 2, 1]], np.int32)
    mesh = Mesh(vertices, faces, np.zeros((4, 3, 2)), np.zeros(4, np.int32))
    return Craft("plates", mesh.moved(turn("x", 30), (0.1, 0.2, 0.3)), (material,))


@pytest.mark.parametrize("elevation", [1.5, 8.0, 60.0])
@pytest.mark.parametrize("winding", [1, -1])
def test_the_side_that_is_seen_is_lit_however_slanted_and_wound(winding, elevation):
    """The corners' normals say which side is the front, not the order of the corners."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)[:, ::winding]
    up = np.broadcast_to(np.array([0, 0, 1], np.float32), (2, 3, 3))
    mesh = Mesh(vertices, faces, np.zeros((2, 3, 2)), np.zeros(2, np.int32), up)
    tracer, materials = prepared(Craft("plate", mesh, (Material((1, 1, 1), two_sided=True),)))
    target = np.array([[0.3, 0.1, 0], [-0.5, 0.4, 0]])
    for side in (1, -1):
        angle = side * np.radians(elevation)
        eye = np.array([20 * np.cos(angle), 0, 20 * np.sin(angle)], np.float32)
        rays = (target - eye) / np.linalg.norm(target - eye, axis=1, keepdims=True)
        rays = rays.astype(np.float32)
        hits = tracer.first_hits(eye, rays)
        seen = materials.surface(View(eye, rays.T, hits), np.full(2, 0.01, np.float32))
        np.testing.assert_allclose(seen.normal, np.tile([[0], [0], [side]], 2), atol=1e-6)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize(("side", "faces"), [(1, {0, 1}), (-1, {2, 3})])
def test_of_plates_in_one_place_each_side_shows_the_one_that_faces_it(two_sided, side, faces):
    craft = plates(Material((1, 1, 1), two_sided=two_sided))
    tracer = prepared(craft)[0]
    grid = np.stack(np.meshgrid(*[np.linspace(-0.49, 0.49, 40)] * 2), axis=-1).reshape(-1, 2)
    places = np.pad(grid, ((0, 0), (0, 1))) @ turn("x", 30).T + (0.1, 0.2, 0.3)
    for away in (2, 50):
        eye = turn("x", 30) @ (0.3, 0.1, side * away) + (0.1, 0.2, 0.3)
        distance = np.linalg.norm(places - eye, axis=1)
        rays = ((places - eye) / distance[:, None]).astype(np.float32)
        hits = tracer.first_hits(eye.astype(np.float32), rays)
        assert hits.ray.tolist() == list(range(1600))
        assert set(hits.face) == faces
        np.testing.assert_allclose(hits.distance, distance, rtol=1e-5)
        corners = craft.mesh.vertices[craft.mesh.faces[hits.face]]
        seen = np.einsum("kn,nkj->nj", hits.weights, corners)
        np.testing.assert_allclose(seen, places, atol=1e-4)
