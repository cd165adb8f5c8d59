"""Reading PLY files, as text or binary: polygons with colors of vertices or faces, or a texture.

Colors are sRGB. Properties that are none of these are left out.
"""

from __future__ import annotations

import logging
import math
import re
import struct
from collections import defaultdict
from collections.abc import Collection, Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import Assets
from ffpose.render.spacecraft.mtl import MtlMaterials
from ffpose.render.spacecraft.parts import Part, check_shape, fractions, light, unit_normals
from ffpose.render.spacecraft.polygons import triangulated

logger = logging.getLogger(__name__)

CODES = {"char": "b", "short": "h", "int": "i", "float": "f", "double": "d"}
CODES |= {"int8": "b", "int16": "h", "int32": "i", "float32": "f", "float64": "d"}
CODES |= {"uchar": "B", "ushort": "H", "uint": "I", "uint8": "B", "uint16": "H", "uint32": "I"}
"""Codes of the module struct, and of NumPy, for a file's types."""

TEXTURE = re.compile(rb"(?m)^comment\s+TextureFile\s+(\S[^\r\n]*)")

FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")

CORNERS = ("vertex_index", "vertex_indices")
"""Names of the list of a face's vertices; of others the first list is taken."""

COORDINATES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))
"""Names of a vertex's texture coordinates; a face may have a list of its corners', texcoord."""

XYZ, NORMAL, RGB = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")


class Property(NamedTuple):
    """A property of an element: codes of its values and, of a list, of their number."""

    name: str
    code: str
    length: str = ""

    @property
    def of_text(self) -> Property:
        """The same in a text, which has no widths."""
        return Property(self.name, "d" if self.code in "fd" else "q", "I" if self.length else "")


class Element(NamedTuple):
    """Rows of a file: vertices, faces or others."""

    name: str
    rows: int
    properties: list[Property]


Triangles = tuple[NDArray[Any], NDArray[Any] | None, NDArray[Any] | None]
"""Vertex numbers (F, 3), linear colors (F, 4), and texture coordinates (F, 3, 2), if given."""


def read_ply(content: bytes, assets: Assets) -> list[Part]:
    """Read a PLY file.

    Raises:
        DataError: It has no head, is cut short or, a binary one, longer than its head states, a row
            has too few values or some that are no numbers, a face names no vertex, or the texture
            is missing or cannot be used.
    """
    head, mark, body = content.partition(b"end_header")
    if not mark or head.split(maxsplit=1)[:1] != [b"ply"]:
        raise DataError("expected a head from ply to end_header, got none")
    textures = {name.decode(errors="replace").strip() for name in TEXTURE.findall(head)}
    if len(textures) > 1:
        got = f"{len(textures)}: save it as OBJ or glTF"
        raise DataError(f"expected a PLY file of at most one texture, got {got}")
    lines = [line.split() for line in head.decode(errors="replace").splitlines()]
    elements, body = _elements(lines), body.partition(b"\n")[2]
    form = next((words[1] for words in lines if words[:1] == ["format"] and words[1:]), "none")
    if form not in FORMATS:
        raise DataError(f"expected a format of {', '.join(FORMATS)}, got {form}")
    if form == "ascii":
        elements = [
            each._replace(properties=[its.of_text for its in each.properties]) for each in elements
        ]
        body = _packed(body, elements, len(lines) + 2)
    stated = {its.name for each in elements if each.name == "vertex" for its in each.properties}
    if missing := [axis for axis in XYZ if axis not in stated]:
        raise DataError(f"expected x, y and z of each vertex, got none of {', '.join(missing)}")
    rows = _rows(body, elements, ">" if form == "binary_big_endian" else "<")
    vertices = rows.get("vertex", [])
    names = {name for each in vertices for name in each.dtype.names or () if each[name].ndim == 1}
    vertex = {name: np.concatenate([each[name] for each in vertices]) for name in names}
    if not vertices:
        return []
    points = _stacked(vertex, XYZ).astype(np.float64)
    alike = defaultdict[Any, list[NDArray[np.void]]](list)
    for each in rows.get("face", []):
        alike[each.dtype].append(each)
    faces = [_triangles(np.concatenate(each), points) for each in alike.values()]
    faces = [each for each in faces if len(each[0])]
    return [_part(points, vertex, faces, next(iter(textures), None), assets)] if faces else []


