"""Colors of binary STL files: the two bytes after a triangle, of which there are two conventions.

That of VisCAM and SolidView has blue in the lowest five bits, then green and red, where bit 15 is
set. Magics has red in the lowest, where bit 15 is clear, and a color of the whole part in the head,
for the other triangles. MeshLab writes Magics' head and sets bit 15 of all triangles with colors;
others write the head alone, and zeros.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

GIVEN = 0x8000
"""Bit 15."""

PART_COLOR = b"COLOR="
"""What precedes the color of the whole part, of a byte for each of red, green, blue and alpha."""


def stl_colors(
    head: bytes, codes: NDArray[np.uint16], missing: NDArray[Any]
) -> NDArray[np.uint8] | None:
    """Return the sRGB colors (F, 3) of a binary STL file's triangles, None where it has none.

    Args:
        head: The file's 80 bytes before the number of its triangles.
        codes: (F,) the two bytes after each triangle.
        missing: (3,) sRGB color of triangles without one.
    """
    _, found, part = head.partition(PART_COLOR)
    levels = np.stack([codes >> shift & 31 for shift in (10, 5, 0)], axis=1)
    own = codes >= GIVEN
    if found and len(part) >= 3:
        levels, missing = levels[:, ::-1], np.frombuffer(part, np.uint8, 3)
        colored = np.ptp(codes) > 0 or codes[0] & 0x7FFF not in (0, 0x7FFF)
        if codes.any() and not (own.all() and colored):
            own = ~own
    elif not own.any():
        return None
    colors = np.where(own[:, None], np.round(levels * (255 / 31)), missing[:3])
    return colors.astype(np.uint8)
