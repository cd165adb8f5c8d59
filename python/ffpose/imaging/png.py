"""PNG files whose pixels end before the image does.

Where the compressed data end properly but hold too few rows, Pillow leaves the others as they were
and tells no error; libpng and other decoders refuse such a file.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile

from ffpose.errors import DataError

HEAD = 33
"""Bytes of the signature and of IHDR, the first chunk."""

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples of a pixel, by the color type of IHDR."""

PASSES = (
    *((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8)),
    *((2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)),
)
"""First column and row of each pass of an interlaced image, and the steps from there."""

AT_A_TIME = 1 << 20


def load_all_rows(image: Image.Image, path: Path) -> None:
    """Decode a PNG file whole.

    The pixels are white before, so that a last row that is not was in the file. Where it is white,
    or the image is interlaced, the data are counted, which takes as long as to decompress them.

    Args:
        image: Image that Pillow opened from the file; nothing is done if it is decoded.
        path: The file.

    Raises:
        DataError: The file holds fewer bytes of pixels than its header says.
    """
    if not isinstance(image, ImageFile.ImageFile) or not image.tile:
        return
    white = (1 if image.mode == "1" else 255,) * len(image.getbands())
    image.im = Image.new(image.mode, image.size, white if len(white) > 1 else white[0]).im
    last = np.asarray(image.crop((0, image.height - 1, image.width, image.height)))
    if (last != white[0]).any() and not image.info.get("interlace"):
        return
    data = path.read_bytes()
    expected = bytes_of_rows(data)
    got = 0
    for part in decompressed(data):
        got += len(part)
    if got < expected:
        raise DataError(f"expected {expected} bytes of pixels and filters, got {got}", path)


def bytes_of_rows(data: bytes) -> int:
    """Return how many bytes the rows of a PNG file have, each with that of its filter."""
    width, height = int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    bits = data[24] * CHANNELS[data[25]]
    passes = PASSES if data[28] else ((0, 0, 1, 1),)
    total = 0
    for left, top, across, down in passes:
        columns, rows = -(-(width - left) // across), -(-(height - top) // down)
        if columns > 0:  # a pass without columns has no filters either
            total += max(rows, 0) * (1 + -(-columns * bits // 8))
    return total


def decompressed(data: bytes) -> Iterator[bytes]:
    """Yield the bytes that the IDAT chunks of an intact PNG file hold, a part at a time."""
    start, stream = HEAD, zlib.decompressobj()
    while start + 8 <= len(data) and not stream.eof:
        length, name = int.from_bytes(data[start : start + 4]), data[start + 4 : start + 8]
        start += 8
        content = data[start : start + length] if name == b"IDAT" else b""
        start += length + 4
        while content:
            yield stream.decompress(content, AT_A_TIME)
            content = stream.unconsumed_tail
