"""What trimesh does not check of .obj, .ply and .stl files, and reads as something else.

It takes a face of a vertex that does not exist for one of another vertex, leaves out faces that it
does not understand, and is content with the rows that are left of a file that was cut short.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from pathlib import Path

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import as_utf8

KINDS = {b"v": "vertices", b"vt": "texture coordinates", b"vn": "normals"}
"""What an OBJ file's faces name, in the order in which a corner has them."""

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL file before its triangles, and of each of them."""


def checked(content: bytes, suffix: str, source: Path) -> bytes:
    """Return a file of a format such as ``".obj"`` as trimesh is to read it.

    A DataError if it is cut short, or a face of an OBJ file is none.
    """
    if suffix == ".obj":
        return _obj(as_utf8(content), source)
    if suffix == ".stl":
        return _stl(content, source)
    _check_ply(content, source)
    return content


def _obj(content: bytes, source: Path) -> bytes:
    """Return an OBJ file, the faces of which count from its beginning."""
    lines = list(_obj_lines(content))
    before, totals = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
    for _, key, _ in lines:
        if key in totals:
            totals[key] += 1
    text = []
    for line, key, rest in lines:
        if key in before:
            before[key] += 1
        elif key == b"f":
            try:
                rest = _face(rest.partition(b"#")[0], before, totals)
            except ValueError as error:
                raise DataError(str(error), source, line) from None
        text.append(key + b" " + rest)
    return b"\n".join(text)


def named_materials(content: bytes) -> tuple[set[bytes], list[str]]:
    """Return the names of the materials that an OBJ file uses, and the lines of its libraries.

    Words of a name are between single spaces.
    """
    used, libraries = set[bytes](), list[str]()
    for _, key, rest in _obj_lines(content):
        if key == b"usemtl":
            used.add(b" ".join(rest.split()))
        elif key == b"mtllib":
            libraries.append(rest.strip().decode(errors="replace"))
    return used, libraries


def _face(words: bytes, before: dict[bytes, int], totals: dict[bytes, int]) -> bytes:
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
    return b" ".join(b"/".join(corner) for corner in corners) if counted else words


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
            return solid
    if len(content) < STL_HEAD:
        text = f"expected {STL_HEAD} bytes before the triangles, got {len(content)}"
        raise DataError(text, source)
    found = (len(content) - STL_HEAD) // STL_TRIANGLE
    end = ": the file is cut short" if len(content) < size else ""
    text = f"expected {stated} triangles in {size} bytes, as stated, got {found} in {len(content)}"
    raise DataError(text + end, source)


def _check_ply(content: bytes, source: Path) -> None:
    """Raise a DataError unless a text in PLY has as many rows and values as its head states.

    Trimesh compares the size of a binary file with its head.
    """
    head, mark, body = content.partition(b"end_header")
    if not mark:
        raise DataError("expected a head that ends with end_header, got none", source)
    lines = [line.split() for line in head.splitlines()]
    if [b"format", b"ascii"] not in [words[:2] for words in lines]:
        return
    rows = [row.split() for row in body.rstrip().split(b"\n")[1:]]
    start = 0
    for name, count, lists in _ply_elements(lines):
        found = rows[start : start + count]
        if len(found) < count:
            text = f"expected {count} rows of {name}, as stated, got {len(found)}"
            raise DataError(f"{text}: the file is cut short", source)
        for line, row in enumerate(found, len(lines) + 2 + start):
            expected = _row_length(row, lists)
            if len(row) < expected:
                text = f"expected {expected} values of {name}, got {len(row)}"
                raise DataError(text, source, line)
        start += count


def _ply_elements(lines: list[list[bytes]]) -> list[tuple[str, int, list[bool]]]:
    """Return name and number of a PLY head's elements, and which of their properties are lists."""
    elements: list[tuple[str, int, list[bool]]] = []
    for words in lines:
        if words[:1] == [b"element"]:
            elements.append((words[1].decode(), int(words[2]), []))
            if elements[-1][1] < 0:
                raise ValueError(f"expected at least 0 rows, got {elements[-1][1]}")
        elif words[:1] == [b"property"]:
            elements[-1][2].append(words[1] == b"list")
    return elements


def _row_length(row: list[bytes], lists: list[bool]) -> int:
    """Return the number of values of a row, in which the length of a list precedes it."""
    if not any(lists):
        return len(lists)
    length = 0
    for is_list in lists:
        length += 1 + (int(row[length]) if is_list and length < len(row) else 0)
    return length
