"""Pictures against a renderer of other people: Mitsuba 3, where it is installed.

``pip install mitsuba`` brings it; it is too large to ask for everywhere. It has its own camera, its
own rays and its own reflection; the pose is given to it as a matrix.
"""

from dataclasses import replace

import numpy as np
import pytest

from ffpose.geometry import Camera
from ffpose.render import SCENES, label, render_layers
from ffpose.render.renderer import prepared
from ffpose.render.shading.finish import Surface
from ffpose.render.shading.reflection import HIGHLIGHT_LIMIT, Light, reflected, sun_visible
from ffpose.render.shading.tracer import Hits
from ffpose.render.shading.view import View

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
mi.set_variant("scalar_rgb")

pytestmark = pytest.mark.peer

WIDTH, HEIGHT = 160, 120
SQUARE_PIXELS = Camera(1280, 960, 640.0, 640.0, 640.0, 480.0)
"""The only ones that Mitsuba has."""


def their_mesh(mesh):
    """The triangles as Mitsuba's own shape."""
    shape = mi.Mesh("craft", len(mesh.vertices), len(mesh.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape


def their_camera(pose, camera):
    """A camera of the object frame: Mitsuba's looks along z with x to the left and y up."""
    place = np.eye(4)
    place[:3, :3] = pose.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    place[:3, 3] = -pose.rotation.T @ pose.t
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f(place),
            "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height},
        }
    )


def their_hits(scene, sensor):
    """Whether each pixel's ray met anything (H, W), and the points (H, W, 3)."""
    met, points = np.zeros((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH, 3))
    for row, column in np.ndindex(HEIGHT, WIDTH):
        at = mi.Point2f((column + 0.5) / WIDTH, (row + 0.5) / HEIGHT)
        ray, _ = sensor.sample_ray(0, 0, at, mi.Point2f(0.5, 0.5))
        found = scene.ray_intersect_preliminary(ray)
        if found.is_valid():
            # The ray begins at the near plane.
            points[row, column] = np.array(ray.o) + found.t * np.array(ray.d)
            met[row, column] = True
    return met, points


@pytest.mark.parametrize(("name", "index"), [("soyuz_easy", 3), ("dragon_hard", 5)])
def test_silhouette_depth_and_shadow_are_the_same(name, index):
    ours = replace(SCENES[name], camera=SQUARE_PIXELS)
    craft, pose, camera = ours.build(), label(ours, 8, index), ours.camera.resized(WIDTH, HEIGHT)
    scene = mi.load_dict({"type": "scene", "craft": their_mesh(craft.mesh)})
    met, points = their_hits(scene, their_camera(pose, camera))
    layers = render_layers(ours, 8, index, (WIDTH, HEIGHT))
    both = met & layers.mask
    assert both.sum() > 200
    assert both.sum() >= 0.999 * (met | layers.mask).sum()
    depth = points[both] @ pose.rotation[2] + pose.t[2]
    assert np.abs(depth - layers.depth[both]).max() < 1e-3

    sun = -pose.rotation.T @ pose.t / np.linalg.norm(pose.t) + (0.3, 0.6, -0.6)
    sun = (sun / np.linalg.norm(sun)).astype(np.float32)
    light = Light(sun, -sun, 0.0, 0.34, 1.0, 0.0, np.ones((3, 1), np.float32))
    place = points[both].T.astype(np.float32)
    toward = np.repeat(sun[:, None], place.shape[1], axis=1)
    start = place + 0.002 * toward
    lit = sun_visible(prepared(craft)[0], start, toward, light) > 0
    theirs = [
        not scene.ray_test(mi.Ray3f(mi.Point3f(at), mi.Vector3f(sun))) for at in start.T.tolist()
    ]
    assert 0.05 < lit.mean() < 0.95
    assert (lit == theirs).mean() > 0.999


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8])
def test_metal_reflects_as_theirs(roughness):
    """A plane of white metal under the sun, seen from many directions."""
    rng = np.random.default_rng(0)
    metal = mi.load_dict(
        {"type": "roughconductor", "material": "none", "distribution": "ggx",
         "alpha": roughness**2}
    )  # fmt: skip
    theirs, ours = [], []
    for _ in range(300):
        sun, eye = (up(rng) for _ in range(2))
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(eye)
        value = metal.eval(mi.BSDFContext(), interaction, mi.Vector3f(sun))
        theirs.append(np.pi * value[0])
        ours.append(our_metal(roughness, sun, eye))
    np.testing.assert_allclose(ours, np.minimum(theirs, HIGHLIGHT_LIMIT), rtol=1e-3, atol=1e-6)


def up(rng):
    """A unit vector at most 70 degrees from z."""
    while True:
        vector = rng.standard_normal(3)
        vector /= np.linalg.norm(vector)
        if vector[2] > 0.34:
            return vector


def our_metal(roughness, sun, eye):
    one = np.ones(1, np.float32)
    surface = Surface(
        np.ones((3, 1), np.float32), np.float32(roughness) * one, one,
        np.zeros((3, 1), np.float32), np.array([[0], [0], [1]], np.float32),
    )  # fmt: skip
    hits = Hits(np.zeros(1, np.intp), np.zeros(1, np.int32), one, np.zeros((2, 1), np.float32))
    view = View(np.float32(eye), np.float32(-eye)[:, None], hits)
    light = Light(
        np.float32(sun), np.float32([0, 0, -1]), 0.0, 0.34, 1.0, 0.0, np.ones((3, 1), np.float32)
    )
    return reflected(surface, view, light, one, 0 * one)[0, 0]