def _elements(lines: list[list[str]]) -> list[Element]:
    """Return the elements that a head states."""
    elements = list[Element]()
    for number, words in enumerate(lines, 1):
        try:
            if words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                *length, kind = words[2:4] if words[1] == "list" else words[1:2]
                its = Property(words[-1], CODES[kind], *(CODES[each] for each in length))
                elements[-1].properties.append(its)
        except KeyError as unknown:
            raise DataError(f"expected a type of PLY files, got {unknown.args[0]}") from None
        except (IndexError, ValueError):
            text = "expected a line as 'element vertex 8' or 'property float x', got"
            raise DataError(f"{text} {' '.join(words)!r}", line=number) from None
    for each in elements:
        names = [its.name for its in each.properties]
        if each.rows < 0 or len(set(names)) < len(names):
            expected = "at least 0 rows of distinct properties"
            got = f"{each.rows} of {', '.join(names)}"
            raise DataError(f"expected of {each.name} {expected}, got {got}")
    return [each for each in elements if each.properties]


def _packed(body: bytes, elements: list[Element], line: int) -> bytes:
    """Return the rows of a text, the first on this line of the file, as a binary file has them."""
    lines, start, packed = [row.split() for row in body.rstrip().splitlines()], 0, bytearray()
    for element in elements:
        rows = lines[start : start + element.rows]
        for number, row in enumerate(rows, line + start):
            try:
                packed += _packed_row(element, row)
            except (ValueError, struct.error) as error:
                raise DataError(f"{element.name}: {error}", line=number) from None
        if len(rows) < element.rows:
            raise _cut_short(element, len(rows))
        start += element.rows
    return bytes(packed)


def _packed_row(element: Element, row: list[bytes]) -> bytes:
    form, values, words = "<", list[float](), iter(row)
    for each in element.properties:
        count = 1
        if each.length:
            (length,) = _numbers(words, 1, Property(each.name, "q", each.length))
            values.append(length)
            count = int(length)
            form += each.length
        values += _numbers(words, count, each)
        form += f"{count}{each.code}"
    return struct.pack(form, *values)


def _numbers(words: Iterator[bytes], count: int, its: Property) -> list[float]:
    """Return the next numbers of a row; a ValueError where there are none that are needed."""
    if count < 0:
        raise ValueError(f"expected lists of at least 0 values, got {count}")
    found = list(islice(words, count))
    if len(found) < count:
        raise ValueError(f"expected {count} of {its.name} in the row, got {len(found)}")
    try:
        return [float(word) if its.code == "d" else int(float(word)) for word in found]
    except (OverflowError, ValueError):
        if its.name in XYZ or its.length:
            got = b" ".join(found[:9]).decode(errors="replace")
            raise ValueError(f"expected numbers of {its.name}, got {got!r}") from None
        return [math.nan if its.code == "d" else 0] * count  # as -nan(ind) of what follows


def _cut_short(element: Element, found: int) -> DataError:
    text = f"expected {element.rows} rows of {element.name}, as stated, got {found}"
    return DataError(f"{text}: the file is cut short")


