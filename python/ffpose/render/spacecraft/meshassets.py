"""The files that a mesh file refers to: materials, textures and buffers."""

from __future__ import annotations

import codecs
import hashlib
import io
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ffpose.errors import DataError, require

MAX_BYTES = 1 << 30
"""Largest size of a mesh file, and of each file that it refers to."""

WEB_PAGE = "a web page: download the file that it shows"
OTHERS = {
    b"version https://git-lfs": "a Git LFS pointer: git lfs pull gets the file",
    b"<!doctype html": WEB_PAGE,
    b"<html": WEB_PAGE,
    b"pk\x03\x04": "a ZIP archive: unpack it",
    b"\x1f\x8b": "a gzip archive: unpack it",
    b"iso-10303-21": "a STEP file: export it as triangles, as STL or glTF",
}
"""What is met in place of a file of its name, by its beginning in small letters."""

NO_MATERIALS = ": put it there, or delete the line that names it for a gray spacecraft"


class Assets:
    """The files beside a mesh file, by the names that it gives them.

    Attributes:
        source: The mesh file.
    """

    def __init__(self, source: Path) -> None:
        self.source = source
        self._digests: dict[str, str] = {}
        self._folders = [source.parent.resolve()]

    def get(self, name: str, missing: str = "") -> bytes:
        """Return the content of a file, and keep its digest.

        A DataError if there is no such file, which ends with what is said for ``missing`` ones, or
        it is outside of the mesh file's folder, or too large.
        """
        path = self._find(name)
        if path is None:
            raise DataError(f"expected {name!r}, which it refers to, got no such file{missing}")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DataError(f"expected at most {MAX_BYTES} bytes, got {size}", path)
        content = path.read_bytes()
        check_kind(content, path)
        self._digests[name] = hashlib.sha256(content).hexdigest()
        return content

    def libraries(self, lines: Collection[str]) -> list[bytes]:
        """Return the MTL files that lines of an OBJ file name; textures may be beside them."""
        names = dict.fromkeys(name for line in lines for name in self._names(line))
        contents = [as_utf8(self.get(name, NO_MATERIALS)) for name in names]
        self._folders += [path.parent for name in names if (path := self._find(name))]
        return contents

    def _names(self, line: str) -> list[str]:
        """Return the names on a line: several, or one that has spaces."""
        try:
            words = line.split()
            return words if all(self._find(word) for word in words) else [line]
        except DataError:  # one is outside of the folder, which its reading tells
            return [line]

    def digest(self, content: bytes) -> str:
        """Return the SHA-256 of a mesh file, or of it and of all files that were read for it."""
        own = hashlib.sha256(content).hexdigest()
        if not self._digests:
            return own
        listed = json.dumps([own, *sorted(self._digests.items())])
        return hashlib.sha256(listed.encode()).hexdigest()

    def _find(self, name: str) -> Path | None:
        """Return the file of a name: a URI, a path, or one of a computer where it was written."""
        plain = unquote(name).strip().replace("\\", "/")
        outside = False
        for folder in self._folders:
            for candidate in (name.strip(), plain, plain.rsplit("/", 1)[-1]):
                path = folder / candidate
                if candidate and path.is_file():
                    if path.resolve().is_relative_to(self._folders[0]):
                        return path
                    outside = True
        if outside:
            raise DataError(f"expected files in its folder, got {name!r}, which is outside")
        return None


def check_kind(content: bytes, path: Path) -> None:
    """Raise a DataError if a file is one of `OTHERS`."""
    head = content[:64].removeprefix(codecs.BOM_UTF8).lstrip().lower()
    for beginning, text in OTHERS.items():
        if head.startswith(beginning):
            raise DataError(f"expected a file of its name's format, got {text}", path)


def open_image(content: bytes, name: str) -> Any:
    """Open an image with Pillow; a DataError if the content is none."""
    pillow = require("PIL.Image", "render")
    try:
        return pillow.open(io.BytesIO(content))
    except Exception as error:  # Pillow's readers raise anything
        text = f"expected texture {name} that can be decoded, got {one_line(error)}"
        raise DataError(text) from error


def one_line(error: BaseException) -> str:
    """Return an error's kind and text on one line."""
    if isinstance(error, KeyError):
        return f"one without {error}"
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")


def as_utf8(content: bytes) -> bytes:
    """Return a text file in UTF-8 without a mark, as .obj and .mtl files of old programs are not.

    UTF-16 has a byte order mark; what is neither that nor UTF-8 is taken for Latin-1.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace").encode()
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1").encode()
    return content.removeprefix(codecs.BOM_UTF8)
