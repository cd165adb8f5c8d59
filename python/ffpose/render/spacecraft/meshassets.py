"""The files that a mesh file refers to, materials, textures and buffers, and what its images are.

Trimesh reads them through `Assets`, which knows afterward what was read and what was wrong with it:
trimesh itself goes on without a file that is missing or cannot be decoded.
"""

from __future__ import annotations

import base64
import codecs
import hashlib
import io
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ffpose.errors import DataError, require

MAX_BYTES = 1 << 30
"""Largest size of a mesh file, and of each file that it refers to."""

KNOWN_EXTENSIONS = ("KHR_materials_", "KHR_lights_punctual")
"""Beginnings of the names of glTF extensions without which shape and base color are right."""


class Assets:
    """The files beside a mesh file, by the names that it gives them: a resolver for trimesh.

    Attributes:
        problems: What was wrong with the files that were asked for.
    """

    def __init__(self, source: Path) -> None:
        self.problems: list[DataError] = []
        self._source = source
        self._digests: dict[str, str] = {}

    def get(self, name: str) -> bytes:
        """Return the content of a file, and keep its digest.

        Raises:
            DataError: There is no such file, it is too large, or it is a texture that cannot be
                decoded; this is also kept in `problems`, as trimesh goes on.
        """
        try:
            content = self._read(name)
        except DataError as problem:
            self.problems.append(problem)
            raise
        self._digests[name] = hashlib.sha256(content).hexdigest()
        materials = self._source.suffix.lower() == ".obj" and not _is_image(name)
        return as_utf8(content) if materials else content

    __getitem__ = get

    def digest(self, content: bytes) -> str:
        """Return the SHA-256 of a mesh file, or of it and of all files that were read for it."""
        own = hashlib.sha256(content).hexdigest()
        if not self._digests:
            return own
        listed = json.dumps([own, *sorted(self._digests.items())])
        return hashlib.sha256(listed.encode()).hexdigest()

    def _read(self, name: str) -> bytes:
        path = self._find(name)
        if path is None:
            raise DataError(
                f"expected {name!r}, which it refers to, got no such file", self._source
            )
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DataError(f"expected at most {MAX_BYTES} bytes, got {size}", path)
        content = path.read_bytes()
        if _is_image(path.name):
            check_image(content, path)
        return content

    def _find(self, name: str) -> Path | None:
        """Return the file of a name: a URI, a path, or one of a computer where it was written."""
        plain = unquote(name).strip().replace("\\", "/")
        # Options stand before the file's name in an MTL file: ``map_Kd -s 2 2 1 panel.png``.
        last = plain.split()[-1] if plain.startswith("-") else plain
        for candidate in (name.strip(), plain, last, last.rsplit("/", 1)[-1]):
            path = self._source.parent / candidate
            if candidate and path.is_file():
                return path
        return None


def _is_image(name: str) -> bool:
    """Return whether a file's name ends as that of an image, not of a buffer or materials."""
    known = require("PIL.Image", "render").registered_extensions()
    return Path(name.strip()).suffix.lower() in known


def check_image(content: bytes, source: Path, name: str = "a texture") -> None:
    """Raise a DataError unless ``content`` is an image that Pillow can decode."""
    pillow = require("PIL.Image", "render")
    try:
        with pillow.open(io.BytesIO(content)) as image:
            image.load()
    except Exception as error:  # Pillow's readers raise anything
        raise DataError(
            f"expected {name} that can be decoded, got {one_line(error)}", source
        ) from (error)


def check_gltf(content: bytes, source: Path) -> None:
    """Check what trimesh does not tell about a .gltf or .glb file: extensions, textures inside.

    Raises:
        DataError: The file is no glTF, needs an extension that is not known, or holds a texture
            that cannot be decoded.
    """
    try:
        header, chunk = _glb(content) if content[:4] == b"glTF" else (json.loads(content), b"")
        needed = [str(name) for name in header.get("extensionsRequired", [])]
        inside = [_embedded(image, header, chunk) for image in header.get("images", [])]
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, struct.error) as error:
        raise DataError(f"expected a glTF document, got {one_line(error)}", source) from error
    unknown = [name for name in needed if not name.startswith(KNOWN_EXTENSIONS)]
    if unknown:
        raise DataError(
            f"expected glTF without extensions, got one that needs {unknown[0]}", source
        )
    for number, image in enumerate(inside):
        if image is not None:
            check_image(image, source, f"texture {number}")


def one_line(error: BaseException) -> str:
    """Return an error's kind and text on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")


def as_utf8(content: bytes) -> bytes:
    """Return a text file in UTF-8, as .obj and .mtl files of old programs are not.

    UTF-16 has a byte order mark; what is neither that nor UTF-8 is taken for Latin-1.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace").encode()
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1").encode()
    return content


def _glb(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header of a .glb file and its binary chunk, empty where there is none."""
    (length,) = struct.unpack_from("<I", content, 12)
    header = json.loads(content[20 : 20 + length])
    return header, content[20 + length + 8 :]


def _embedded(image: dict[str, Any], header: dict[str, Any], chunk: bytes) -> bytes | None:
    """Return an image that a glTF file holds itself; None of one in a file of its own.

    Compressed textures (KTX 2) are left out: a file that does not need them has others.
    """
    if image.get("mimeType") == "image/ktx2":
        return None
    if "uri" in image:
        _, found, text = image["uri"].partition("base64,")
        return base64.b64decode(text) if found else None
    view = header["bufferViews"][image["bufferView"]]
    if view["buffer"] != 0 or "uri" in header["buffers"][0]:
        return None
    start = view.get("byteOffset", 0)
    return chunk[start : start + view["byteLength"]]
