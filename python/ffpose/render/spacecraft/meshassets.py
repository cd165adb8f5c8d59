"""The files that a mesh file refers to, materials, textures and buffers, and what its images are.

Trimesh reads them through `Assets`, which knows afterward what was read and what was wrong with it:
trimesh itself goes on without a file that is missing or cannot be decoded.
"""

from __future__ import annotations

import codecs
import hashlib
import io
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ffpose.errors import DataError, require
from ffpose.render.spacecraft.mtloptions import OPTIONS

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
    """The files beside a mesh file, by the names that it gives them: a resolver for trimesh.

    Attributes:
        source: The mesh file.
        problems: What was wrong with the files that were asked for.
        used: Names of the materials that an OBJ file uses, of its MTL files'.
        libraries: Lines that name an OBJ file's MTL files: trimesh asks for the first one alone.
        defined: Names of the materials of its MTL files.
    """

    def __init__(self, source: Path) -> None:
        self.problems: list[DataError] = []
        self.source = source
        self.used: set[bytes] = set()
        self.libraries: list[str] = []
        self.defined: set[bytes] = set()
        self._digests: dict[str, str] = {}
        self._folders = [source.parent.resolve()]

    def get(self, name: str) -> bytes:
        """Return the content of a file, and keep its digest; that of all MTL files for the first.

        A DataError if there is no such file, or it is outside of the mesh file's folder, or too
        large; it is also kept in `problems`, as trimesh goes on.
        """
        if name not in self.libraries:
            return self._kept(name)
        names = [each for line in self.libraries for each in self._names(line)]
        texts = [as_utf8(self._kept(each, NO_MATERIALS)) for each in dict.fromkeys(names)]
        self._folders += [path.parent for each in names if (path := self._find(each))]
        kept, keeps = list[bytes](), True
        for line in b"\n".join(texts).splitlines():
            if (begun := _material_name(line)) is not None:
                self.defined |= {begun} - {b""}
                keeps = begun in self.used  # textures of others may be missing
            if keeps:
                kept.append(_three_numbers(line))
        return b"\n".join(kept)

    def _names(self, line: str) -> list[str]:
        """Return the names on a line: several, or one that has spaces."""
        try:
            words = line.split()
            return words if all(self._find(word) for word in words) else [line]
        except DataError:  # one is outside of the folder, which its reading tells
            return [line]

    def _kept(self, name: str, missing: str = "") -> bytes:
        """Return the content of a file, and keep its digest, or what is wrong with it."""
        try:
            content = self._read(name, missing)
        except DataError as problem:
            self.problems.append(problem)
            raise
        self._digests[name] = hashlib.sha256(content).hexdigest()
        return content

    __getitem__ = get

    def digest(self, content: bytes) -> str:
        """Return the SHA-256 of a mesh file, or of it and of all files that were read for it."""
        own = hashlib.sha256(content).hexdigest()
        if not self._digests:
            return own
        listed = json.dumps([own, *sorted(self._digests.items())])
        return hashlib.sha256(listed.encode()).hexdigest()

    def _read(self, name: str, missing: str) -> bytes:
        path = self._find(name)
        if path is None:
            text = f"expected {name!r}, which it refers to, got no such file{missing}"
            raise DataError(text, self.source)
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DataError(f"expected at most {MAX_BYTES} bytes, got {size}", path)
        content = path.read_bytes()
        check_kind(content, path)
        if _is_image(path.name):
            open_image(content, self.source, repr(name))
        return content

    def _find(self, name: str) -> Path | None:
        """Return the file of a name: a URI, a path, or one of a computer where it was written."""
        plain = unquote(name).strip().replace("\\", "/")
        last = OPTIONS.sub("", plain)
        outside = False
        for folder in self._folders:
            for candidate in (name.strip(), plain, last, last.rsplit("/", 1)[-1]):
                path = folder / candidate
                if candidate and path.is_file():
                    if path.resolve().is_relative_to(self._folders[0]):
                        return path
                    outside = True
        if outside:
            text = f"expected files in its folder, got {name!r}, which is outside"
            raise DataError(text, self.source)
        return None


def check_kind(content: bytes, path: Path) -> None:
    """Raise a DataError if a file is one of `OTHERS`."""
    head = content[:64].removeprefix(codecs.BOM_UTF8).lstrip().lower()
    for beginning, text in OTHERS.items():
        if head.startswith(beginning):
            raise DataError(f"expected a file of its name's format, got {text}", path)


def _is_image(name: str) -> bool:
    """Return whether a file's name ends as that of an image, not of a buffer or materials."""
    known = require("PIL.Image", "render").registered_extensions()
    return Path(name.strip()).suffix.lower() in known


def open_image(content: bytes, path: Path, name: str) -> Any:
    """Open an image with Pillow; a DataError if the content is none."""
    pillow = require("PIL.Image", "render")
    try:
        return pillow.open(io.BytesIO(content))
    except Exception as error:  # Pillow's readers raise anything
        text = f"expected texture {name} that can be decoded, got {one_line(error)}"
        raise DataError(text, path) from error


def one_line(error: BaseException) -> str:
    """Return an error's kind and text on one line."""
    if isinstance(error, KeyError):
        return f"one without {error}"
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")


def _material_name(line: bytes) -> bytes | None:
    """Return the name of the material that begins on a line of an MTL file."""
    key, *name = line.split() or [b""]
    return b" ".join(name) if key.lower() == b"newmtl" else None


def _three_numbers(line: bytes) -> bytes:
    """Return an MTL file's color as trimesh reads it: one number stands for three (``Ks 0.5``)."""
    key, *words = line.partition(b"#")[0].split() or [b""]
    if key.lower() not in (b"ka", b"kd", b"ks", b"ke") or words[:1] in ([b"spectral"], [b"xyz"]):
        return line
    return b" ".join([key, *(3 * words if len(words) == 1 else words[:3])])


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
