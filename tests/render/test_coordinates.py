"""Object coordinates are the surface's place: by hand for a box and a ball, by projection for all.

The codes are read back here by the formula of the documentation, not by this project's code.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ffpose.geometry import Camera, Pose
from ffpose.render import (
    SCENES,
    Scene,
    coordinates_limit,
    label,
    load_craft,
    object_coordinates,
    render_layers,
)
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import ball, box

CAMERA = Camera(64, 48, 40.0, 36.0, 30.0, 26.0)
"""Neither square pixels nor the principal point in the middle."""

GRAY = (Material((0.5, 0.5, 0.5), 1.0),)


def craft_of(mesh):
    return Craft("solid", mesh, GRAY)


def read(coordinates, limit):
    """Pixels (N, 2) at their centers and meters (N, 3) of what is on the object."""
    rows, columns = np.nonzero(coordinates[..., 3])
    codes = coordinates[rows, columns, :3].astype(float)
    return np.stack([columns, rows], axis=1) + 0.5, (2 * codes / 255 - 1) * limit


def pose_of(t, degrees):
    return Pose(t, Rotation.from_euler("xyz", degrees, degrees=True).as_quat(scalar_first=True))


@pytest.mark.parametrize(
    ("size", "limit"), [(2.0, 1.0), (2.2, 1.1), (2.21, 1.2), (0.02, 0.1), (10.6, 5.3)]
)
def test_limit_is_the_largest_coordinate_up_to_a_decimeter(size, limit):
    assert coordinates_limit(craft_of(box((0.01, size, 0.01), 0))) == limit
    below = box((0.01, 0.01, size / 2), 0).moved(shift=(0, 0, -size / 4))  # −size/2…0
    assert coordinates_limit(craft_of(below)) == limit


def test_the_front_of_a_box_by_hand():
    """A cube of 2 m, 5 m away and not turned, shows the face z = −1 at 4 m."""
    coordinates = object_coordinates(
        craft_of(box((2, 2, 2), 0)), Pose((0, 0, 5), (1, 0, 0, 0)), CAMERA
    )
    assert coordinates.shape == (48, 64, 4)
    assert coordinates.dtype == np.uint8
    u, v = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    x, y = (u - 30) / 40 * 4, (v - 26) / 36 * 4
    inside = (abs(x) < 1) & (abs(y) < 1)
    np.testing.assert_array_equal(coordinates[..., 3], np.where(inside, 255, 0))
    assert (coordinates[~inside] == 0).all()
    # −1…1 m onto 0…255, the face z = −1 on 0.
    expected = np.stack([(x + 1) / 2 * 255, (y + 1) / 2 * 255, 0 * x], axis=-1)
    assert np.abs(coordinates[inside][:, :3] - expected[inside]).max() < 0.5 + 1e-3


def test_the_points_of_a_ball_lie_on_it_and_on_their_rays():
    pose = pose_of((0.4, -0.3, 4.0), (20, 130, -70))
    coordinates = object_coordinates(craft_of(ball((0.5, 0, 0), 1.0, 0, 256)), pose, CAMERA)
    pixels, places = read(coordinates, 1.5)
    assert len(pixels) > 300
    half_step = 1.5 / 255
    distance = np.linalg.norm(places - (0.5, 0, 0), axis=1)
    assert np.abs(distance - 1).max() < np.sqrt(3) * half_step + 1e-3
    rays = np.column_stack([(pixels - (30, 26)) / (40, 36), np.ones(len(pixels))])
    eye = -pose.rotation.T @ pose.t
    toward = rays @ pose.rotation  # in the object frame
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    off = np.linalg.norm(np.cross(places - eye, toward), axis=1)
    assert off.max() < np.sqrt(3) * half_step + 1e-5
    # Of the ray's two points the nearer is seen.
    assert ((places - eye) @ toward.T).diagonal().max() < np.linalg.norm(eye - (0.5, 0, 0)) + 0.01


@pytest.mark.parametrize("name", SCENES)
def test_every_place_projects_back_to_its_pixel(name):
    """For any camera, such as one that is turned and looks closely: p_camera = R p + t."""
    craft, pose = SCENES[name].build(), pose_of((1.0, -0.5, 14.0), (40, -80, 160))
    close = Camera(200, 150, 300.0, 310.0, 80.0, 90.0)
    limit = coordinates_limit(craft)
    pixels, places = read(object_coordinates(craft, pose, close), limit)
    assert len(pixels) > 2000
    points = places @ pose.rotation.T + pose.t
    seen = points[:, :2] / points[:, 2:] * (300, 310) + (80, 90)
    # Half a step of each axis, seen from at least 14 m less the spacecraft's reach.
    tolerance = np.sqrt(3) * limit / 255 * 310 / (points[:, 2].min() - 0.1) * 1.3
    assert np.abs(seen - pixels).max() < tolerance < 1.5


def test_the_layers_of_an_image_agree():
    """Alpha is the mask, and the places have the depth that the depth layer says."""
    scene, size = SCENES["soyuz_easy"], (160, 120)
    for index in range(3):
        layers = render_layers(scene, 4, index, size)
        np.testing.assert_array_equal(layers.coordinates[..., 3] > 0, layers.mask)
        limit = coordinates_limit(scene.build())
        _, places = read(layers.coordinates, limit)
        depth = label(scene, 4, index).transform(places)[:, 2]
        assert np.abs(depth - layers.depth[layers.mask]).max() < np.sqrt(3) * limit / 255


def test_what_is_cut_or_out_of_frame_is_cut_or_empty():
    craft = craft_of(box((2, 2, 2), 0))
    cut = object_coordinates(craft, Pose((3.5, 0, 5), (1, 0, 0, 0)), CAMERA)
    assert cut[..., 3].any()
    assert cut[:, -1, 3].any()
    for away in ((50, 0, 5), (0, 0, -5)):
        assert not object_coordinates(craft, Pose(away, (1, 0, 0, 0)), CAMERA).any()


def test_a_users_mesh_has_coordinates_too(tmp_path):
    mesh = trimesh.creation.box((3000.0, 1000.0, 500.0))
    mesh.apply_translation((700.0, 0.0, 0.0))
    mesh.export(tmp_path / "brick.ply")
    scene = Scene("brick", load_craft(tmp_path / "brick.ply", 0.001), (6.0, 9.0), 3.0)
    assert coordinates_limit(scene.build()) == 2.2
    layers = render_layers(scene, 0, 1, (160, 120))
    _, places = read(layers.coordinates, 2.2)
    assert len(places) > 100
    half_step = 2.2 / 255
    low, high = np.array([-0.8, -0.5, -0.25]), np.array([2.2, 0.5, 0.25])
    assert (places > low - half_step - 1e-4).all()
    assert (places < high + half_step + 1e-4).all()
    on_a_face = np.minimum(abs(places - low), abs(places - high)).min(axis=1)
    assert on_a_face.max() < half_step + 1e-4
