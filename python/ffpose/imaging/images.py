"""Reading image files as RGB: the pixels as they are stored, which a camera's calibration is of.

An EXIF orientation, by which viewers turn a picture, is not applied.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image, ImageFile

from ffpose.errors import DataError, expect

Item = TypeVar("Item")
Decoded = TypeVar("Decoded")

MODES = ("L", "LA", "P", "RGB", "RGBA", "1")
"""Pillow's modes with 8 bits per channel, or of black and white, which convert to RGB without loss
of range."""

DEEP_MODES = ("I;16", "I;16B", "I;16L", "I")
"""Pillow's modes of monochrome images with more than 8 bits, whose white level a user states."""

SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm")
"""Suffixes of the image files of a folder."""

PATTERN = re.compile(r"[*?[]")
"""What makes a path a pattern of paths."""

ORIENTATION = 0x0112
"""Tag of a TIFF by which viewers, and Pillow as it decodes one, turn the pixels."""

PHOTOMETRIC, SAMPLE_FORMAT = 0x0106, 0x0153
"""Tags of a TIFF: 0 of the one, white is 0; 2 of the other, levels have a sign."""

MAX_PIXELS = 2**28 // 3
"""Most pixels of an image file: 256 MiB as RGB, where Pillow begins to warn of hostile files."""

WAITING = 256
"""Most decoded images that `decode_all` holds at a time."""


def decode_all(decode: Callable[[Item], Decoded], items: Sequence[Item]) -> Iterator[Decoded]:
    """Decode images on all cores and yield them in order; Pillow works without the GIL.

    The first is decoded alone: what all of them need, as a table to undistort by, is made once.
    """
    yield from map(decode, items[:1])
    with ThreadPoolExecutor() as pool:
        for start in range(1, len(items), WAITING):
            yield from pool.map(decode, items[start : start + WAITING])


WHITE = "a positive level, or a percentile such as 'p99.5'"
"""What can be stated as white (`to_rgb`)."""


def check_white(name: str, white: float | str) -> None:
    """Check a white level or percentile; a ValueError begins with ``name``."""
    if isinstance(white, str):
        usable = bool(re.fullmatch(r"p\d+(\.\d+)?", white)) and 0 < float(white[1:]) <= 100
    else:
        usable = 0 < white < math.inf
    expect(usable, name, WHITE, white)


