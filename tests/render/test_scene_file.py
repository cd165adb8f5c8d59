"""Sets of one's own spacecraft."""

import json
import os

import numpy as np
import pytest
import trimesh

from ffpose import DataError
from ffpose.geometry import Camera
from ffpose.render import SceneFile, find_scene, render

CAMERA = Camera(64, 48, 32.0, 32.0, 32.0, 24.0)


def test_images_depend_on_the_ratio_of_size_and_distance_alone(tmp_path):
    """In the sun and in the light of the lamp, of a picosatellite as of a station."""
    trimesh.creation.box((2.0, 1.0, 0.7)).export(tmp_path / "box.stl")
    for index in range(6):
        images = []
        for scale in (0.05, 1.0, 40.0):
            distance = (3.6 * scale, 19.2 * scale)
            limits = (180.0, 90.0, 180.0)
            file = SceneFile("box", tmp_path / "box.stl", scale, distance, limits, CAMERA)
            images.append(render(file.scene(), 0, index).image.astype(float))
        for image in images[::2]:
            assert np.abs(image - images[1]).mean() < 0.5
            assert np.quantile(np.abs(image - images[1]), 0.98) <= 3


def test_a_mesh_that_is_exported_again_is_read_again(tmp_path):
    """In one process, as in a notebook."""
    mesh, path = tmp_path / "box.stl", tmp_path / "scene.json"
    pictures, stamp = [], 1_700_000_000_000_000_000
    for height in (0.2, 1.7):
        trimesh.creation.box((2.0, 1.0, height)).export(mesh)
        SceneFile("box", mesh, 1.0, (4.0, 5.0), (180.0, 90.0, 180.0), CAMERA).write(path)
        os.utime(path, ns=(stamp, stamp))
        os.utime(mesh, ns=(stamp + len(pictures), stamp + len(pictures)))
        pictures.append(render(str(path), 0, 0).image)
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() > 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mesh_center": "false"}, "mesh_center: expected .* got 'false'"),
        ({"name": None}, "name: expected .* got None"),
        ({"mesh_scale": True}, "mesh_scale: expected .* got True"),
        ({"mesh_scale": 10**400}, "too large"),
        ({"mesh_scale": 0}, "mesh scale: expected a positive number"),
        ({"mesh_up": "w"}, "mesh up: expected one of"),
        ({"distance_m": ["4", 5]}, "distance_m: expected 2 numbers"),
        ({"distance_m": [5, 4]}, "distance_m: expected 0 < least <= most"),
        ({"attitude_range_deg": [180]}, "attitude_range_deg: expected 3 numbers"),
        ({"camera": {"width": 64}}, "missing"),
        ({"lamp": 30}, "expected the keys name, mesh, "),
    ],
)
def test_a_file_that_is_no_set_is_named(tmp_path, change, message):
    """Nothing of it is taken for what it is not: the text "false" would be true."""
    trimesh.creation.box((2.0, 1.0, 0.7)).export(tmp_path / "box.stl")
    path = tmp_path / "scene.json"
    file = SceneFile("box", tmp_path / "box.stl", 1.0, (4.0, 5.0), (180.0, 90.0, 180.0), CAMERA)
    file.write(path)
    assert find_scene(path) == find_scene(str(path))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DataError, match=rf"scene\.json: .*{message}"):
        find_scene(str(path))


def test_of_a_mesh_that_is_broken_or_gone_the_mesh_is_named(tmp_path):
    mesh, path = tmp_path / "box.stl", tmp_path / "scene.json"
    SceneFile("box", mesh, 1.0, (4.0, 5.0), (180.0, 90.0, 180.0), CAMERA).write(path)
    with pytest.raises(FileNotFoundError, match=r"box\.stl"):
        find_scene(path)
    mesh.write_text("no mesh")
    with pytest.raises(DataError, match=r"box\.stl: "):
        find_scene(path)