def _rows(body: bytes, elements: list[Element], order: str) -> dict[str, list[NDArray[np.void]]]:
    """Return by elements the rows of a binary file: runs in which all lists are as long."""
    found, at = defaultdict[str, list[NDArray[np.void]]](list), 0
    for element in elements:
        left = most = element.rows
        while left:
            try:
                kind = _row_type(element, body, at, order)
                whole = min(left, most, (len(body) - at) // kind.itemsize)
            except struct.error:
                whole = 0
            if not whole:
                raise _cut_short(element, element.rows - left)
            rows = np.frombuffer(body, kind, whole, at)
            same = np.ones(whole, np.bool_)
            for each in element.properties:
                if each.length:
                    same &= rows[f" {each.name}"] == rows[f" {each.name}"][0]
            run = whole if same.all() else int(same.argmin())
            found[element.name].append(rows[:run])
            # Where rows differ by turns, to look at all that are left each time would take long.
            left, at, most = left - run, at + run * kind.itemsize, 2 * run
    if at < len(body):
        raise DataError(f"expected {at} bytes after the head, got {len(body)}")
    return found


def _row_type(element: Element, body: bytes, at: int, order: str) -> np.dtype[np.void]:
    """Return the type of rows such as the next one; lengths of lists have a blank in their name."""
    fields, size = list[tuple[Any, ...]](), 0
    for each in element.properties:
        length = 1
        if each.length:
            (length,) = struct.unpack_from(order + each.length, body, at + size)
            if length < 0:
                raise DataError(f"expected lists of at least 0 values, got {length}")
            fields.append((f" {each.name}", order + each.length))
            size += struct.calcsize(order + each.length)
        size += length * struct.calcsize(order + each.code)
        if size > len(body) - at:
            raise struct.error
        if each.length:
            fields.append((each.name, order + each.code, (length,)))
        else:
            fields.append((each.name, order + each.code))
    return np.dtype(fields)


def _stacked(values: Any, names: Collection[str]) -> NDArray[Any]:
    """Return the values (N, K) of properties."""
    return np.stack([values[name] for name in names], axis=1)


def _colors(values: Any, names: Collection[str]) -> NDArray[np.float32] | None:
    """Return the linear colors (N, 4) of rows, None where they have none."""
    if not set(RGB) <= set(names):
        return None
    return light(np.nan_to_num(fractions(_stacked(values, RGB))))


def _triangles(rows: NDArray[np.void], points: NDArray[np.float64]) -> Triangles:
    """Return the triangles of polygons of as many corners: none of those of one or two."""
    names = rows.dtype.names or ()
    lists = [name for name in names if rows[name].ndim == 2]
    name = next((name for name in lists if name in CORNERS), next(iter(lists), None))
    if name is None or rows[name].shape[1] < 3:
        return np.empty((0, 3), np.int64), None, None
    corners = rows[name].astype(np.int64)
    check_shape(points, corners)
    cut, polygon = triangulated(points[corners]), np.arange(len(corners))[:, None, None]
    colors, places = _colors(rows, names), None
    if colors is not None:
        colors = colors.repeat(cut.shape[1], axis=0)
    if "texcoord" in lists:
        places = np.zeros((*corners.shape, 2))
        if rows["texcoord"].shape[1] == 2 * corners.shape[1]:
            places = rows["texcoord"].reshape(places.shape)
        places = places[polygon, cut].reshape(-1, 3, 2)
    return corners[polygon, cut].reshape(-1, 3), colors, places


def _part(
    points: NDArray[np.float64],
    vertex: dict[str, NDArray[Any]],
    triangles: list[Triangles],
    texture: str | None,
    assets: Assets,
) -> Part:
    corners, of_faces, places = zip(*triangles, strict=True)
    faces = np.concatenate(corners)
    colors, normals = _colors(vertex, vertex), None
    if set(NORMAL) <= vertex.keys():
        normals = unit_normals(_stacked(vertex, NORMAL).astype(np.float64))
    pair = next((pair for pair in COORDINATES if set(pair) <= vertex.keys()), None)
    uv: NDArray[Any] | None = None
    if places[0] is not None:
        uv = np.concatenate(places)
    elif pair is not None:
        uv = _stacked(vertex, pair)[faces]
    if texture is not None and uv is None:
        text = "%s: texture %r is left out, as there are no texture coordinates"
        logger.warning(text, assets.source, texture)
    given = {} if texture is None or uv is None else {"map_kd": texture}
    if given:
        colors = None  # which the texture has too
    elif colors is None and of_faces[0] is not None:
        colors = np.concatenate(of_faces)[:, None]
    material, sources = MtlMaterials({"": given}, assets).get("", colored=colors is not None)
    layers = list[NDArray[np.float32]]()
    if uv is not None and sources:  # each corner has a place of its own
        layers = [each.transformed(uv.reshape(-1, 2) * (1, -1) + (0, 1)) for each in sources]
        points = points[faces].reshape(-1, 3)
        normals = None if normals is None else normals[faces].reshape(-1, 3)
        faces = np.arange(len(points)).reshape(-1, 3)
    return Part(points, faces, material, normals, colors, tuple(layers))
