"""Pictures against a renderer of other people: Mitsuba 3, where it is installed.

``pip install mitsuba`` brings it; it is too large to ask for everywhere. It has its own camera, its
own rays and its own reflection; the pose is given to it as a matrix. The second half tests the
pictures that we make with it (`ffpose.render.mitsuba`).
"""

from dataclasses import replace

import numpy as np
import pytest

from ffpose.geometry import Camera, Pose
from ffpose.render import SCENES, label, mitsuba, render, render_layers
from ffpose.render.renderer import draw_alone, prepared
from ffpose.render.shading.patterns import Surface
from ffpose.render.shading.rays import View
from ffpose.render.shading.reflection import (
    EARTH_COLOR,
    HIGHLIGHT_LIMIT,
    Light,
    reflected,
    sun_visible,
)
from ffpose.render.shading.tracer import Hits
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh
from tests.render.spacecraft.test_gltf_features import FACES, PLACES, File

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
drjit = pytest.importorskip("drjit")
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
        np.full((3, 1), 0.04, np.float32),
    )  # fmt: skip
    hits = Hits(np.zeros(1, np.intp), np.zeros(1, np.int32), one, np.zeros((2, 1), np.float32))
    view = View(np.float32(eye), np.float32(-eye)[:, None], hits)
    light = Light(
        np.float32(sun), np.float32([0, 0, -1]), 0.0, 0.34, 1.0, 0.0, np.ones((3, 1), np.float32)
    )
    return reflected(surface, view, light, one, 0 * one)[0, 0]


WHITE = Material((1.0, 1.0, 1.0), roughness=1.0)
HORIZON = 0.34
FLAT = Camera(64, 48, 64.0, 66.0, 30.0, 25.0)
"""Neither square pixels nor a center in the middle."""


