"""What trimesh does not check of .obj, .ply and .stl files, and reads as something else.

It takes a face of a vertex that does not exist for one of another vertex, leaves out faces that it
does not understand, is content with the rows that are left of a file that was cut short, and fills
what is outside of a concave polygon. Binary PLY files it reads if all faces have as many corners.
"""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import Assets, as_utf8
from ffpose.render.spacecraft.polygons import folded, triangles

MAPPED = re.compile(rb"(?m)^(property\s[^\n]*\s)(s|t|u|v|texture_u|texture_v|texcoord)(?=\s*$)")
"""Texture coordinates in the head of a PLY file."""

SOLID = re.compile(rb"(?im)^([ \t]*(?:end)?solid)\b[^\r\n]*")
"""The line of a solid's name in an ASCII STL file."""

KINDS = {b"v": "vertices", b"vt": "texture coordinates", b"vn": "normals"}
"""What an OBJ file's faces name, in the order in which a corner has them."""

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL file before its triangles, and of each of them."""

Properties = list[tuple[str, str]]
"""Codes of the length of a list, empty where there is none, and of the values of each property."""

PLY_CODES = {b"char": "b", b"short": "h", b"int": "i", b"float": "f", b"double": "d"}
PLY_CODES |= {b"int8": "b", b"int16": "h", b"int32": "i", b"float32": "f", b"float64": "d"}
PLY_CODES |= {b"uchar": "B", b"ushort": "H", b"uint": "I"}
PLY_CODES |= {b"uint8": "B", b"uint16": "H", b"uint32": "I"}
"""Codes of the module struct for a PLY file's types."""


def checked(content: bytes, suffix: str, assets: Assets) -> bytes:
    """Return a file of a format such as ``".obj"`` as trimesh is to read it, with ``assets``.

    A DataError if it is cut short, or a face of an OBJ file is none.
    """
    if suffix == ".obj":
        return _obj(as_utf8(content), assets)
    if suffix == ".stl":
        return _stl(content, assets.source)
    return _ply(content, assets.source)


def _obj(content: bytes, assets: Assets) -> bytes:
    """Return an OBJ file, the faces of which count from its beginning and have no other inside.

    Where some faces of a material have texture coordinates, all have: trimesh would leave out all.
    ``assets`` learns which materials and libraries it names.
    """
    lines = list(_obj_lines(content))
    before, totals = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
    for _, key, _ in lines:
        if key in totals:
            totals[key] += 1
    text, points, polygons = list[bytes](), list[list[float]](), dict[int, list[bytes]]()
    material, mapped, bare = b"", set[bytes](), dict[int, bytes]()
    for line, key, rest in lines:
        if key in before:
            before[key] += 1
        if key in KINDS or key == b"f":
            rest = rest.partition(b"#")[0]
        elif key == b"usemtl":
            material = rest
            assets.used.add(b" ".join(rest.split()))
        elif key == b"mtllib":
            assets.libraries.append(rest.strip().decode(errors="replace"))
        try:
            if key == b"v":
                points.append(_point(rest))
            elif key == b"f":
                corners = _face(rest, before, totals)
                if len(corners) > 3:
                    polygons[len(text)] = corners
                if all(corner.split(b"/")[1:2] > [b""] for corner in corners):
                    mapped.add(material)
                else:
                    bare[len(text)] = material
                rest = b" ".join(corners)
        except ValueError as error:
            raise DataError(str(error), assets.source, line) from None
        text.append(key + b" " + rest)
    text.append(b"vt 0 0")
    for place, its in bare.items():
        if its in mapped:
            corners = [_mapped(c, totals[b"vt"] + 1) for c in text[place].split()[1:]]
            text[place] = b"f " + b" ".join(corners)
            if place in polygons:
                polygons[place] = corners
    for place, faces in _clipped(polygons, points):
        text[place] = b"\n".join(b"f " + b" ".join(face) for face in faces)
    return b"\n".join(text)


