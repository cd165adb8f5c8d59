"""The spacecraft rendered by Mitsuba 3, an independent path tracer.

A network that has seen one renderer alone may have learned its peculiarities; images of a second
one show how much that matters. Poses, sun, Earth, exposure and sensor are those of
`ffpose.render.renderer`, so that images compare one by one. Mitsuba brings its own camera rays,
shadows, reflection (the Disney principled BSDF, Burley 2012), light reflected between surfaces, and
the Earth's light as an environment map. Base colors, normals and roughness of the surface patterns
are textures baked from `ffpose.render.shading.patterns`; a mesh file's textures are Mitsuba's too.
Backs of one-sided surfaces are looked through; what is seen so is in their shadow of the sun, but
not of the Earth.

Mitsuba knows less of a mesh file's materials. All textures of one have the coordinates of the
first; colors of vertices beside a texture multiply it by their mean; a texture that goes on in
another way to the right than downward goes on in one. A specular reflectance has a color where the
base color has it too, or is black. What is partly transparent keeps all of the sun off what is
behind it, and its own glow in front of that is not weaker. Needs the extra `mitsuba`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.geometry import Camera, FloatArray, Pose
from ffpose.render.shading.patterns import DRAW, Surface
from ffpose.render.shading.rays import Window, cast_rays, find_window
from ffpose.render.shading.reflection import EARTH_COLOR, HIGHLIGHT_LIMIT, Light
from ffpose.render.shading.tracer import DEPTH, STEP, Tracer
from ffpose.render.shading.vectors import Floats, column, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material, Pattern
from ffpose.render.spacecraft.mesh import Mesh
from ffpose.render.spacecraft.textures import CLAMP, MIRROR, REPEAT, Texture, averaged

VARIANT = "scalar_rgb"
"""Mitsuba's build without a just-in-time compiler, which would need LLVM."""

TILE = 8
"""Cells of a pattern along each side of its texture, which is repeated."""

TEXELS = 64
"""Texels along each side of a cell."""

LARGEST = 2048
"""Largest side of a mesh file's texture: Mitsuba has 32 bits for each number."""

WRAPS = {REPEAT: "repeat", MIRROR: "mirror", CLAMP: "clamp"}
"""Mitsuba's names of what lies beyond the border of a texture."""

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Weights of a color in its luminance."""

SAMPLES = 32
"""Paths per pixel and light."""

BLOCK = 16
"""Side of the squares of pixels with random numbers of their own, for any number of threads."""

BOUNCES = 4
"""Largest number of path segments, of which the last reaches a light."""

SCALE = 2
"""Mitsuba's pixels along each side of ours."""

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
    """Composite the spacecraft over the background's ``radiance`` ``(H, W, 3)``, in place.

    The camera may be any pinhole; Mitsuba's has square pixels, of which those of the image are
    averages. The lights are in the object frame; ``rng`` seeds the paths.

    Returns:
        Radiance ``(3, N)`` of the pixels of which the spacecraft covers more than a half.
    """
    window = find_window(craft.corners, pose, camera)
    if window is None:
        return np.zeros((3, 0), dtype=np.float32)
    seed = int(rng.integers(2**31))
    shown = _shown(camera, pose, craft, light, window, seed)
    seen = _back_pixels(craft, pose, camera, window)
    if seen.any():
        (top, bottom), (left, right) = ((at.min(), at.max() + 1) for at in np.nonzero(seen))
        x, y, some = window.left, window.top, seen[top:bottom, left:right]
        inner = Window(x + left, y + top, x + right, y + bottom)
        behind = _shown(camera, pose, craft, light, inner, seed, through=True)
        shown[top:bottom, left:right][some] = behind[some]
    color, cover = shown[..., :3], np.minimum(shown[..., 3:], 1)
    part = radiance[window.top : window.bottom, window.left : window.right]
    part *= 1 - cover
    part += color
    most = cover[..., 0] > 0.5
    return np.ascontiguousarray((color[most] / cover[most]).T)


