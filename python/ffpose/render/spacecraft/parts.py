"""Parts of a spacecraft as they come out of a mesh file, and one mesh of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh
from ffpose.render.spacecraft.textures import linear

Floats = NDArray[np.float32]


GRAY, ROUGHNESS = 0.4, 0.55
"""Color, sRGB, and roughness of what has no material."""


class Part(NamedTuple):
    """Faces of one material.

    Attributes:
        vertices: (V, 3).
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside.
        material: The material.
        normals: (V, 3) unit normals, or None where they follow from the shape.
        colors: (V, 4) linear colors and alpha of the vertices, (F, 1, 4) of the faces, or None.
        layers: (V, 2) coordinates in textures, from the upper left.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: Material
    normals: Floats | None = None
    colors: Floats | None = None
    layers: tuple[Floats, ...] = ()


def joined(parts: Sequence[Part]) -> tuple[Mesh, tuple[Material, ...]]:
    """Join parts into one mesh of the vertices that faces use, and list its materials."""
    materials = tuple(dict.fromkeys(part.material for part in parts))
    numbers = {material: number for number, material in enumerate(materials)}
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    counts = [len(part.faces) for part in parts]
    normals = [_of_corners(part, part.normals, (np.nan,) * 3) for part in parts]
    colors = [_colors(part) for part in parts]
    vertices = np.concatenate([part.vertices for part in parts])
    used, together = used_vertices(np.concatenate(faces), len(vertices))
    mesh = Mesh(
        vertices[used],
        together.astype(np.int32),
        np.zeros((sum(counts), 3, 2)),
        np.repeat([numbers[part.material] for part in parts], counts).astype(np.int32),
        None if all(part.normals is None for part in parts) else np.concatenate(normals),
        None if all(part.colors is None for part in parts) else np.concatenate(colors),
        tuple(
            np.concatenate([_of_corners(*pair, (0, 0)) for pair in zip(parts, layer, strict=True)])
            for layer in zip_longest(*(part.layers for part in parts))
        ),
    )
    return mesh, materials


def used_vertices(
    faces: NDArray[np.int64], count: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return which of so many vertices faces (F, 3) use, and the faces between these alone."""
    used = np.zeros(count, np.bool_)
    used[faces] = True
    return used, (np.cumsum(used) - 1)[faces]


def _of_corners(part: Part, values: Floats | None, missing: tuple[float, ...]) -> Floats:
    """Return values (F, 3, K) of the corners of a part, of those of its vertices."""
    if values is not None:
        return np.asarray(values, np.float32)[part.faces]
    return np.broadcast_to(np.asarray(missing, np.float32), (len(part.faces), 3, len(missing)))


def _colors(part: Part) -> Floats:
    if part.colors is not None and part.colors.ndim == 3:
        return np.repeat(part.colors, 3, axis=1)
    return _of_corners(part, part.colors, (1, 1, 1, 1))


def light(codes: ArrayLike) -> Floats:
    """Return sRGB colors (N, 3) in 0…1 as linear ones (N, 4) without transparency."""
    values = linear(np.clip(codes, 0, 1)).astype(np.float32)
    return np.pad(values, ((0, 0), (0, 1)), constant_values=1)


def fractions(codes: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB codes as 0…1: whole ones, or those beyond it, are of 8 bits or of 16."""
    largest = codes.max(initial=0, where=np.isfinite(codes))
    if codes.dtype.kind == "f" and largest < 2:
        return codes
    return np.asarray(codes / (255 if largest <= 255 else 65535))


def unit_normals(vectors: NDArray[np.float64]) -> Floats:
    """Return vectors (N, 3) of length one, NaN where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    found = np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 0)
    return np.asarray(found, np.float32)


def check_finite(points: NDArray[np.float64]) -> None:
    """Raise a DataError unless vertices are finite."""
    if not np.isfinite(points).all():
        raise DataError("expected finite vertices, got NaN or infinity")


def check_shape(points: NDArray[np.float64], faces: NDArray[Any]) -> None:
    """Raise a DataError unless vertices (V, 3) are finite, and faces (F, N) between them."""
    check_finite(points)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
        got = f"{faces.min()}…{faces.max()}"
        raise DataError(f"expected faces that name vertices 0…{len(points) - 1}, got {got}")