def _mapped(corner: bytes, number: int) -> bytes:
    """Return a corner of an OBJ file with the texture coordinates of a number if it has none."""
    vertex, own, *normal = [*corner.split(b"/"), b""][:3] if b"/" in corner else [corner, b""]
    return b"/".join([vertex, own or b"%d" % number, *filter(None, normal)])


def _point(words: bytes) -> list[float]:
    """Return the coordinates of an OBJ file's vertex."""
    given = words.split()[:3]
    if len(given) < 3:
        raise ValueError(f"expected 3 coordinates, got {len(given)}")
    try:
        return [float(word) for word in given]
    except ValueError:
        got = b" ".join(given).decode(errors="replace")
        raise ValueError(f"expected coordinates as 1.5 -2 3e-4, got {got!r}") from None


def _clipped(
    polygons: dict[int, list[bytes]], points: list[list[float]]
) -> Iterator[tuple[int, list[list[bytes]]]]:
    """Yield places and triangles of the polygons that fans from their first corners do not fill."""
    by_length: dict[int, list[int]] = {}
    for place, corners in polygons.items():
        by_length.setdefault(len(corners), []).append(place)
    vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
    for places in by_length.values():
        numbers = [[int(c.partition(b"/")[0]) - 1 for c in polygons[place]] for place in places]
        shapes = vertices[np.array(numbers)]
        for k in np.flatnonzero(folded(shapes)):
            corners = polygons[places[k]]
            faces = triangles(shapes[k])
            yield places[k], [[corners[number] for number in face] for face in faces]


def _face(words: bytes, before: dict[bytes, int], totals: dict[bytes, int]) -> list[bytes]:
    """Return the corners of an OBJ file's face, of which negative numbers count from its line."""
    corners = [corner.split(b"/") for corner in words.split()]
    if len(corners) < 3:
        raise ValueError(f"expected at least 3 corners, got {len(corners)}")
    counted = False
    for corner in corners:
        if not corner[0] or len(corner) > len(KINDS):
            raise _no_corner(corner)
        for place, (word, key) in enumerate(zip(corner, KINDS, strict=False)):
            if not word:
                continue  # between slashes: the corner has no texture coordinates
            try:
                number = int(word)
            except ValueError:
                raise _no_corner(corner) from None
            if number < 0:
                number += before[key] + 1
                corner[place], counted = b"%d" % number, True
            if not 0 < number <= totals[key]:
                text = f"expected one of {totals[key]} {KINDS[key]}, counted from 1"
                raise ValueError(f"{text}, got {word.decode()}")
    return [b"/".join(corner) for corner in corners] if counted else words.split()


