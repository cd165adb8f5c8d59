"""Reading STL files, and the colors of binary ones: the two bytes after a triangle.

There are two conventions. That of VisCAM and SolidView has blue in the lowest five bits, then green
and red, where bit 15 is set. Magics has red in the lowest, where bit 15 is clear, and a color of
the whole part in the head, for the other triangles. MeshLab writes Magics' head and sets bit 15 of
all triangles with colors; others write the head alone, and zeros.
"""

from __future__ import annotations

import codecs
import re

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.meshassets import as_utf8
from ffpose.render.spacecraft.parts import GRAY, ROUGHNESS, Part, check_finite, light
from ffpose.render.spacecraft.textures import linear

SOLID = re.compile(rb"(?im)^[ \t]*(?:end)?solid\b[^\r\n]*")
"""The line of a solid's name in a text, which may have any word."""

VERTEX = re.compile(rb"(?i)\bvertex\b[ \t]*([^\r\n]*)")
"""A vertex, and the rest of its line."""

LOOP = re.compile(rb"(?i)\bouter\s+loop\b")
"""What the vertices of a triangle follow."""

HEAD = 84
"""Bytes of a binary file before its triangles."""

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("color", "<u2")])

GIVEN = 0x8000
"""Bit 15."""

PART_COLOR = b"COLOR="
"""What precedes the color of the whole part, of a byte for each of red, green, blue and alpha."""


def read_stl(content: bytes) -> list[Part]:
    """Read an STL file: a binary one of the size that its head states, or a text.

    Raises:
        DataError: It is cut short, is of another size, or has vertices that are no numbers.
    """
    stated = int.from_bytes(content[HEAD - 4 : HEAD], "little")
    codes = None
    if len(content) == HEAD + stated * TRIANGLE.itemsize:
        triangles = np.frombuffer(content, TRIANGLE, stated, HEAD)
        points, codes = triangles["corners"], _colors(content[: HEAD - 4], triangles["color"])
    elif (solid := _solid(content)) is not None:
        if b"outer loop" in solid.lower().rpartition(b"endsolid")[2]:
            raise DataError("expected endsolid, got none: the file is cut short")
        outside, *loops = map(VERTEX.findall, LOOP.split(SOLID.sub(b"", solid)))
        if outside:
            raise DataError(
                "expected the vertices of each triangle in an outer loop, got some outside"
            )
        if others := {len(loop) for loop in loops} - {3}:
            raise DataError(f"expected three vertices of each triangle, got {min(others)}")
        points = np.array([_coordinates(rest) for loop in loops for rest in loop]).reshape(-1, 3)
    else:
        raise _other_size(len(content), stated)
    vertices = points.reshape(-1, 3).astype(np.float64)
    check_finite(vertices)
    base = float(linear(GRAY)) if codes is None else 1.0
    return [
        Part(
            vertices,
            np.arange(len(vertices)).reshape(-1, 3),
            Material((base, base, base), ROUGHNESS),
            colors=None if codes is None else light(codes / 255)[:, None],
        )
    ]


def _coordinates(rest: bytes) -> list[float]:
    words = rest.split()[:3]
    try:
        if len(words) == 3:
            return [float(word) for word in words]
    except ValueError:
        pass
    got = rest.strip().decode(errors="replace")
    raise DataError(f"expected coordinates of a vertex as 1.5 -2 3e-4, got {got!r}")


def _solid(content: bytes) -> bytes | None:
    """Return the text that a file is, None where it is none."""
    if content[:3] != codecs.BOM_UTF8 and content.lstrip()[:5].lower() != b"solid":
        return None
    solid = as_utf8(content)
    return None if b"\0" in solid else solid


def _other_size(size: int, stated: int) -> DataError:
    if size < HEAD:
        return DataError(f"expected {HEAD} bytes before the triangles, got {size}")
    needed, found = HEAD + stated * TRIANGLE.itemsize, (size - HEAD) // TRIANGLE.itemsize
    end = ": the file is cut short" if size < needed else ""
    text = f"expected {stated} triangles in {needed} bytes, as stated, got {found} in {size}"
    return DataError(text + end)


def _colors(head: bytes, codes: NDArray[np.uint16]) -> NDArray[np.uint8] | None:
    """Return the sRGB colors (F, 3) of triangles, by their codes (F,); None where they have none.

    ``head`` are the bytes before the number of triangles.
    """
    if len(codes) == 0:
        return None
    _, found, part = head.partition(PART_COLOR)
    levels = np.stack([codes >> shift & 31 for shift in (10, 5, 0)], axis=1)
    own, missing = codes >= GIVEN, np.full(3, round(255 * GRAY))
    if found and len(part) >= 3:
        levels, missing = levels[:, ::-1], np.frombuffer(part, np.uint8, 3)
        colored = np.ptp(codes) > 0 or codes[0] & 0x7FFF not in (0, 0x7FFF)
        if codes.any() and not (own.all() and colored):
            own = ~own
    elif not own.any():
        return None
    colors = np.where(own[:, None], np.round(levels * (255 / 31)), missing)
    return colors.astype(np.uint8)