def _shown(
    camera: Camera,
    pose: Pose,
    craft: Craft,
    light: Light,
    window: Window,
    seed: int,
    *,
    through: bool = False,
) -> Floats:
    """Render the window: ``(rows, columns, 4)``, radiance times cover, and cover.

    With ``through`` the backs of one-sided surfaces are looked through.
    """
    half = _half_size(camera, window)
    ratio = camera.fx / camera.fy
    columns = [SCALE * (u - camera.cx + half[0]) for u in (window.left, window.right)]
    rows = [SCALE * ((v - camera.cy) * ratio + half[1]) for v in (window.top, window.bottom)]
    crop = [(math.floor(low), math.ceil(high)) for low, high in (columns, rows)]
    sensor = _sensor(pose, camera.fx, half, crop)
    lit, glowing = _shapes(craft, pose, through)
    integrator = {"type": "path", "max_depth": DEPTH + 2, "hide_emitters": False}
    shown = _render({"sensor": sensor, **glowing}, seed, integrator)
    # Each light by itself: a path that had to choose between them would be noisier.
    for number, source in enumerate(_lights(pose, light), start=1):
        scene = {"sensor": sensor, "source": source, **lit}
        integrator = {"type": "volpath", "max_depth": BOUNCES, "hide_emitters": True}
        if source["type"] == "directional":
            # By paths what lets light through has a shadow, but those that miss all count for
            # nothing, were there no sky, and each surface passed is a segment.
            scene["sky"] = {"type": "constant", "radiance": 0.0, "sampling_weight": 0.0}
            depth = BOUNCES + (DEPTH if through else 0)
            integrator = {"type": "path", "max_depth": depth, "hide_emitters": False}
        shown[..., :3] += _render(scene, seed + number, integrator)[..., :3]
    np.clip(shown[..., :3], 0, HIGHLIGHT_LIMIT, out=shown[..., :3])
    for axis, (low, high) in enumerate((rows, columns)):
        begin, count = crop[1 - axis][0], window.shape[axis]
        shown = averaged(shown, np.linspace(low - begin, high - begin, count + 1), axis)
    return shown