def image_files(folder: Path, name: str) -> list[Path]:
    """Return the PNG, JPEG and PGM files of a folder, at least one, sorted by name.

    Hidden ones, as macOS leaves beside each file, are left out.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{name}: expected a folder of images, got {folder}")
    images = sorted(path for path in folder.iterdir() if is_image(path))
    if not images:
        raise FileNotFoundError(f"{name}: expected PNG, JPEG or PGM files in {folder}, got none")
    return images


def is_image(path: Path) -> bool:
    """Return whether a path is a file with the suffix of an image, and not hidden."""
    shown = path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    return shown and not path.is_dir()


def find_images(names: Iterable[str | Path]) -> list[Path]:
    """Return the files that a user names, in order.

    Args:
        names: Files, which need not exist; folders, whose PNG, JPEG and PGM files are taken; and
            patterns, whose files are taken, such as ``"runs/*/images/**/*.png"`` (``**`` for
            folders of any depth). Files of folders and patterns are sorted by name.

    Raises:
        FileNotFoundError: A folder has no such file, or no file matches a pattern.
    """
    found: list[Path] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            found += image_files(path, "images")
        elif path.exists() or not PATTERN.search(str(name)):
            found.append(path)
        else:
            found += _matches(path)
    return found


def _matches(pattern: Path) -> list[Path]:
    """Return the sorted files that match a pattern; hidden ones do not."""
    parts = pattern.parts
    first = next(place for place, part in enumerate(parts) if PATTERN.search(part))
    folder, rest = Path(*parts[:first]), Path(*parts[first:])
    there = folder.glob(str(rest))
    matches = sorted(path for path in there if path.is_file() and not path.name.startswith("."))
    if not matches:
        raise FileNotFoundError(f"images: expected files that match {pattern}, got none")
    return matches


def read_rgb(path: Path, white: float | str | None = None) -> Image.Image:
    """Read an image file as RGB; transparency is dropped, and an EXIF orientation not applied.

    Of monochrome images of more than 8 bits the level ``white`` becomes 255, as for `to_rgb`;
    images of 8 bits stay as they are.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: As `open_image` and `to_rgb`.
    """
    with open_image(path) as image:
        return to_rgb(image, path, white if image.mode in DEEP_MODES else None)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file; the header is read now, the pixels on access.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The file is not an image, or is damaged, or declares more than `MAX_PIXELS`; also
            if this shows within the block. Or it is a folder, or a pipe, which might never end, or
            a JPEG 2000 file of more than 8 bits, but for 16 of gray; or a TIFF to be turned, of
            more than 8 bits whose white is 0, or of 8 with a sign; or a FITS file.
    """
    if path.exists() and not path.is_file():
        got = "a folder" if path.is_dir() else "a pipe or a device"
        raise DataError(f"expected a regular file, got {got}", path)
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_PIXELS:
                raise _too_large(image.width * image.height, path)
            if image.format == "TIFF":
                _check_tiff(image, path)
            if image.format == "FITS":  # Pillow leaves out their sign, BZERO and BSCALE
                raise DataError("expected levels as they are, as in PNG or TIFF, got FITS", path)
            bits = _jpeg2000_bits(path) if image.format == "JPEG2000" else 8
            if bits > 8 and (bits, image.mode) != (16, "I;16"):  # Pillow moves levels, or cuts them
                expected = "a JPEG 2000 file of 8 bits per channel, or of one channel of 16"
                raise DataError(f"expected {expected}, got {bits} in mode {image.mode}", path)
            yield image
    except (FileNotFoundError, DataError):
        raise
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        found = re.search(r"\d+", str(error))
        raise _too_large(int(found[0]) if found else None, path) from error
    except (OSError, SyntaxError, ValueError) as error:  # SyntaxError: a broken PNG chunk
        raise DataError(f"cannot be read as an image: {error}", path) from error


def _check_tiff(image: Image.Image, path: Path) -> None:
    """Refuse a TIFF that Pillow would turn, or whose levels it would take for others."""
    tags = image.getexif()
    turned = tags.get(ORIENTATION, 1)
    if turned != 1:
        got = f"a TIFF to be turned, of orientation {turned} instead of 1"
        raise DataError(f"expected pixels as they are stored, got {got}", path)
    if image.mode in DEEP_MODES and tags.get(PHOTOMETRIC) == 0:  # Pillow inverts 8 bits alone
        got = "a TIFF of more than 8 bits where it is white"
        raise DataError(f"expected level 0 to be black, got {got}", path)
    if image.mode == "L" and tags.get(SAMPLE_FORMAT) == 2:
        raise DataError("expected levels from 0 to 255, got a TIFF of levels with a sign", path)


def _too_large(pixels: int | None, path: Path) -> DataError:
    got = "more" if pixels is None else f"{pixels:,}"
    return DataError(f"expected an image of at most {MAX_PIXELS:,} pixels, got {got}", path)


def to_rgb(image: Image.Image, path: Path, white: float | str | None = None) -> Image.Image:
    """Decode an open image as RGB; transparency is dropped.

    Args:
        image: Image from `open_image`, whose pixels have not been accessed.
        path: Path of the image file, for the error message.
        white: Level of a monochrome image of more than 8 bits that becomes 255, as do all above it;
            4095 for 12 bits; or the percentile of the image's own levels that does, such as
            ``"p99.5"``. None for images of 8 bits.

    Raises:
        DataError: The image's mode is not in `MODES`, or with ``white`` not in `DEEP_MODES`, or it
            has several channels of more than 8 bits, or the percentile of its levels is not above
            zero; or a PNG file lacks rows.
    """
    if image.mode not in DEEP_MODES and _is_deep(image):
        expected = "8 bits per channel, or one channel of 16 bits with a white level"
        raise DataError(f"expected {expected}, got more than 8 in mode {image.mode}", path)
    if white is not None:
        return _scaled(image, path, white)
    if image.mode not in MODES:
        level = ", and no white level (white)" if image.mode in DEEP_MODES else ""
        got = image.mode + level
        raise DataError(f"expected pixels of mode {', '.join(MODES)}, got {got}", path)
    if image.format == "PNG":
        _load_all_rows(image, path)
    # A palette may hold transparency, which Pillow only drops by way of RGBA.
    return (image.convert("RGBA") if image.mode == "P" else image).convert("RGB")


