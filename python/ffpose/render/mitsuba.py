"""The spacecraft rendered by Mitsuba 3, an independent path tracer.

A network that has seen one renderer alone may have learned its peculiarities; images of a second
one show how much that matters. Poses, sun, Earth, exposure and sensor are those of
`ffpose.render.renderer`, so that images compare one by one. Mitsuba brings its own camera rays,
shadows, reflection (the Disney principled BSDF, Burley 2012), light reflected between surfaces, and
the Earth's light as an environment map. Base colors, normals and roughness of the surface patterns
are textures baked from `ffpose.render.shading.patterns`; a mesh file's textures are Mitsuba's too.
Where such a material has both a texture and colors of vertices the texture alone is shown, and all
its textures have the coordinates of the first. Needs the extra `mitsuba`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.geometry import Camera, Pose
from ffpose.render.shading.patterns import DRAW, Surface
from ffpose.render.shading.rays import Window, find_window
from ffpose.render.shading.reflection import EARTH_COLOR, HIGHLIGHT_LIMIT, Light
from ffpose.render.shading.vectors import Floats, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material, Pattern, Texture
from ffpose.render.spacecraft.textures import averaged

VARIANT = "scalar_rgb"
"""Mitsuba's build without a just-in-time compiler, which would need LLVM."""

SAMPLES = 32
"""Paths per pixel and light."""

BLOCK = 16
"""Side of the squares of pixels with random numbers of their own, for any number of threads."""

BOUNCES = 4
"""Largest number of path segments, of which the last reaches a light."""

SCALE = 2
"""Mitsuba's pixels along each side of ours."""

TILE = 8
"""Cells of a pattern along each side of its texture, which is repeated."""

TEXELS = 64
"""Texels along each side of a cell."""

LARGEST = 2048
"""Largest side of a mesh file's texture: Mitsuba has 32 bits for each number."""

SKY = (256, 128)
"""Width and height of the environment map."""


def draw_craft(
    radiance: Floats,
    camera: Camera,
    pose: Pose,
    craft: Craft,
    light: Light,
    rng: np.random.Generator,
) -> Floats:
    """Composite the spacecraft over ``radiance``, and return the radiance of what it covers.

    Args:
        radiance: ``(H, W, 3)``, of the background; changed in place.
        camera: Any pinhole; Mitsuba's has square pixels, of which those of the image are averages.
        pose: The spacecraft's pose.
        craft: The spacecraft.
        light: The lights, in the object frame.
        rng: Seeds the paths.

    Returns:
        ``(3, N)``, for each pixel of which the spacecraft covers more than a half.
    """
    window = find_window(craft.corners, pose, camera)
    if window is None:
        return np.zeros((3, 0), dtype=np.float32)
    shown = _shown(camera, pose, craft, light, window, int(rng.integers(2**31)))
    color, cover = shown[..., :3], np.minimum(shown[..., 3:], 1)
    part = radiance[window.top : window.bottom, window.left : window.right]
    part *= 1 - cover
    part += color
    most = cover[..., 0] > 0.5
    return np.ascontiguousarray((color[most] / cover[most]).T)


def _shown(
    camera: Camera, pose: Pose, craft: Craft, light: Light, window: Window, seed: int
) -> Floats:
    """Render the window: ``(rows, columns, 4)``, radiance times cover, and cover."""
    mi = _mitsuba()
    half = _half_size(camera, window)
    ratio = camera.fx / camera.fy
    columns = [SCALE * (u - camera.cx + half[0]) for u in (window.left, window.right)]
    rows = [SCALE * ((v - camera.cy) * ratio + half[1]) for v in (window.top, window.bottom)]
    crop = [(math.floor(low), math.ceil(high)) for low, high in (columns, rows)]
    sensor = _sensor(mi, pose, camera.fx, half, crop)
    lit, glowing = _shapes(craft)
    shown = _render(mi, {"sensor": sensor, **glowing}, seed, depth=2, hide=False)
    # Each light by itself: a path that had to choose between them would be noisier.
    for number, source in enumerate(_lights(mi, pose, light), start=1):
        scene = {"sensor": sensor, "source": source, **lit}
        shown[..., :3] += _render(mi, scene, seed + number, depth=BOUNCES, hide=True)[..., :3]
    np.clip(shown[..., :3], 0, HIGHLIGHT_LIMIT, out=shown[..., :3])
    for axis, (low, high) in enumerate((rows, columns)):
        begin, count = crop[1 - axis][0], window.shape[axis]
        shown = averaged(shown, np.linspace(low - begin, high - begin, count + 1), axis)
    return shown


def _mitsuba() -> Any:
    mi: Any = require("mitsuba", "mitsuba")
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    return mi


