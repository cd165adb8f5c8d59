"""``conditions.csv``: lighting, background and visibility of each image of a rendered set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.urso import CONDITIONS
from ffpose.datasets.parsing import Names, read_table
from ffpose.errors import DataError

LIMITS = {
    "eclipsed": 1.0,
    "sun_angle_deg": 180.0,
    "earth_behind": 1.0,
    "visible_share": 1.0,
}
"""Largest valid value of each column that is read; the smallest is zero."""

FLAGS = ("eclipsed", "earth_behind")
"""Columns that hold 0 or 1."""


class Conditions(NamedTuple):
    """Conditions of N images, ``(N,)`` each.

    Attributes:
        eclipsed: Whether the Earth hides the sun; a lamp at the camera then gives light.
        sun_angle_deg: Angle between the viewing ray and the direction to the sun; below 90 degrees
            a sunlit object is back-lit.
        earth_behind: Whether the ray to the object's origin goes on to the Earth.
        visible_share: Share of the object's extent that lies in the frame.
    """

    eclipsed: NDArray[np.bool_]
    sun_angle_deg: NDArray[np.float64]
    earth_behind: NDArray[np.bool_]
    visible_share: NDArray[np.float64]


def read_conditions(root: str | Path, names: Sequence[str]) -> Conditions | None:
    """Read the conditions of images; None where the set has no ``conditions.csv``.

    Args:
        root: The dataset's folder; its ``conditions.csv`` has one row for each image, by name.
        names: File names of the images.

    Raises:
        DataError: A column, or the row of an image, is missing or duplicated, or a value is out of
            range; the error names file and line.
    """
    path = Path(root) / CONDITIONS
    if not path.exists():
        return None
    known, rows = Names(), dict[str, tuple[float, ...]]()
    for entry in read_table(path, ("image", *LIMITS), others=True):
        name = known.once(entry, entry.text("image"))
        rows[name] = entry.parsed(tuple(LIMITS))
        for (column, most), value in zip(LIMITS.items(), rows[name], strict=True):
            flag = column in FLAGS
            if not (value in (0, 1) if flag else 0 <= value <= most):
                expected = "0 or 1" if flag else f"0…{most:g}"
                raise entry.error(f"{column}: expected {expected}, got {entry.values[column]!r}")
    if missing := [name for name in names if name not in rows]:
        raise DataError(f"expected a row for {missing[0]}, got none", path)
    columns = np.array([rows[name] for name in names]).reshape(-1, len(LIMITS)).T
    values = zip(LIMITS, columns, strict=True)
    return Conditions(**{k: v.astype(bool) if k in FLAGS else v for k, v in values})