def _scaled(image: Image.Image, path: Path, white: float | str) -> Image.Image:
    """Scale a monochrome image of more than 8 bits so that ``white`` becomes 255."""
    if image.mode not in DEEP_MODES:
        expected = f"pixels of mode {', '.join(DEEP_MODES)}, for which a white level is stated"
        raise DataError(f"expected {expected}, got {image.mode}", path)
    if image.format == "PNG":
        _load_all_rows(image, path)
    stretched = _maxval(image)  # is forgotten once the pixels are decoded
    levels = np.asarray(image).astype(np.float64)
    if stretched is not None:
        levels = np.rint(levels * stretched / 65535)
    level = float(np.percentile(levels, float(white[1:]))) if isinstance(white, str) else white
    if not level > 0:
        raise DataError(f"expected a level above 0 at percentile {white}, got {level:g}", path)
    gray = np.rint(np.clip(levels / level, 0, 1) * 255).astype(np.uint8)
    return Image.fromarray(gray).convert("RGB")


def _load_all_rows(image: Image.Image, path: Path) -> None:
    """Decode a PNG file whole, or raise a DataError where it holds fewer rows than its header says.

    Pillow leaves the others as they were and tells no error; libpng and other decoders refuse such
    a file. So the pixels are white before, and where the last row is white then, or the image
    interlaced, whose last pass ends in one of the last two rows, it is decoded on black too.
    """

    def last_rows(picture: Image.Image, level: int) -> bytes:
        picture.im = Image.new(picture.mode, picture.size, (level,) * len(picture.getbands())).im
        return picture.crop((0, max(0, picture.height - 2), *picture.size)).tobytes()

    seen, interlaced = last_rows(image, 255), image.info.get("interlace")
    white = Image.new(image.mode, (image.width, 1), (255,) * len(image.getbands())).tobytes()
    if interlaced or seen.endswith(white):
        with Image.open(path) as again:
            if last_rows(again, 0) != seen:
                raise DataError(f"expected pixels of {image.height} rows, got fewer", path)


def _is_deep(image: Image.Image) -> bool:
    """Return whether a file's channels have more than 8 bits, of which Pillow may keep only 8."""
    return (_maxval(image) or 0) > 255 or any(
        isinstance(part, str) and ";16" in part for part in _decoder_arguments(image)
    )


def _jpeg2000_bits(path: Path) -> int:
    """Return the most bits of a JPEG 2000 file's channels (ISO/IEC 15444-1, A.5.1: SOC and SIZ)."""
    data = path.read_bytes()
    stream = max(data.find(b"jp2c"), 0)  # behind boxes that may hold anything
    size = data[data.find(b"\xff\x4f\xff\x51", stream) + 4 :]
    channels = int.from_bytes(size[36:38], "big")
    return 1 + max(depth & 0x7F for depth in size[38 : 38 + 3 * channels : 3])


def _maxval(image: Image.Image) -> int | None:
    """Return the level of a PGM or PPM file that Pillow stretches to its own white; None for none.

    Pillow stretches more than 8 bits to 65535, and rounds: rounding back is exact.
    """
    if image.format != "PPM":
        return None
    return next((part for part in _decoder_arguments(image) if isinstance(part, int)), None)


def _decoder_arguments(image: Image.Image) -> tuple[object, ...]:
    """Return what Pillow's decoder is told: the layout in the file, for PGM and PPM its maxval."""
    if not isinstance(image, ImageFile.ImageFile) or not image.tile:
        return ()
    arguments = image.tile[0].args
    return arguments if isinstance(arguments, tuple) else (arguments,)
