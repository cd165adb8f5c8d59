"""Colors of a mesh file's faces: of faces, vertices, materials, and textures.

A face has one color: the mean over it of what the file says, as linear light. In glTF that is
texture times factor times vertex color (specification 2.0, section 3.9.2), and factors and vertex
colors are linear; an MTL file's ``Kd``, and colors of other files, are sRGB as textures are.
Transparency, emission, metalness, roughness and normal maps are left out.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SAMPLES = 1 << 22
"""Number of texture samples of a whole mesh, about; each face has `LEAST_SIDE`² to `MOST_SIDE`²."""

LEAST_SIDE, MOST_SIDE = 2, 16


def face_colors(mesh: Any) -> NDArray[np.uint8]:
    """Return the sRGB colors (F, 3) of the faces of a mesh that trimesh has read.

    Raises:
        OSError: A texture cannot be decoded.
        ValueError: A texture coordinate is not finite.
    """
    visual = mesh.visual
    if visual.kind != "texture":
        return np.asarray(visual.face_colors, dtype=np.uint8)[:, :3]
    factor, image = _material(visual.material)
    light = np.tile(factor, (len(mesh.faces), 1))
    if image is not None:
        light *= _texture_means(image, visual.uv, np.asarray(mesh.faces))
    colors = visual.vertex_attributes.get("color")
    if colors is not None:
        light *= _unit_range(colors)[:, :3][mesh.faces].mean(axis=1)
    return _encoded(light)


def linear(code: ArrayLike) -> Floats:
    """Return the linear light of sRGB values in 0…1."""
    value = np.asarray(code, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _encoded(light: Floats) -> NDArray[np.uint8]:
    """Return the sRGB codes of linear light, of which more than one is white."""
    value = np.clip(light, 0, 1)
    code = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(code * 255).astype(np.uint8)


def _material(material: Any) -> tuple[Floats, Any]:
    """Return a material's linear color (3,), and its texture as a Pillow image or None."""
    if hasattr(material, "baseColorFactor"):
        factor = material.baseColorFactor
        color = np.ones(3) if factor is None else np.asarray(factor[:3]) / 255
        return color, material.baseColorTexture
    diffuse, image = material.kwargs.get("kd"), material.image
    if diffuse is None and image is None:
        return linear(np.asarray(material.diffuse[:3]) / 255), None
    # Exporters write no color, or black, beside a texture that is to be seen as it is.
    if image is not None and (diffuse is None or not np.any(diffuse)):
        return np.ones(3), image
    return np.broadcast_to(linear(np.clip(diffuse, 0, 1)), (3,)), image


def _texture_means(image: Any, uv: Any, faces: NDArray[np.int64]) -> Floats:
    """Return the mean linear light (F, 3) of a repeated texture over each face."""
    codes = np.asarray(image.convert("RGB"))
    table = linear(np.arange(256) / 255)
    if uv is None:
        return np.tile(table[codes].mean(axis=(0, 1)), (len(faces), 1))
    if not np.isfinite(uv).all():
        raise ValueError("expected finite texture coordinates, got NaN or infinity")
    height, width = codes.shape[:2]
    corners = np.asarray(uv, dtype=np.float64)[faces]
    side = int(np.clip(math.isqrt(SAMPLES // len(faces)), LEAST_SIDE, MOST_SIDE))
    points = _inner_points(side)
    total = np.zeros((len(faces), 3))
    for first, second, third in points:
        u, v = (first * corners[:, 0] + second * corners[:, 1] + third * corners[:, 2]).T
        column = np.floor(u * width).astype(np.int64) % width
        row = np.floor((1 - v) * height).astype(np.int64) % height
        total += table[codes[row, column]]
    return total / len(points)


def _inner_points(side: int) -> Floats:
    """Return the centers (side², 3), barycentric, of a triangle's division into equal ones."""
    second, third = (axis.ravel() for axis in np.mgrid[:side, :side])
    upright = np.stack([second, third])[:, second + third < side] + 1 / 3
    inverted = np.stack([second, third])[:, second + third < side - 1] + 2 / 3
    b, c = np.concatenate([upright, inverted], axis=1) / side
    return np.stack([1 - b - c, b, c], axis=1)


def _unit_range(colors: ArrayLike) -> Floats:
    """Return colors in 0…1, whether they are floats or whole numbers of any width."""
    values = np.asarray(colors)
    top = np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else 1
    return values.astype(np.float64) / top
