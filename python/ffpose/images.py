"""Reading image files as RGB."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image

from ffpose.errors import DataError

Item = TypeVar("Item")
Decoded = TypeVar("Decoded")

MODES = ("L", "LA", "P", "RGB", "RGBA")
"""Pillow's modes with 8 bits per channel, which convert to RGB without loss of range."""


DEEP_MODES = ("I;16", "I;16B", "I;16L", "I")
"""Pillow's modes of monochrome images with more than 8 bits, whose white level a user states."""


WAITING = 256
"""Most decoded images that `decode_all` holds at a time."""


def decode_all(decode: Callable[[Item], Decoded], items: Sequence[Item]) -> Iterator[Decoded]:
    """Decode images on all cores and yield them in order; Pillow works without the GIL."""
    with ThreadPoolExecutor() as pool:
        for start in range(0, len(items), WAITING):
            yield from pool.map(decode, items[start : start + WAITING])


WHITE = "a positive level, or a percentile such as 'p99.5'"
"""What can be stated as white (`to_rgb`)."""


def check_white(name: str, white: float | str) -> None:
    """Check a white level or percentile.

    Raises:
        ValueError: It is not `WHITE`; the message begins with ``name``.
    """
    if isinstance(white, str):
        usable = bool(re.fullmatch(r"p\d+(\.\d+)?", white)) and 0 < float(white[1:]) <= 100
    else:
        usable = 0 < white < math.inf
    if not usable:
        raise ValueError(f"{name}: expected {WHITE}, got {white!r}")


def read_rgb(path: Path, white: float | str | None = None) -> Image.Image:
    """Read an image file as RGB; transparency is dropped.

    Args:
        path: The file.
        white: Level of a monochrome image of more than 8 bits that becomes 255, as for `to_rgb`;
            images of 8 bits stay as they are.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The file is not an intact image, or its mode is not in `MODES`.
    """
    with open_image(path) as image:
        return to_rgb(image, path, white if image.mode in DEEP_MODES else None)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file; the header is read now, the pixels on access.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The file is not an image, or is damaged; also if this shows within the block.
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


def to_rgb(image: Image.Image, path: Path, white: float | str | None = None) -> Image.Image:
    """Decode an open image as RGB; transparency is dropped.

    Args:
        image: Image from `open_image`.
        path: Path of the image file, for the error message.
        white: Level of a monochrome image of more than 8 bits that becomes 255, as do all above it;
            4095 for 12 bits; or the percentile of the image's own levels that does, such as
            ``"p99.5"``. None for images of 8 bits.

    Raises:
        DataError: The image's mode is not in `MODES`, or with ``white`` not in `DEEP_MODES`, or the
            percentile of its levels is not above zero.
    """
    if white is not None:
        return _scaled(image, path, white)
    if image.mode not in MODES:
        raise DataError(f"expected pixels of mode {', '.join(MODES)}, got {image.mode}", path)
    # A palette may hold transparency, which Pillow only drops by way of RGBA.
    return (image.convert("RGBA") if image.mode == "P" else image).convert("RGB")


def _scaled(image: Image.Image, path: Path, white: float | str) -> Image.Image:
    """Scale a monochrome image of more than 8 bits so that ``white`` becomes 255."""
    if image.mode not in DEEP_MODES:
        expected = f"pixels of mode {', '.join(DEEP_MODES)}, for which a white level is stated"
        raise DataError(f"expected {expected}, got {image.mode}", path)
    levels = np.asarray(image).astype(np.float64)
    level = float(np.percentile(levels, float(white[1:]))) if isinstance(white, str) else white
    if not level > 0:
        raise DataError(f"expected a level above 0 at percentile {white}, got {level:g}", path)
    gray = np.rint(np.clip(levels / level, 0, 1) * 255).astype(np.uint8)
    return Image.fromarray(gray).convert("RGB")
