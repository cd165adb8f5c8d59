"""Reader of keypoints: named points of an object, for dense supervision without labels per image.

Projected through an image's pose they are labels of it, so any set with poses has them once the
points are known: SPEED+ as it is published has neither keypoints nor masks, but Tango's points can
be reconstructed from its images (Park et al., "Towards Robust Learning-Based Pose Estimation of
Noncooperative Spacecraft", 2019).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffpose.datasets.parsing import read_table
from ffpose.errors import DataError

COLUMNS = ("name", "x", "y", "z")


def read_keypoints(path: Path) -> NDArray[np.float64]:
    """Read points ``(K, 3)`` of the object's frame, meters, from a CSV file.

    Its columns, in any order, are ``name``, ``x``, ``y`` and ``z``; each row is a point.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The columns are others, a number is not finite, or a name is there twice; the
            error names file and line.
    """
    header, entries = read_table(path)
    if set(header) != set(COLUMNS):
        raise DataError(
            f"expected the columns {', '.join(COLUMNS)}, got {', '.join(header)}", path, 1
        )
    first_line: dict[str, int] = {}
    for entry in entries:
        name = entry.text("name")
        if name in first_line:
            raise entry.error(f"{name} is on line {first_line[name]} already")
        first_line[name] = entry.line
    return np.array([entry.parsed(COLUMNS[1:]) for entry in entries])
