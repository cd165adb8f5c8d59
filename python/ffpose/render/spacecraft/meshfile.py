"""Loading a spacecraft from a mesh file.

The file's origin and axes are the object frame that labels refer to. Any triangle mesh works: it
need be neither closed nor manifold, and a face is lit on the side from which it is seen. Colors of
faces or vertices are kept; every surface is matte paint.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError, require
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh

FORMATS = (".obj", ".stl", ".ply", ".glb")
MAX_FACES = 2_000_000
MAX_BYTES = 1 << 30
ROUGHNESS = 0.55
COLOR_STEP = 8
"""Quantization step of colors, out of 255: limits the number of materials of a textured mesh."""


def load_craft(path: str | Path, scale: float = 1.0) -> Craft:
    """Read a spacecraft from a mesh file.

    Args:
        path: A file of one of `FORMATS`.
        scale: Meters per unit of the file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The format is not in `FORMATS`, or `scale` is not positive.
        DataError: The file is broken, empty, holds numbers that are not finite, has more than
            `MAX_FACES` faces or is larger than `MAX_BYTES`.
        MissingExtraError: Trimesh is not installed.
    """
    source = Path(path)
    if source.suffix.lower() not in FORMATS:
        raise ValueError(f"mesh: expected a file of {', '.join(FORMATS)}, got {source.name!r}")
    if not 0 < scale < np.inf:
        raise ValueError(f"mesh scale: expected a positive number, got {scale}")
    if source.stat().st_size > MAX_BYTES:
        raise DataError(f"expected at most {MAX_BYTES} bytes, got {source.stat().st_size}", source)
    content = source.read_bytes()
    vertices, faces, colors = _read(source)
    _check(source, vertices, faces)
    table, material = np.unique(colors // COLOR_STEP, axis=0, return_inverse=True)
    paints = tuple(Material(_linear(row), ROUGHNESS) for row in table)
    mesh = Mesh(
        vertices * scale,
        faces.astype(np.int32),
        np.zeros((len(faces), 3, 2)),
        material.reshape(-1).astype(np.int32),
    )
    # The name goes into the manifest, so it must identify everything the images depend on.
    digest = hashlib.sha256(content).hexdigest()
    return Craft(f"{source.name} sha256:{digest} scale:{scale!r}", mesh, paints)


def _read(
    source: Path,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
    """Read vertices (V, 3), faces (F, 3) and colors of the faces (F, 3)."""
    trimesh = require("trimesh", "render")
    try:
        mesh = trimesh.load(source, force="mesh", process=False)
    except Exception as error:  # a broken file makes the readers raise anything
        raise DataError(f"expected a triangle mesh, got {error!r}", source) from error
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise DataError("expected triangles, got none", source)
    visual = mesh.visual.to_color() if mesh.visual.kind == "texture" else mesh.visual
    return vertices, faces, np.asarray(visual.face_colors, dtype=np.uint8)[:, :3]


def _check(source: Path, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    if len(faces) > MAX_FACES:
        raise DataError(f"expected at most {MAX_FACES} triangles, got {len(faces)}", source)
    if not np.isfinite(vertices).all():
        raise DataError("expected finite vertices, got NaN or infinity", source)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(
            f"expected faces that name vertices 0…{len(vertices) - 1}, "
            f"got {faces.min()}…{faces.max()}",
            source,
        )


def _linear(code: NDArray[np.uint8]) -> tuple[float, float, float]:
    """Convert an sRGB color divided by `COLOR_STEP` to linear reflectance."""
    value = (code.astype(float) + 0.5) * COLOR_STEP / 255
    red, green, blue = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return float(red), float(green), float(blue)
