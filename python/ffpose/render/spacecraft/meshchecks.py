"""What trimesh does not check of .obj, .ply and .stl files, and reads as something else.

It takes a face of a vertex that does not exist for one of another vertex, leaves out faces that it
does not understand, and is content with the rows that are left of a file that was cut short.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import as_utf8

KINDS = {b"v": "vertices", b"vt": "texture coordinates", b"vn": "normals"}
"""What an OBJ file's faces name, in the order in which a corner has them."""

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL file before its triangles, and of each of them."""


def checked(content: bytes, suffix: str, source: Path) -> bytes:
    """Return a file as trimesh is to read it.

    Args:
        content: The file.
        suffix: Its format, as ``".obj"``.
        source: Its path, for errors.

    Raises:
        DataError: The file is cut short, or a face of an OBJ file is none.
    """
    if suffix == ".obj":
        return _obj(as_utf8(content), source)
    return content


def _obj(content: bytes, source: Path) -> bytes:
    """Return an OBJ file, the faces of which count from its beginning."""
    lines = list(_obj_lines(content))
    totals = dict.fromkeys(KINDS, 0)
    before = [0] * len(KINDS)
    for _, key, _ in lines:
        if key in totals:
            totals[key] += 1
    kinds = [(place, totals[key], name) for place, (key, name) in enumerate(KINDS.items())]
    order, text = list(KINDS), []
    for line, key, rest in lines:
        if key == b"f":
            rest = rest.partition(b"#")[0]
            corners = [corner.split(b"/") for corner in rest.split()]
            if len(corners) < 3:
                raise DataError(f"expected at least 3 corners, got {len(corners)}", source, line)
            counted = False
            for corner in corners:
                if len(corner) > 3 or not corner[0]:
                    raise _no_corner(corner, source, line)
                for (place, total, name), word in zip(kinds, corner, strict=False):
                    if not word:
                        continue
                    try:
                        number = int(word)
                    except ValueError:
                        raise _no_corner(corner, source, line) from None
                    if number < 0:
                        number += before[place] + 1
                        corner[place], counted = b"%d" % number, True
                    if not 0 < number <= total:
                        got = word.decode()
                        message = f"expected one of {total} {name}, counted from 1, got {got}"
                        raise DataError(message, source, line)
            if counted:
                rest = b" ".join(b"/".join(corner) for corner in corners)
        elif key in totals:
            before[order.index(key)] += 1
        text.append(key + b" " + rest)
    return b"\n".join(text)


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


def _no_corner(corner: list[bytes], source: Path, line: int) -> DataError:
    got = b"/".join(corner).decode()
    return DataError(f"expected a corner as 1, 1/1, 1//1 or 1/1/1, got {got!r}", source, line)
