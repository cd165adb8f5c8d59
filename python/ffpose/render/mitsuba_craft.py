"""A spacecraft as Mitsuba 3 has it: triangles by material, principled BSDFs, textures, masks."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.geometry import FloatArray
from ffpose.render.shading.patterns import DRAW, Surface
from ffpose.render.shading.vectors import Floats, column, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material, Pattern
from ffpose.render.spacecraft.mesh import Mesh
from ffpose.render.spacecraft.textures import CLAMP, MIRROR, REPEAT, Texture

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


def mitsuba() -> Any:
    """Return the module, or raise a MissingExtraError."""
    mi: Any = require("mitsuba", "mitsuba")
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    return mi


def load(description: dict[str, Any]) -> Any:
    """Return what Mitsuba makes of a description."""
    return mitsuba().load_dict(description)


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
def looks_of(craft: Craft) -> list[Look]:
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
                radiance = load(_bitmap(glow, material.emission_map.image.wrap))
        black = {"type": "diffuse", "reflectance": 0.0}
        lit = {"type": "twosided", "bsdf": _reflecting(material, colors, mirrored)}
        lit, dark = (load(_masked(material, colors, each)) for each in (lit, black))
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


def shape_of(
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
    shape = triangles(corners[faces], parts, layers)
    if mesh.colors is not None:
        colors = mesh.colors[faces] * np.array([*material.color, 1], np.float32)
        shape.add_attribute("vertex_color", 3, colors[..., :3].ravel())
        shape.add_attribute("vertex_alpha", 1, colors[..., 3].ravel())
    return shape


def triangles(
    corners: FloatArray, parts: dict[str, Any], layers: dict[str, NDArray[Any]] | None = None
) -> Any:
    """Return triangles (F, 3, 3) as a mesh in which no two share a vertex.

    ``layers`` are values (F, 3, K) of the corners: normals and texcoords.
    """
    mi = mitsuba()
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
    content = mitsuba().Bitmap(np.ascontiguousarray(values, dtype=np.float32))
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