def _render(mi: Any, scene: dict[str, Any], seed: int, *, depth: int, hide: bool) -> Floats:
    """Render radiance and cover ``(rows, columns, 4)``; ``hide`` leaves out lights themselves."""
    path = {"type": "path", "max_depth": depth, "hide_emitters": hide, "block_size": BLOCK}
    loaded, integrator = mi.load_dict({"type": "scene", **scene}), mi.load_dict(path)
    image = mi.render(loaded, integrator=integrator, spp=SAMPLES // SCALE**2, seed=seed)
    return np.array(image, dtype=np.float32)


def _half_size(camera: Camera, window: Window) -> tuple[int, int]:
    """Return half the sides, in pixels, of a film about the optical axis that holds a window."""
    across = max(abs(window.left - camera.cx), abs(window.right - camera.cx))
    ratio = camera.fx / camera.fy
    down = max(abs(window.top - camera.cy), abs(window.bottom - camera.cy)) * ratio
    return math.ceil(across) + 1, math.ceil(down) + 1


def _sensor(
    mi: Any, pose: Pose, focal: float, half: tuple[int, int], crop: list[tuple[int, int]]
) -> Any:
    """Return Mitsuba's camera of the object frame, which looks along z with x left and y up."""
    place = np.eye(4)
    place[:3, :3] = pose.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    place[:3, 3] = -pose.rotation.T @ pose.t
    (left, right), (top, bottom) = crop
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(half[0] / focal)),
            "fov_axis": "x",
            "near_clip": 0.05,
            "to_world": mi.ScalarTransform4f(place),
            "film": {
                "type": "hdrfilm",
                "pixel_format": "rgba",
                "width": 2 * SCALE * half[0],
                "height": 2 * SCALE * half[1],
                "crop_offset_x": left,
                "crop_offset_y": top,
                "crop_width": right - left,
                "crop_height": bottom - top,
                "rfilter": {"type": "box"},
            },
        }
    )


def _lights(mi: Any, pose: Pose, light: Light) -> Iterator[dict[str, Any]]:
    """Yield sun, lamp and Earth; a white surface that faces the sun has a radiance of one."""
    if light.sunlight > 0:
        irradiance = math.pi * light.sunlight * light.tint[:, 0]
        yield {
            "type": "directional",
            "direction": (-light.sun).tolist(),
            "irradiance": {"type": "rgb", "value": irradiance.tolist()},
        }
    if light.lamp > 0:
        yield {
            "type": "point",
            "position": (-pose.rotation.T @ pose.t).tolist(),
            "intensity": {"type": "rgb", "value": math.pi * light.lamp},
        }
    if light.earth > 0:
        yield {"type": "envmap", "bitmap": mi.Bitmap(_sky(light))}


def _sky(light: Light) -> Floats:
    """Return the Earth's radiance in all directions, as Mitsuba's environment map ``(H, W, 3)``."""
    width, height = SKY
    around = (np.arange(width) + 0.5) / width * 2 * np.pi
    down = (np.arange(height)[:, None] + 0.5) / height * np.pi
    x, y, z = np.sin(down) * np.sin(around), np.cos(down), -np.sin(down) * np.cos(around)
    nadir = light.nadir
    toward = nadir[0] * x + nadir[1] * y + nadir[2] * z
    soft = np.clip((toward - light.horizon) * height / np.pi + 0.5, 0, 1)
    color = light.earth * np.asarray(EARTH_COLOR)
    return np.asarray(soft[..., None] * color, dtype=np.float32)


