"""Image files as RGB pixels: the one rule by which they are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from ffpose.errors import DataError

MODES = ("L", "LA", "P", "RGB", "RGBA")
"""Pillow's modes of eight bits a channel: those that become RGB without loss of range."""


def read_rgb(path: Path) -> Image.Image:
    """Read an image file as RGB; transparency is dropped.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: As `open_image` and `to_rgb`.
    """
    with open_image(path) as image:
        return to_rgb(image, path)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file: its header is read, its pixels when they are asked for.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: The file is no image, or a broken one; also where the block finds that out.
    """
    try:
        with Image.open(path) as image:
            yield image
    except (FileNotFoundError, DataError):
        raise
    except (
        OSError,
        SyntaxError,  # how Pillow reports a broken PNG chunk
        ValueError,
        Image.DecompressionBombError,
        Image.DecompressionBombWarning,
    ) as error:
        raise DataError(f"cannot be read as an image: {error}", path) from error


def to_rgb(image: Image.Image, path: Path) -> Image.Image:
    """Decode an open image as RGB; transparency is dropped.

    Args:
        image: As `open_image` gives it.
        path: Its file, which an error names.

    Raises:
        DataError: The pixels do not become RGB without loss.
    """
    if image.mode not in MODES:
        raise DataError(f"expected pixels of mode {', '.join(MODES)}, got {image.mode}", path)
    # A palette may hold transparency, which Pillow only drops by way of RGBA.
    return (image.convert("RGBA") if image.mode == "P" else image).convert("RGB")