def _render(scene: dict[str, Any], seed: int, integrator: dict[str, Any]) -> Floats:
    """Render radiance and cover ``(rows, columns, 4)``."""
    loaded, paths = _load({"type": "scene", **scene}), _load({**integrator, "block_size": BLOCK})
    image = _mitsuba().render(loaded, integrator=paths, spp=SAMPLES // SCALE**2, seed=seed)
    return np.array(image, dtype=np.float32)


def _half_size(camera: Camera, window: Window) -> tuple[int, int]:
    """Return half the sides, in pixels, of a film about the optical axis that holds a window."""
    across = max(abs(window.left - camera.cx), abs(window.right - camera.cx))
    ratio = camera.fx / camera.fy
    down = max(abs(window.top - camera.cy), abs(window.bottom - camera.cy)) * ratio
    return math.ceil(across) + 1, math.ceil(down) + 1


def _sensor(pose: Pose, focal: float, half: tuple[int, int], crop: list[tuple[int, int]]) -> Any:
    """Return Mitsuba's camera of the object frame, which looks along z with x left and y up."""
    place = np.eye(4)
    place[:3, :3] = pose.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    place[:3, 3] = pose.camera_center
    (left, right), (top, bottom) = crop
    return _load(
        {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(half[0] / focal)),
            "fov_axis": "x",
            "near_clip": 0.05,
            "to_world": _mitsuba().ScalarTransform4f(place),
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


def _lights(pose: Pose, light: Light) -> Iterator[dict[str, Any]]:
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
            "position": pose.camera_center.tolist(),
            "intensity": {"type": "rgb", "value": math.pi * light.lamp},
        }
    if light.earth > 0:
        yield {"type": "envmap", "bitmap": _mitsuba().Bitmap(_sky(light))}


def _sky(light: Light) -> Floats:
    """Return the Earth's radiance in all directions, as Mitsuba's environment map ``(H, W, 3)``."""
    width, height = SKY
    around = (np.arange(width) + 0.5) / width * 2 * np.pi
    down = (np.arange(height)[:, None] + 0.5) / height * np.pi
    x, y, z = np.sin(down) * np.sin(around), np.cos(down), -np.sin(down) * np.cos(around)
    toward = light.nadir[0] * x + light.nadir[1] * y + light.nadir[2] * z
    soft = np.clip((toward - light.horizon) * height / np.pi + 0.5, 0, 1)
    color = light.earth * np.asarray(EARTH_COLOR)
    return np.asarray(soft[..., None] * color, dtype=np.float32)


def _shapes(craft: Craft, pose: Pose, through: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the spacecraft by material: as it reflects, and as it emits on its outer sides.

    Backs of one-sided faces, which light passes ``through`` or not, lie a little deeper, so that of
    faces back to back in one place the camera sees the other one.
    """
    corners, backs = craft.mesh.vertices[craft.mesh.faces], _backs(craft, pose)
    corners[backs] += STEP * (corners[backs] - pose.camera_center)
    lit: dict[str, Any] = {}
    glowing: dict[str, Any] = {}
    if through:
        nothing = {"bsdf": _load({"type": "null"})}
        lit["backs"] = glowing["backs"] = _triangles(corners[backs], nothing)
    for number, look in enumerate(_looks_of(craft)):
        faces = look.faces[~backs[look.faces]] if through else look.faces
        if faces.size == 0:
            continue
        lit[f"lit{number}"] = _shape_of(craft, faces, corners, {"bsdf": look.lit})
        parts = {"bsdf": look.dark}
        if look.radiance is not None:
            parts["emitter"] = _load({"type": "area", "radiance": look.radiance})
        glowing[f"glowing{number}"] = _shape_of(craft, faces, corners, parts)
    return lit, glowing


def _backs(craft: Craft, pose: Pose) -> NDArray[np.bool_]:
    """Return which faces (F,) are one-sided and turn their backs to the camera."""
    mesh = craft.mesh
    one_sided = np.array([not material.two_sided for material in craft.materials])
    sight = mesh.vertices[mesh.faces[:, 0]] - pose.camera_center
    away = np.einsum("ij,ij->i", mesh.face_normals, sight) > 0
    return np.asarray(one_sided[mesh.material] & away)


def _back_pixels(craft: Craft, pose: Pose, camera: Camera, window: Window) -> NDArray[np.bool_]:
    """Return pixels (rows, columns) of a window at which a back is what the camera meets first."""
    rows, columns = window.shape
    seen = np.zeros((rows + 2, columns + 2), np.bool_)
    backs = _backs(craft, pose)
    if backs.any():
        hits = cast_rays(_tracer(craft), window, camera, pose, SCALE).hits
        row, column = np.divmod(hits.ray[backs[hits.face]], SCALE * columns)
        seen[row // SCALE + 1, column // SCALE + 1] = True
    # Of a pixel beside them it may cover a part between the rays.
    return np.asarray(sliding_window_view(seen, (3, 3)).any(axis=(2, 3)))


@lru_cache(maxsize=4)
def _tracer(craft: Craft) -> Tracer:
    """Return what finds the faces that rays meet, from whichever side."""
    return Tracer(craft.mesh)


def _mitsuba() -> Any:
    """Return the module, or raise a MissingExtraError."""
    mi: Any = require("mitsuba", "mitsuba")
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    return mi


def _load(description: dict[str, Any]) -> Any:
    """Return what Mitsuba makes of a description."""
    return _mitsuba().load_dict(description)


class Look(NamedTuple):
    """Faces of one material, and the material for Mitsuba.

    Attributes:
        faces: (K,) their numbers.
        lit: How they reflect.
        dark: How they hide what is behind them, themselves black.
        radiance: What they emit; None if nothing.
    """

    faces: NDArray[np.intp]
    lit: Any
    dark: Any
    radiance: Any


@lru_cache(maxsize=4)
def _looks_of(craft: Craft) -> list[Look]:
    """Return the looks of a spacecraft's faces."""
    mesh, looks = craft.mesh, []
    for number, mirrored in itertools.product(range(len(craft.materials)), (False, True)):
        material = craft.materials[number]
        faces = np.flatnonzero((mesh.material == number) & (_mirrored(mesh, material) == mirrored))
        if faces.size == 0:
            continue
        colors = None if mesh.colors is None else mesh.colors[faces]
        radiance: Any = None
        if any(material.emission):
            radiance = {"type": "rgb", "value": list(material.emission)}
            if material.emission_map is not None:
                glow = _texels(material.emission_map)[..., :3] * np.array(material.emission)
                radiance = _load(_bitmap(glow, material.emission_map.image.wrap))
        black = {"type": "diffuse", "reflectance": 0.0}
        lit = {"type": "twosided", "bsdf": _reflecting(material, colors, mirrored)}
        lit, dark = (_load(_masked(material, colors, each)) for each in (lit, black))
        looks.append(Look(faces, lit, dark, radiance))
    return looks


def _mirrored(mesh: Mesh, material: Material) -> NDArray[np.bool_]:
    """Return on which faces (F,) a material's normal map is seen mirrored."""
    if material.normal_map is None:
        return np.zeros(len(mesh.faces), np.bool_)
    a, b, c = mesh.layers[material.maps[0].layer].transpose(1, 2, 0)
    (du1, dv1), (du2, dv2) = b - a, c - a
    # Upright ones turn clockwise, as coordinates begin at the upper left.
    return np.asarray(du1 * dv2 > du2 * dv1)


def _shape_of(
    craft: Craft, faces: NDArray[np.intp], corners: FloatArray, parts: dict[str, Any]
) -> Any:
    """Return some faces of one material, with what they have at their ``corners`` (F, 3, 3)."""
    mesh = craft.mesh
    material = craft.materials[mesh.material[faces[0]]]
    if material.maps:
        uv = mesh.layers[material.maps[0].layer][faces]
    else:
        uv = (mesh.uv[faces] / (material.scale * TILE)).astype(np.float32)
    layers = {"normals": mesh.corner_normals[faces], "texcoords": uv}
    shape = _triangles(corners[faces], parts, layers)
    if mesh.colors is not None:
        colors = mesh.colors[faces] * np.array([*material.color, 1], np.float32)
        shape.add_attribute("vertex_color", 3, colors[..., :3].ravel())
        shape.add_attribute("vertex_alpha", 1, colors[..., 3].ravel())
    return shape


def _triangles(
    corners: FloatArray, parts: dict[str, Any], layers: dict[str, NDArray[Any]] | None = None
) -> Any:
    """Return triangles (F, 3, 3) as a mesh in which no two share a vertex.

    ``layers`` are values (F, 3, K) of the corners: normals and texcoords.
    """
    mi = _mitsuba()
    layers = {f"vertex_{name}": values for name, values in (layers or {}).items()}
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = part
    has = {f"has_{name}": True for name in layers}
    shape = mi.Mesh("part", 3 * len(corners), len(corners), props=properties, **has)
    values = mi.traverse(shape)
    layers |= {"vertex_positions": corners, "faces": np.arange(3 * len(corners))}
    for name, layer in layers.items():
        np.asarray(values[name])[:] = layer.ravel()  # in place, as its own way is slow
        values.set_dirty(name)
    values.update()
    return shape


def _reflecting(material: Material, colors: Floats | None, mirrored: bool) -> dict[str, Any]:
    """Return a material as a principled BSDF; ``colors`` (F, 3, 4) are its corners'.

    Of a texture seen ``mirrored`` Mitsuba takes the downward direction for the upward one.
    """
    base = np.array(material.color)
    inner: dict[str, Any] = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": list(material.color)},
        "roughness": material.roughness,
        "metallic": material.metallic,
    }
    if colors is not None:
        inner["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
        base = base * colors[..., :3].mean(axis=(0, 1))
    if material.color_map is not None:
        values = _texels(material.color_map)
        color = values[..., :3] / np.maximum(values[..., 3:], np.float32(1e-3))
        color = np.clip(color * base, 0, 1)
        inner["base_color"] = _bitmap(color, material.color_map.image.wrap)
        base = color.mean(axis=(0, 1))
    if material.roughness_map is not None:
        gloss, wrap = _texels(material.roughness_map), material.roughness_map.image.wrap
        rough = np.clip(gloss[..., 1:2] * np.float32(material.roughness), LEAST_ROUGHNESS, 1)
        inner["roughness"] = _bitmap(rough, wrap)
        inner["metallic"] = _bitmap(gloss[..., 2:3] * np.float32(material.metallic), wrap)
    inner |= _mirror(material, base)
    if material.normal_map is not None:
        normals = _texels(material.normal_map)[..., :3] * (1, -1 if mirrored else 1, 1)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        bent = (normals / np.maximum(length, 1e-6) + 1) / 2
        normal_map = _bitmap(bent, material.normal_map.image.wrap)
        inner = {"type": "normalmap", "normalmap": normal_map, "bsdf": inner}
    if material.pattern != Pattern.PLAIN:
        surface = _baked(material)
        side = TILE * TEXELS
        shown = np.clip(surface.color, 0, 1).T.reshape(side, side, 3)
        roughness = np.clip(surface.roughness, LEAST_ROUGHNESS, 1).reshape(side, side, 1)
        bent = (unit(surface.normal).T.reshape(side, side, 3) + np.float32(1)) / 2
        inner["base_color"] = _bitmap(shown)
        inner["roughness"] = _bitmap(roughness)
        inner = {"type": "normalmap", "normalmap": _bitmap(bent), "bsdf": inner}
    return inner


def _mirror(material: Material, base: NDArray[np.float64]) -> dict[str, Any]:
    """Return parameters of the principled BSDF by which a material has its specular reflectance.

    An index of refraction reflects white. Its tint is toward the base color, whose mean is ``base``
    (3,); over a black one the mirror is a metal's.
    """
    reflectance = np.array(material.reflectance)
    if material.metallic == 0 and not base.any() and reflectance.any():
        color = {"type": "rgb", "value": reflectance.tolist()}
        return {"base_color": color, "metallic": 1.0}
    light = float(reflectance @ LUMINANCE)
    # At an index of one a metal would not reflect either, and at no finite one is all reflected.
    root = math.sqrt(min(max(light, 1e-6), 0.999))
    lean = base / max(base @ LUMINANCE, 1e-6) - 1
    tint = (reflectance / max(light, 1e-6) - 1) @ lean / max(lean @ lean, 1e-6)
    return {"eta": (1 + root) / (1 - root), "spec_tint": round(float(np.clip(tint, 0, 1)), 6)}


def _masked(material: Material, colors: Floats | None, inner: dict[str, Any]) -> dict[str, Any]:
    """Return a BSDF that is there by the alpha of the material and of its corners (F, 3, 4)."""
    opacities: list[Any] = []
    if material.alpha < 1:
        opacities.append(material.alpha)
    if material.color_map is not None:
        alpha = _texels(material.color_map)[..., 3:]
        if alpha.min() < 1:
            opacities.append(_bitmap(alpha, material.color_map.image.wrap))
    if colors is not None and colors[..., 3].min() < 1:
        opacities.append({"type": "mesh_attribute", "name": "vertex_alpha"})
    for opacity in opacities:
        inner = {"type": "mask", "opacity": opacity, "bsdf": inner}
    return inner


def _texels(texture: Texture) -> Floats:
    """Return a texture's values (H, W, 4) at a size for Mitsuba."""
    image = texture.image
    finest = max(0, max(image.width, image.height).bit_length() - LARGEST.bit_length())
    return image.level(finest).astype(np.float32)


def _bitmap(values: NDArray[Any], wrap: tuple[int, int] = (REPEAT, REPEAT)) -> dict[str, Any]:
    """Return values (H, W, K) as a texture; of ``wrap`` to the right and downward it has one."""
    content = _mitsuba().Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "bitmap": content, "raw": True, "wrap_mode": WRAPS[min(wrap)]}


def _baked(material: Material) -> Surface:
    """Evaluate a pattern over a plane of `TILE` cells each way: arrays of `TEXELS` per cell."""
    side = TILE * TEXELS
    middle = ((np.arange(side) + 0.5) / TEXELS).astype(np.float32)
    u, v = (axis.ravel() for axis in np.meshgrid(middle, middle))
    count = side * side

    def filled(values: Any) -> Floats:
        return column(values).repeat(count, axis=1)

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