@lru_cache(maxsize=4)
def _shapes(craft: Craft) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the spacecraft by material: as it reflects, and as it emits on its outer sides."""
    mi = _mitsuba()
    lit: dict[str, Any] = {}
    glowing: dict[str, Any] = {}
    for number, material in enumerate(craft.materials):
        faces = np.flatnonzero(craft.mesh.material == number)
        if faces.size == 0:
            continue
        bsdf = _bsdf(mi, material, craft.mesh.colors is not None)
        lit[f"lit{number}"] = _shape(mi, craft, faces, material, {"bsdf": bsdf})
        radiance: dict[str, Any] = {"type": "rgb", "value": list(material.emission)}
        if material.emission_map is not None:
            glow = _texels(material.emission_map)[..., :3]
            radiance = _texture(mi, glow * np.array(material.emission))
        emitter = {"type": "area", "radiance": radiance}
        black = {"type": "diffuse", "reflectance": 0.0}
        parts = {"bsdf": mi.load_dict(_masked(mi, material, black))}
        if any(material.emission):
            parts["emitter"] = mi.load_dict(emitter)
        glowing[f"glowing{number}"] = _shape(mi, craft, faces, material, parts)
    return lit, glowing


def _shape(
    mi: Any, craft: Craft, faces: NDArray[np.intp], material: Material, parts: dict[str, Any]
) -> Any:
    """Return some faces as a mesh in which no two share a vertex: normals are those of corners."""
    mesh = craft.mesh
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = part
    shape = mi.Mesh(
        "part",
        3 * len(faces),
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    values = mi.traverse(shape)
    corners = mesh.vertices[mesh.faces[faces]]
    values["vertex_positions"] = corners.astype(np.float32).ravel()
    values["vertex_normals"] = mesh.corner_normals[faces].ravel()
    if material.maps:
        uv = mesh.layers[material.maps[0].layer][faces]
    else:
        uv = (mesh.uv[faces] / (material.scale * TILE)).astype(np.float32)
    values["vertex_texcoords"] = uv.ravel()
    values["faces"] = np.arange(3 * len(faces), dtype=np.uint32)
    values.update()
    if mesh.colors is not None:
        shape.add_attribute("vertex_color", 3, mesh.colors[faces, :, :3].ravel())
    return shape


def _bsdf(mi: Any, material: Material, tinted: bool) -> Any:
    """Return a material as Mitsuba's principled BSDF, ``tinted`` by the colors of corners."""
    inner: dict[str, Any] = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": list(material.color)},
        "roughness": material.roughness,
        "metallic": material.metallic,
        "specular": float(np.clip(np.mean(material.reflectance) / 0.08, 0, 1)),
    }
    if tinted:
        inner["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
    if material.color_map is not None:
        values = _texels(material.color_map)
        color = values[..., :3] / np.maximum(values[..., 3:], np.float32(1e-3))
        inner["base_color"] = _texture(mi, np.clip(color * np.array(material.color), 0, 1))
    if material.roughness_map is not None:
        gloss = _texels(material.roughness_map)
        rough = np.clip(gloss[..., 1:2] * np.float32(material.roughness), LEAST_ROUGHNESS, 1)
        inner["roughness"] = _texture(mi, rough)
        inner["metallic"] = _texture(mi, gloss[..., 2:3] * np.float32(material.metallic))
    if material.normal_map is not None:
        normals = _texels(material.normal_map)[..., :3]
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        normal_map = _texture(mi, (normals / np.maximum(length, 1e-6) + 1) / 2)
        inner = {"type": "normalmap", "normalmap": normal_map, "bsdf": inner}
    if material.pattern != Pattern.PLAIN:
        surface = _baked(material)
        side = TILE * TEXELS
        shown = np.clip(surface.color, 0, 1).T.reshape(side, side, 3)
        roughness = np.clip(surface.roughness, LEAST_ROUGHNESS, 1).reshape(side, side, 1)
        bent = (unit(surface.normal).T.reshape(side, side, 3) + np.float32(1)) / 2
        inner["base_color"] = _texture(mi, shown)
        inner["roughness"] = _texture(mi, roughness)
        inner = {"type": "normalmap", "normalmap": _texture(mi, bent), "bsdf": inner}
    return mi.load_dict(_masked(mi, material, {"type": "twosided", "bsdf": inner}))


def _masked(mi: Any, material: Material, inner: dict[str, Any]) -> dict[str, Any]:
    """Return a BSDF that is there by the material's alpha."""
    opacity: Any = material.alpha
    if material.color_map is not None:
        alpha = _texels(material.color_map)[..., 3:]
        if alpha.min() < 1:
            opacity = _texture(mi, alpha * np.float32(material.alpha))
    if opacity == 1:
        return inner
    return {"type": "mask", "opacity": opacity, "bsdf": inner}


def _texels(texture: Texture) -> Floats:
    """Return a texture's values (H, W, 4) at a size for Mitsuba."""
    image = texture.image
    finest = max(0, max(image.width, image.height).bit_length() - LARGEST.bit_length())
    return image.level(finest).astype(np.float32)


def _texture(mi: Any, values: NDArray[Any]) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True}


def _baked(material: Material) -> Surface:
    """Evaluate a pattern over a plane of `TILE` cells each way: arrays of `TEXELS` per cell."""
    side = TILE * TEXELS
    middle = ((np.arange(side) + 0.5) / TEXELS).astype(np.float32)
    u, v = (axis.ravel() for axis in np.meshgrid(middle, middle))
    count = side * side

    def filled(values: Any) -> Floats:
        column = np.asarray(values, np.float32).reshape(-1, 1)
        return np.broadcast_to(column, (len(column), count)).copy()

    surface = Surface(
        filled(material.color),
        filled(material.roughness)[0],
        filled(material.metallic)[0],
        filled(material.emission),
        filled((0, 0, 1)),
        filled(material.reflectance),
    )
    place = np.stack([u, v, np.zeros_like(u)]) * np.float32(material.scale)
    footprint = np.full(count, 1 / TEXELS, np.float32)
    DRAW[material.pattern](surface, np.arange(count), np.stack([u, v]), place, footprint)
    return surface
