"""Reading OBJ files: polygons by materials, whose corners may have texture coordinates and normals.

Some programs write colors behind the coordinates of vertices: they are sRGB, and count where the
material has no color and no texture of it. Vertices and corners without any of these are white,
without a place in the texture and with the normal that their faces have.
"""

from __future__ import annotations

import logging
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import chain, zip_longest

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import Assets, as_utf8
from ffpose.render.spacecraft.mtl import MtlMaterials, read_libraries
from ffpose.render.spacecraft.parts import Part, check_finite, fractions, light, unit_normals
from ffpose.render.spacecraft.polygons import triangulated

logger = logging.getLogger(__name__)

KINDS = {b"v": "vertices", b"vt": "texture coordinates", b"vn": "normals"}
"""What a file's faces name, in the order in which a corner has them."""


COLORS = b"v rgb"
"""What stands for the colors of vertices among the keywords: no keyword has a blank."""


def read_obj(content: bytes, assets: Assets) -> list[Part]:
    """Read the parts of an OBJ file, one of each material.

    Raises:
        DataError: A line is none, or a material, an MTL file or a texture that it names is missing
            or cannot be used.
    """
    shape = _Shape(as_utf8(content))
    given = read_libraries(shape.libraries, shape.polygons, assets)
    materials = MtlMaterials(given, assets)
    return [_part(shape, name, materials, assets) for name in shape.polygons]


def _part(shape: _Shape, name: str, materials: MtlMaterials, assets: Assets) -> Part:
    """Return the faces of a material."""
    faces = np.concatenate(
        [shape.triangles(size, its) for size, its in shape.polygons[name].items()]
    )
    # Each corner as 24 bytes in the order of its numbers: faster than rows of numbers.
    corners, numbers = np.unique(faces.astype(">i8").view("V24"), return_inverse=True)
    vertex, place, normal = corners.view(">i8").reshape(-1, 3).T
    colors = shape.colors[vertex]
    colored = not materials.has_color(name) and bool(np.isfinite(colors).any())
    material, sources = materials.get(name, colored=colored)
    if sources and (place < 0).all():
        text = "%s: material %r has a texture and no texture coordinates: of one color"
        logger.warning(text, assets.source, name)
    places = shape.places[place] * (1, -1) + (0, 1)
    return Part(
        shape.points[vertex],
        numbers.reshape(-1, 3),
        material,
        unit_normals(shape.normals[normal]) if (normal >= 0).any() else None,
        light(np.nan_to_num(colors, nan=1.0)) if colored else None,
        tuple(source.transformed(places) for source in sources),
    )


class _Shape:
    """What an OBJ file's lines say.

    Attributes:
        points: (V, 3) vertices.
        colors: (V, 3) their colors, NaN where they have none.
        places: (T + 1, 2) texture coordinates from the lower left; the last is of what has none.
        normals: (N + 1, 3) normals; the last is of what has none.
        polygons: By material and number of corners the numbers of vertex, texture coordinates and
            normal of each corner, from zero; -1 where it has none.
        libraries: Lines that name MTL files.
    """

    def __init__(self, content: bytes) -> None:
        lines = list(_lines(content))
        self._totals = Counter(key for _, key, _ in lines)
        self._before = Counter[bytes]()
        self._numbers = defaultdict[bytes, "array[float]"](lambda: array("d"))
        self.polygons: dict[str, dict[int, array[int]]] = {}
        self.libraries: list[str] = []
        material = ""
        for number, key, rest in lines:
            self._before[key] += 1
            try:
                if key in KINDS:
                    self._add(key, rest.partition(b"#")[0].split())
                elif key == b"f":
                    corners = [self._corner(word) for word in rest.partition(b"#")[0].split()]
                    if len(corners) < 3:
                        raise ValueError(f"expected at least 3 corners, got {len(corners)}")
                    its = self.polygons.setdefault(material, defaultdict(lambda: array("q")))
                    its[len(corners)].extend(chain.from_iterable(corners))
            except ValueError as error:
                raise DataError(str(error), line=number) from None
            if key == b"usemtl":
                material = b" ".join(rest.split()).decode(errors="replace")
            elif key == b"mtllib":
                self.libraries.append(rest.strip().decode(errors="replace"))
        self.points = np.array(self._numbers[b"v"]).reshape(-1, 3)
        self.colors = fractions(np.array(self._numbers[COLORS]).reshape(-1, 3))
        self.places = np.append(self._numbers[b"vt"], [0, 0]).reshape(-1, 2)
        self.normals = np.append(self._numbers[b"vn"], np.full(3, np.nan)).reshape(-1, 3)

    def _add(self, key: bytes, words: list[bytes]) -> None:
        """Note a vertex, texture coordinates or a normal."""
        if key == b"v":
            self._numbers[key].extend(_floats(words, 3))
            self._numbers[COLORS].extend(_floats(words[3:], 3) if len(words) >= 6 else [np.nan] * 3)
        elif key == b"vt":  # a texture of one row has coordinates of one number
            self._numbers[key].extend(
                _floats(words, 2) if len(words) > 1 else [*_floats(words, 1), 0]
            )
        else:
            try:
                self._numbers[key].extend(_floats(words, 3))
            except ValueError:  # as -nan(ind): it follows from the shape
                self._numbers[key].extend([np.nan] * 3)

    def _corner(self, word: bytes) -> list[int]:
        """Return the numbers of a corner; negative ones count back from its line."""
        words, numbers = word.split(b"/"), list[int]()
        if not words[0] or len(words) > len(KINDS):
            raise _no_corner(word)
        for given, key in zip_longest(words, KINDS, fillvalue=b""):
            if not given:
                numbers.append(-1)
                continue
            try:
                number = int(given)
            except ValueError:
                raise _no_corner(word) from None
            number += self._before[key] if number < 0 else -1
            if not 0 <= number < self._totals[key]:
                text = f"expected one of {self._totals[key]} {KINDS[key]}, counted from 1"
                raise ValueError(f"{text}, got {given.decode()}")
            numbers.append(number)
        return numbers

    def triangles(self, size: int, numbers: array[int]) -> NDArray[np.int64]:
        """Return the corners (F, 3, 3) of the triangles of polygons of so many corners."""
        corners = np.array(numbers, np.int64).reshape(-1, size, 3)
        points = self.points[corners[..., 0]]
        check_finite(points)
        polygon = np.arange(len(corners))[:, None, None]
        return corners[polygon, triangulated(points)].reshape(-1, 3, 3)


def _floats(words: list[bytes], count: int) -> list[float]:
    """Return the first numbers of a line."""
    if len(words) < count:
        raise ValueError(f"expected {count} coordinates, got {len(words)}")
    try:
        return [float(word) for word in words[:count]]
    except ValueError:
        got = b" ".join(words[:count]).decode(errors="replace")
        raise ValueError(f"expected coordinates as 1.5 -2 3e-4, got {got!r}") from None


def _lines(content: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield number, first word and rest of a file's lines; a backslash continues one."""
    start, held = 0, b""
    for number, line in enumerate(chain(content.replace(b"\t", b" ").splitlines(), [b""]), 1):
        line = line.strip()
        if line.startswith(b"#"):
            continue
        if line.endswith(b"\\"):
            start, held = start or number, held + line[:-1] + b" "
            continue
        key, _, rest = (held + line).partition(b" ")
        yield start or number, key, rest
        start, held = 0, b""


def _no_corner(word: bytes) -> ValueError:
    got = word.decode(errors="replace")
    return ValueError(f"expected a corner as 1, 1/1, 1//1 or 1/1/1, got {got!r}")