def plate():
    """A white square of 2 m in the plane z = 0 of the object frame."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Craft(
        "plate", Mesh(corners, faces, np.zeros((2, 3, 2)), np.zeros(2, np.int32)), (WHITE,)
    )


def light_of(pose, **parts):
    """A light of the camera frame."""
    values = {"sun": (0, 0, -1), "nadir": (0, 0, -1), "earth": 0.0, "sunlight": 0.0, "lamp": 0.0}
    values |= parts
    turned = {k: np.float32(pose.rotation.T @ np.float64(values.pop(k))) for k in ("sun", "nadir")}
    return Light(**turned, horizon=HORIZON, tint=np.ones((3, 1), np.float32), **values)


def drawn(pose, light, craft=None):
    """What Mitsuba adds to a black image, and to a white one."""
    pictures = []
    for background in (0.0, 1.0):
        radiance = np.full((FLAT.height, FLAT.width, 3), background, np.float32)
        rng = np.random.default_rng(0)
        mitsuba.draw_craft(radiance, FLAT, pose, craft or plate(), light, rng)
        pictures.append(radiance)
    return pictures


def turned_plate(seed, t=(0.3, -0.2, 5.0)):
    """A pose in which the plate faces the camera, turned about the viewing axis."""
    angle = np.random.default_rng(seed).uniform(0, np.pi)
    return Pose(t, (np.cos(angle), 0, 0, np.sin(angle)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        # Irradiance of the sun over pi: the cosine. Of a disk of sky about the normal: sin².
        ({"sunlight": 1.0}, (1, 1, 1)),
        ({"sunlight": 1.0, "sun": (0.6, 0, -0.8)}, (0.8, 0.8, 0.8)),
        ({"earth": 1.0}, (1 - HORIZON**2) * np.array(EARTH_COLOR)),
        ({"earth": 1.0, "nadir": (0, 0, 1)}, (0, 0, 0)),
        ({"lamp": 25.0}, (1, 1, 1)),
    ],
)
def test_a_white_plate_has_the_radiance_of_its_light(parts, expected, seed):
    pose = turned_plate(seed)
    shown, _ = drawn(pose, light_of(pose, **parts))
    v, u = (int(c) for c in reversed(FLAT.project(pose.t)))
    # Burley's diffuse term and the 4 % of reflection leave Lambert's by a few percent.
    middle = shown[v - 3 : v + 4, u - 3 : u + 4].mean((0, 1))
    np.testing.assert_allclose(middle, expected, rtol=0.1, atol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_plate_covers_what_its_corners_project_to(seed):
    """The area and the middle of the silhouette, by the shoelace formula."""
    pose = turned_plate(seed)
    black, white = drawn(pose, light_of(pose, sunlight=1.0))
    cover = (1 - (white - black))[..., 0]
    u, v = FLAT.project(pose.transform(plate().mesh.vertices)).T
    area = abs(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1))) / 2
    assert cover.sum() == pytest.approx(area, rel=5e-3)
    rows, columns = np.mgrid[: FLAT.height, : FLAT.width] + 0.5
    middle = [(cover * at).sum() / cover.sum() for at in (columns, rows)]
    np.testing.assert_allclose(middle, FLAT.project(pose.t), atol=0.05)


def test_only_emission_shines_without_light():
    """On the outer side of its faces, which is seen from -z of the camera after half a turn."""
    craft = plate()
    lit = replace(craft, materials=(replace(WHITE, emission=(3.0, 0.1, 0.2)),))
    pose = Pose((0.3, -0.2, 5.0), (0, 1, 0, 0))
    for each, expected in ((craft, (0, 0, 0)), (lit, (3.0, 0.1, 0.2))):
        shown, _ = drawn(pose, light_of(pose), each)
        assert shown.max((0, 1)).tolist() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["soyuz_easy", "dragon_hard"])
def test_their_pictures_show_what_ours_show(name):
    """The same silhouettes, and about the same light: they count what surfaces light each other."""
    ratios = []
    for index in range(6):
        ours, theirs = (
            render(replace(SCENES[name], renderer=renderer), 9, index, (160, 120))
            for renderer in ("ffpose", "mitsuba")
        )
        assert theirs.pose == ours.pose
        mask = render_layers(SCENES[name], 9, index, (160, 120)).mask
        ratios.append(theirs.image[mask].mean() / ours.image[mask].mean())
    assert np.median(ratios) == pytest.approx(1, abs=0.1), ratios


def test_their_pictures_do_not_depend_on_threads():
    scene = replace(SCENES["soyuz_easy"], renderer="mitsuba")
    pictures = []
    for threads in (1, 2):
        drjit.set_thread_count(threads)
        pictures.append(render(scene, 9, 0, (96, 72)).image)
    drjit.set_thread_count(2)
    assert np.array_equal(*pictures)


GRID = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
ABOVE = Pose((0.0, 0.0, 12.0), (0.0, 1.0, 0.0, 0.0))
"""The camera at +z, x to the right and y up in the image."""

APART, ROW = 2.5, 5
"""Meters between the middles of plates of 2 m, and plates in a row."""


class Plates(File):
    """A file of plates beside each other, each of a material of its own."""

    def __init__(self):
        super().__init__()
        self.header |= {"meshes": [], "nodes": [], "scenes": [{"nodes": []}]}
        self.places = {}

    def add(self, name, material, *, over=None, faces=FACES, **attributes):
        """A plate, or one a meter over another."""
        number, count = len(self.header["meshes"]), len(self.places)
        if over is None:
            self.places[name] = ((count % ROW - 2) * APART, (1 - count // ROW) * APART, 0)
        place = self.places[name] if over is None else (*self.places[over][:2], 1)
        own = {key: self.accessor(np.float32(values)) for key, values in attributes.items()}
        part = {
            "attributes": self.attributes | own,
            "indices": self.accessor(faces),
            "material": number,
        }
        self.header["materials"].append(material)
        self.header["meshes"].append({"primitives": [part]})
        self.header["nodes"].append({"mesh": number, "translation": place})
        self.header["scenes"][0]["nodes"].append(number)

    def middles(self, image):
        """The mean color of the middle of each plate."""
        found = {}
        for name, place in self.places.items():
            u, v = GRID.project(ABOVE.transform(place)).astype(int)
            found[name] = image[v - 8 : v + 9, u - 8 : u + 9].mean((0, 1))
        return found


def paint(color=(1, 1, 1), alpha=1, **more):
    values = {"baseColorFactor": [*color, alpha], "metallicFactor": 0, "roughnessFactor": 0.8}
    return {"pbrMetallicRoughness": values | more}


def glossy(diffuse, specular):
    values = {"diffuseFactor": [*diffuse, 1], "specularFactor": specular, "glossinessFactor": 0.5}
    return {"extensions": {"KHR_materials_pbrSpecularGlossiness": values}}


def plates_of_a_file():
    file = Plates()
    noise = {"index": file.texture(np.random.default_rng(0).integers(0, 256, (64, 64, 3)))}
    bright = np.full((64, 64, 3), 60)
    bright[:32, 32:] = 220
    file.header["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]
    corner = {"index": file.texture(bright, sampler=0)}
    thrice = {"KHR_texture_transform": {"scale": [3, 3], "offset": [0, -2]}}
    leaning = {"normalTexture": {"index": file.texture(np.full((4, 4, 3), (166, 204, 225)))}}
    ramp = [(0.2, 0.3, 0.9), (0.8, 0.3, 0.9), (0.8, 0.9, 0.1), (0.2, 0.9, 0.1)]
    diamond = {"extensions": {"KHR_materials_ior": {"ior": 2.5}}}

    file.add("texture", paint((0.9, 0.6, 0.4), baseColorTexture=noise))
    upper_right = PLACES / 2 + np.float32([0.5, 0])
    file.add("corner of a texture", paint(baseColorTexture=corner), TEXCOORD_0=upper_right)
    file.add("clamped texture", paint(baseColorTexture=corner | {"extensions": thrice}))
    file.add("normal map", paint() | leaning)
    file.add("mirrored normal map", paint() | leaning, TEXCOORD_0=PLACES * (-1, 1))
    file.add("metal", paint((0.9, 0.7, 0.4), metallicFactor=1, roughnessFactor=0.5))
    file.add("colors", paint((0.5, 0.6, 0.7)), COLOR_0=ramp)
    file.add("no colors", paint((0.5, 0.6, 0.2)))
    file.add("colors and texture", paint(baseColorTexture=noise), COLOR_0=[(0.5, 0.9, 0.2)] * 4)
    file.add("alpha", paint() | {"alphaMode": "BLEND"}, COLOR_0=[(1, 1, 1, 0.4)] * 4)
    glow = {"alphaMode": "BLEND", "emissiveFactor": [0.2, 0.4, 0.8]}
    file.add("alpha and glow", paint(alpha=0.5) | glow)
    file.add("gold", glossy((0, 0, 0), (1.0, 0.77, 0.34)))
    file.add("tinted mirror", glossy((0.4, 0.3, 0.1), (0.6, 0.45, 0.15)))
    file.add("diamond", paint((0.02,) * 3, roughnessFactor=0.5) | diamond)
    file.add("under a back", paint((0.7, 0.8, 0.9)))
    file.add("back", paint(), over="under a back", faces=FACES[::-1].copy())
    return file


@pytest.mark.parametrize("gray", [0.0, 1.0])
@pytest.mark.parametrize("lights", [{"sunlight": 1.0}, {"sunlight": 0.0, "lamp": 100.0}])
def test_materials_of_a_file_look_as_ours(tmp_path, lights, gray):
    """A back is looked through, and its shadow of the sun is seen."""
    file = plates_of_a_file()
    craft = file.load(tmp_path)
    sun = np.float32([0.5, 0.3, 0.81]) / np.float32(np.linalg.norm([0.5, 0.3, 0.81]))
    light = Light(sun, -sun, **lights)
    theirs = np.full((GRID.height, GRID.width, 3), gray, np.float32)
    mitsuba.draw_craft(theirs, GRID, ABOVE, craft, light, np.random.default_rng(0))
    ours = file.middles(draw_alone(craft, ABOVE, GRID, light, gray))
    for name, shown in file.middles(theirs).items():
        np.testing.assert_allclose(shown, ours[name], rtol=0.1, atol=2e-3, err_msg=name)


def test_a_back_is_not_seen():
    """Neither what it would reflect nor a light behind it; where a front is too, that is seen."""
    pose = turned_plate(0)
    light = light_of(pose, sunlight=1.0, earth=1.0, nadir=(0, 0, 1), lamp=1.0)
    black = Material((0.0, 0.0, 0.0), roughness=1.0, two_sided=False)
    back = replace(plate(), materials=(black,))
    for shown, gray in zip(drawn(pose, light, back), (0.0, 1.0), strict=True):
        np.testing.assert_allclose(shown, gray, atol=1e-6)
    mesh = back.mesh
    faces = np.concatenate([mesh.faces, mesh.faces[:, ::-1]])
    both = Mesh(mesh.vertices, faces, np.zeros((4, 3, 2)), np.array([0, 0, 1, 1], np.int32))
    front = Craft("both", both, (black, replace(WHITE, two_sided=False)))
    for shown, white in zip(drawn(pose, light, front), drawn(pose, light), strict=True):
        np.testing.assert_allclose(shown, white, atol=1e-3)


def test_a_closed_craft_looks_the_same_with_one_sided_surfaces():
    scene = SCENES["dragon_hard"]
    craft, pose = scene.build(), label(scene, 9, 1)
    one_sided = tuple(replace(material, two_sided=False) for material in craft.materials)
    light = light_of(pose, sunlight=1.0, sun=(0.6, 0, -0.8), earth=1.0, nadir=(0, 0.8, 0.6))
    pictures = []
    for each in (craft, replace(craft, materials=one_sided)):
        picture = np.zeros((120, 160, 3), np.float32)
        camera = scene.camera.resized(160, 120)
        mitsuba.draw_craft(picture, camera, pose, each, light, np.random.default_rng(0))
        pictures.append(picture)
    assert pictures[0].mean() > 0.01
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.01 * pictures[0].mean()