def _obj_lines(content: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield number, first word and rest of an OBJ file's lines; a backslash continues one."""
    start, held = 0, b""
    for number, line in enumerate(content.replace(b"\t", b" ").splitlines(), 1):
        line = line.strip()
        if line.startswith(b"#"):
            continue
        if line.endswith(b"\\"):
            start, held = start or number, held + line[:-1] + b" "
            continue
        key, _, rest = (held + line).partition(b" ")
        yield start or number, key, rest
        start, held = 0, b""
    if held:
        key, _, rest = held.partition(b" ")
        yield start, key, rest


def _no_corner(corner: list[bytes]) -> ValueError:
    got = b"/".join(corner).decode()
    return ValueError(f"expected a corner as 1, 1/1, 1//1 or 1/1/1, got {got!r}")


def _stl(content: bytes, source: Path) -> bytes:
    """Return an STL file: a binary one of the size that its head states, or a text."""
    stated = int.from_bytes(content[80:STL_HEAD], "little")
    size = STL_HEAD + STL_TRIANGLE * stated
    if len(content) == size:
        return content
    if content[:3] == codecs.BOM_UTF8 or content.lstrip()[:5].lower() == b"solid":
        solid = as_utf8(content)
        if b"\0" not in solid:
            if b"outer loop" in solid.lower().rpartition(b"endsolid")[2]:
                raise DataError("expected endsolid, got none: the file is cut short", source)
            return SOLID.sub(rb"\1", solid)  # trimesh counts the word vertex in names too
    if len(content) < STL_HEAD:
        text = f"expected {STL_HEAD} bytes before the triangles, got {len(content)}"
        raise DataError(text, source)
    found = (len(content) - STL_HEAD) // STL_TRIANGLE
    end = ": the file is cut short" if len(content) < size else ""
    text = f"expected {stated} triangles in {size} bytes, as stated, got {found} in {len(content)}"
    raise DataError(text + end, source)


def _ply(content: bytes, source: Path) -> bytes:
    """Return a PLY file: a text with as many rows and values as its head states, or a binary file.

    A binary file of polygons becomes a text, and polygons become triangles.
    """
    head, mark, body = content.partition(b"end_header")
    if not mark:
        raise DataError("expected a head that ends with end_header, got none", source)
    textures = set(re.findall(rb"(?m)^comment\s+TextureFile\s+(\S[^\r\n]*)", head))
    if len(textures) > 1:
        got = f"{len(textures)}: save it as OBJ or glTF"
        raise DataError(f"expected a PLY file of at most one texture, got {got}", source)
    if not textures:  # for coordinates without one trimesh would drop the colors
        head = MAPPED.sub(rb"\1_\2", head)
    content = head + mark + body
    lines = [line.split() for line in head.splitlines()]
    forms = [words[1] for words in lines if words[:1] == [b"format"] and len(words) > 1]
    if forms[:1] != [b"ascii"]:
        order = ">" if forms[:1] == [b"binary_big_endian"] else "<"
        body = body.partition(b"\n")[2]
        if _all_alike(body, lines, order, source):
            return content
        head = head.replace(forms[0], b"ascii", 1)
        body = b"\n".join([b"", *_unpacked(body, lines, order, source)])
    rows = [row.split() for row in body.rstrip().split(b"\n")[1:]]
    names = iter(_names(lines))
    start, points, cut = 0, list[list[float]](), list[list[bytes]]()
    for name, count, properties in _ply_elements(lines, source):
        its = [next(names) for _ in properties]
        found = rows[start : start + count]
        if len(found) < count:
            text = f"expected {count} rows of {name}, as stated, got {len(found)}"
            raise DataError(f"{text}: the file is cut short", source)
        for line, row in enumerate(found, len(lines) + 2 + start):
            expected = _row_length(row, properties)
            if len(row) < expected:
                text = f"expected {expected} values of {name}, got {len(row)}"
                raise DataError(text, source, line)
        start += count
        if name == "vertex":
            if missing := {b"x", b"y", b"z"}.difference(its):
                text = ", ".join(sorted(axis.decode() for axis in missing))
                raise DataError(f"expected x, y and z of each vertex, got none of {text}", source)
            places = [its.index(axis) for axis in (b"x", b"y", b"z")]
            points = [[float(row[place]) for place in places] for row in found]
        if name == "face":
            place = _corners_at(its, properties)
            found = [part for row in found for part in _cut(row, properties, place, points)]
            head = re.sub(rb"(element\s+face\s+)\d+", rb"\g<1>%d" % len(found), head)
        cut += found
    return head + mark + b"\n" + b"\n".join([*map(b" ".join, cut), b""])


def _names(lines: list[list[bytes]]) -> list[bytes]:
    """Return the names of a PLY head's properties."""
    return [words[-1] for words in lines if words[:1] == [b"property"]]


def _corners_at(names: Sequence[bytes], properties: Properties) -> int | None:
    """Return which property of a face are its corners: the list of that name, or the first."""
    lists = [place for place, (length, _) in enumerate(properties) if length]
    named = [place for place in lists if names[place] in (b"vertex_index", b"vertex_indices")]
    return next(iter(named or lists), None)


def _cut(
    row: list[bytes], properties: Properties, place: int | None, points: list[list[float]]
) -> Iterator[list[bytes]]:
    """Yield the rows of a polygon's triangles: trimesh would leave their colors to the polygon.

    ``place`` is that of the corners among the properties. Fewer than three are no face.
    """
    cells, at = list[list[bytes]](), 0
    for length, _ in properties:
        size = 1 + int(row[at]) if length else 1
        cells.append(row[at : at + size])
        at += size
    listed = [] if place is None else cells[place][1:]
    number = len(listed)
    if number <= 3:
        yield from [row] if number == 3 or place is None else []
        return
    faces = [(0, k, k + 1) for k in range(1, number - 1)]
    corners = [int(word) for word in listed]
    if min(corners) >= 0 and max(corners) < len(points):  # what else is told of the triangles
        shape = np.array([points[corner] for corner in corners])
        faces = triangles(shape) if folded(shape[None])[0] else faces
    for face in faces:
        yield [word for cell in cells for word in _of_face(cell, number, face)]


def _of_face(cell: list[bytes], number: int, face: Sequence[int]) -> list[bytes]:
    """Return a triangle's share of a property: of a list by corners the values of its own."""
    width, rest = divmod(len(cell) - 1, number)
    if not width or rest:
        return cell
    values = [cell[1 + k * width + i] for k in face for i in range(width)]
    return [b"%d" % len(values), *values]


def _ply_elements(lines: list[list[bytes]], source: Path) -> list[tuple[str, int, Properties]]:
    """Return name and number of a PLY head's elements, and codes of their properties."""
    elements: list[tuple[str, int, Properties]] = []
    for words in lines:
        if words[:1] == [b"element"]:
            elements.append((words[1].decode(), int(words[2]), []))
            if elements[-1][1] < 0:
                raise ValueError(f"expected at least 0 rows, got {elements[-1][1]}")
        elif words[:1] == [b"property"]:
            kinds = words[2:4] if words[1] == b"list" else words[1:2]
            for kind in kinds:
                if kind not in PLY_CODES:
                    got = kind.decode(errors="replace")
                    raise DataError(f"expected a type of PLY files, got {got}", source)
            length = PLY_CODES[kinds[0]] if kinds[1:] else ""
            elements[-1][2].append((length, PLY_CODES[kinds[-1]]))
    return elements


def _all_alike(body: bytes, lines: list[list[bytes]], order: str, source: Path) -> bool:
    """Return whether all rows of an element are as long as its first, and faces triangles."""
    at, names = 0, iter(_names(lines))
    try:
        for name, count, properties in _ply_elements(lines, source):
            place = _corners_at([next(names) for _ in properties], properties)
            if count:
                words, end = _binary_row(body, at, properties, order)
                if name == "face" and place is not None:
                    before, _ = _binary_row(body, at, properties[:place], order)
                    if words[len(before)] != b"3":
                        return False
                at += count * (end - at)
    except struct.error:
        return False
    return at == len(body)


def _unpacked(body: bytes, lines: list[list[bytes]], order: str, source: Path) -> Iterator[bytes]:
    """Yield the rows of a binary PLY file as text."""
    at = 0
    for name, count, properties in _ply_elements(lines, source):
        for row in range(count):
            try:
                words, at = _binary_row(body, at, properties, order)
            except struct.error:
                text = f"expected {count} rows of {name}, as stated, got {row}"
                raise DataError(f"{text}: the file is cut short", source) from None
            yield b" ".join(words)
    if at < len(body):
        raise DataError(f"expected {at} bytes after the head, got {len(body)}", source)


def _binary_row(
    body: bytes, at: int, properties: Properties, order: str
) -> tuple[list[bytes], int]:
    """Return the words of a row, in which the length of a list precedes it, and where it ends."""
    words: list[bytes] = []
    for length, code in properties:
        number = 1
        if length:
            (number,) = struct.unpack_from(order + length, body, at)
            words.append(b"%d" % number)
            at += struct.calcsize(order + length)
        form = f"{order}{number}{code}"
        words += [repr(value).encode() for value in struct.unpack_from(form, body, at)]
        at += struct.calcsize(form)
    return words, at


def _row_length(row: list[bytes], properties: Properties) -> int:
    """Return the number of values of a row, in which the length of a list precedes it."""
    if not any(length for length, _ in properties):
        return len(properties)
    count = 0
    for length, _ in properties:
        count += 1 + (int(row[count]) if length and count < len(row) else 0)
    return count
