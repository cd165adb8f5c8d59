"""Loading a spacecraft from a mesh file.

The file's origin and axes are the object frame that labels refer to. Any triangle mesh works: it
need be neither closed nor manifold, and a face is lit on the side from which it is seen. A face has
the mean color of its vertices, material and texture; every surface is matte paint.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError, require
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh
from ffpose.render.spacecraft.meshassets import (
    MAX_BYTES,
    Assets,
    as_utf8,
    check_gltf,
    one_line,
)
from ffpose.render.spacecraft.meshcolors import face_colors, linear

FORMATS = (".obj", ".stl", ".ply", ".glb", ".gltf")
MAX_FACES = 2_000_000
ROUGHNESS = 0.55
COLOR_STEP = 8
"""Quantization step of colors, out of 255: limits the number of materials of a textured mesh."""


def load_craft(path: str | Path, scale: float = 1.0) -> Craft:
    """Read a spacecraft from a mesh file and the files that it refers to.

    Args:
        path: A file of one of `FORMATS`.
        scale: Meters per unit of the file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The format is not in `FORMATS`, or `scale` is not positive.
        DataError: The file is broken, empty, holds numbers that are not finite, has more than
            `MAX_FACES` faces or is larger than `MAX_BYTES`; or a file that it refers to is missing
            or cannot be used.
        MissingExtraError: Trimesh is not installed.
    """
    source = Path(path)
    if source.suffix.lower() not in FORMATS:
        raise ValueError(f"mesh: expected a file of {', '.join(FORMATS)}, got {source.name!r}")
    if not 0 < scale < np.inf:
        raise ValueError(f"mesh scale: expected a positive number, got {scale}")
    if source.stat().st_size > MAX_BYTES:
        raise DataError(f"expected at most {MAX_BYTES} bytes, got {source.stat().st_size}", source)
    content, assets = source.read_bytes(), Assets(source)
    vertices, faces, colors = _read(source, content, assets)
    table, material = np.unique(colors // COLOR_STEP, axis=0, return_inverse=True)
    paints = tuple(Material(_reflectance(row), ROUGHNESS) for row in table)
    mesh = Mesh(
        vertices * scale,
        faces.astype(np.int32),
        np.zeros((len(faces), 3, 2)),
        material.reshape(-1).astype(np.int32),
    )
    # The name goes into the manifest, so it must identify everything the images depend on.
    digest = assets.digest(content)
    return Craft(f"{source.name} sha256:{digest} scale:{scale!r}", mesh, paints)


def _read(
    source: Path, content: bytes, assets: Assets
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
    """Read vertices (V, 3), faces (F, 3) and colors of the faces (F, 3)."""
    trimesh = require("trimesh", "render")
    suffix = source.suffix.lower()
    if suffix in (".glb", ".gltf"):
        check_gltf(content, source)
    try:
        file = io.BytesIO(as_utf8(content) if suffix == ".obj" else content)
        scene = trimesh.load(file, suffix[1:], resolver=assets, force="scene", process=False)
        placed = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
        parts = [part for part in placed if len(part.faces)]
        vertices = [np.asarray(part.vertices, dtype=np.float64) for part in parts]
        faces = [np.asarray(part.faces, dtype=np.int64) for part in parts]
        _check(source, vertices, faces)
        # Of the originals, as those in their place have no vertex colors beside a texture.
        names = [part.metadata["name"] for part in parts]
        colors = {name: face_colors(scene.geometry[name]) for name in dict.fromkeys(names)}
    except DataError:
        raise
    except Exception as error:  # a broken file makes the readers raise anything
        problem = assets.problems[0] if assets.problems else None
        text = f"expected a triangle mesh, got {one_line(error)}"
        raise problem or DataError(text, source) from error
    if assets.problems:
        raise assets.problems[0]
    starts = np.cumsum([0, *map(len, vertices[:-1])])
    return (
        np.concatenate(vertices),
        np.concatenate([part + start for part, start in zip(faces, starts, strict=True)]),
        np.concatenate([colors[name] for name in names]),
    )


def _check(
    source: Path, vertices: list[NDArray[np.float64]], faces: list[NDArray[np.int64]]
) -> None:
    """Raise a DataError unless the parts of a mesh are triangles between finite vertices."""
    total = sum(map(len, faces))
    if total == 0:
        raise DataError("expected triangles, got none", source)
    if total > MAX_FACES:
        raise DataError(f"expected at most {MAX_FACES} triangles, got {total}", source)
    for points, part in zip(vertices, faces, strict=True):
        if points.shape[1:] != (3,) or part.shape[1:] != (3,):
            got = f"{points.shape[1]} and {part.shape[1]}"
            raise DataError(f"expected 3 coordinates and 3 corners, got {got}", source)
        if not np.isfinite(points).all():
            raise DataError("expected finite vertices, got NaN or infinity", source)
        if part.min() < 0 or part.max() >= len(points):
            raise DataError(
                f"expected faces that name vertices 0…{len(points) - 1}, "
                f"got {part.min()}…{part.max()}",
                source,
            )


def _reflectance(code: NDArray[np.uint8]) -> tuple[float, float, float]:
    """Convert an sRGB color divided by `COLOR_STEP` to linear reflectance."""
    red, green, blue = linear((code.astype(float) + 0.5) * COLOR_STEP / 255)
    return float(red), float(green), float(blue)
