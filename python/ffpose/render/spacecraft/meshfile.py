"""Loading a spacecraft from a mesh file.

The file's origin and axes are the object frame that labels refer to, unless they are moved. Any
triangle mesh works: it need be neither closed nor manifold.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ffpose.errors import DataError, MissingExtraError, expect
from ffpose.geometry.rotations import FloatArray, shortest_turn
from ffpose.render.spacecraft.craft import Craft, bounding_sphere
from ffpose.render.spacecraft.gltf import read_gltf
from ffpose.render.spacecraft.meshassets import MAX_BYTES, Assets, check_kind, one_line
from ffpose.render.spacecraft.obj import read_obj
from ffpose.render.spacecraft.parts import Part, joined
from ffpose.render.spacecraft.ply import read_ply
from ffpose.render.spacecraft.stl import read_stl

FORMATS = (".obj", ".stl", ".ply", ".glb", ".gltf")
MAX_FACES = 2_000_000

READING = 8
"""Version of how files are read; images of a file that was read otherwise are rendered again."""

Up = Literal["x", "y", "z", "-x", "-y", "-z"]
"""An axis of a mesh file."""


def load_craft(
    path: str | Path,
    scale: float = 1.0,
    up: Up = "z",
    *,
    center: bool = False,
    two_sided: bool = False,
) -> Craft:
    """Read a spacecraft from a mesh file and the files that it refers to.

    Args:
        path: A file of one of `FORMATS`.
        scale: Meters per unit of the file.
        up: Axis of the file that becomes the object's z; the shortest turn takes it there.
        center: Move the origin to the middle of the bounding sphere.
        two_sided: Show the back of surfaces too that the file gives one side only.

    Returns:
        The spacecraft, in meters about the file's origin, or the middle of its bounding sphere.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The format is not in `FORMATS`, `scale` is not positive, or `up` is no axis.
        DataError: The file is broken, empty, holds numbers that are not finite, has more than
            `MAX_FACES` faces, all of them in one line, or is larger than `MAX_BYTES`; or a file
            that it refers to is missing or cannot be used.
        MissingExtraError: The file is compressed, or has textures, and the library that reads them
            is not installed.
    """
    source = Path(path)
    expect(source.suffix.lower() in FORMATS, "mesh", f"a file of {', '.join(FORMATS)}", source.name)
    expect(0 < scale < np.inf, "mesh scale", "a positive number", scale)
    expect(up in get_args(Up), "mesh up", f"one of {', '.join(get_args(Up))}", up)
    if source.stat().st_size > MAX_BYTES:
        raise DataError(f"expected at most {MAX_BYTES} bytes, got {source.stat().st_size}", source)
    content, assets = source.read_bytes(), Assets(source)
    check_kind(content, source)
    parts = _read(content, source.suffix.lower(), assets)
    total = sum(len(part.faces) for part in parts)
    if total == 0:
        raise DataError("expected triangles, got none", source)
    if total > MAX_FACES:
        raise DataError(f"expected at most {MAX_FACES} triangles, got {total}", source)
    mesh, materials = joined(parts)
    if not np.ptp(mesh.vertices, axis=0).any():
        raise DataError("expected a mesh of some size, got a single point", source)
    with np.errstate(over="ignore", invalid="ignore"):
        area = float(np.linalg.norm(mesh.face_normals, axis=1).sum() / 2)
    if not 0 < area < np.inf:
        raise DataError(f"expected triangles that have an area, got {area:g} together", source)
    mesh = replace(mesh, vertices=mesh.vertices * scale).moved(_raised(up))
    if center:
        mesh = mesh.moved(shift=-bounding_sphere(mesh.vertices)[0])
    if two_sided:
        materials = tuple(replace(material, two_sided=True) for material in materials)
    # The name goes into the manifest, so it must identify everything the images depend on.
    digest = assets.digest(content)
    changes = [f"scale:{scale!r}", f"up:{up}", f"reading:{READING}"]
    changes += ["centered"] * center + ["two-sided"] * two_sided
    return Craft(
        f"{source.name} sha256:{digest} {' '.join(changes)}", mesh, materials, is_even=False
    )


def _read(content: bytes, suffix: str, assets: Assets) -> list[Part]:
    """Return the parts of a file of a format."""
    try:
        if suffix == ".obj":
            return read_obj(content, assets)
        if suffix == ".stl":
            return read_stl(content)
        if suffix == ".ply":
            return read_ply(content, assets)
        return read_gltf(content, assets, MAX_FACES)
    except MissingExtraError:
        raise
    except DataError as error:
        if error.file is None:  # which readers leave to this
            raise DataError(error.message, assets.source, error.line) from error
        raise
    except Exception as error:  # a broken file has anything in place of what is expected
        what = "a glTF document" if suffix in (".glb", ".gltf") else "a triangle mesh"
        raise DataError(f"expected {what}, got {one_line(error)}", assets.source) from error


def _raised(up: Up) -> FloatArray:
    """Return the rotation (3, 3) that takes an axis to z by the shortest turn."""
    if up == "-z":
        return np.diag([1.0, -1.0, -1.0])
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up.startswith("-") else 1)
    return shortest_turn(axis, np.array([0.0, 0.0, 1.0]))
