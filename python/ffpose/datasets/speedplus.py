"""Reader of SPEED+: synthetic images of Tango, and two laboratories (Park et al., 2022).

A set is a folder with ``camera.json`` and, for each split, a list and the images in ``images``
beside it: ``train`` and ``val`` are ``synthetic/train.json`` and ``synthetic/validation.json``,
``lightbox`` and ``sunlamp`` are ``lightbox/test.json`` and ``sunlamp/test.json``. File names repeat
across domains, so an image is named by its domain too: ``lightbox/images/img000001.jpg``. Labels
are those of SPEED (`ffpose.datasets.speed`) with the key ``q_vbs2tango_true``, or the older
``q_vbs2tango``.

The camera has distortion, which all images have; `ffpose.datasets.Decoding` can take it out.
"""

from __future__ import annotations

import math
from pathlib import Path

from ffpose._internal.entries import Entry, read_object
from ffpose._internal.files import shortened
from ffpose.datasets.parsing import existing_splits, split_file
from ffpose.datasets.records import Record
from ffpose.datasets.speed import read_images
from ffpose.geometry import DistortedCamera

FILES = {
    "train": "synthetic/train.json",
    "val": "synthetic/validation.json",
    "lightbox": "lightbox/test.json",
    "sunlamp": "sunlamp/test.json",
}
_AGREEMENT = 1e-3
"""Relative tolerance between ``cameraMatrix`` and the other intrinsics of ``camera.json``."""


def splits(root: Path) -> list[str]:
    """Return the splits of the set, in the order of `FILES`."""
    return existing_splits(root, "SPEED+", FILES)


def read(root: Path, split: str) -> list[Record]:
    """Read the images of a split, with labels where it has them."""
    path = split_file(root, "SPEED+", FILES, split)
    return read_images(path, root, f"{path.parent.name}/images", read_camera(root / "camera.json"))


def read_camera(path: Path) -> DistortedCamera:
    """Read SPEED+'s ``camera.json``.

    It has ``Nu`` and ``Nv`` (pixels), ``ppx`` and ``ppy`` (pitch, meters), ``fx`` and ``fy``
    (meters), ``ccx`` and ``ccy`` (pixels), ``cameraMatrix`` and ``distCoeffs`` (OpenCV's order).

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: A key is missing or invalid, or the matrix contradicts the other keys.
    """
    entry = read_object(path)
    fx, fy, cx, cy = _matrix(entry)
    others = {
        "fx / ppx": (entry.number("fx") / _positive(entry, "ppx"), fx),
        "fy / ppy": (entry.number("fy") / _positive(entry, "ppy"), fy),
        "ccx": (entry.number("ccx"), cx),
        "ccy": (entry.number("ccy"), cy),
    }
    for name, (value, expected) in others.items():
        if not math.isclose(value, expected, rel_tol=_AGREEMENT):
            raise entry.error(f"{name}: expected {expected} as in cameraMatrix, got {value}")
    size, lens = (entry.whole("Nu"), entry.whole("Nv")), entry.numbers("distCoeffs", 5)
    return entry.made(DistortedCamera, *size, fx, fy, cx, cy, lens)


def _matrix(entry: Entry) -> tuple[float, float, float, float]:
    """Return ``fx, fy, cx, cy`` of ``cameraMatrix``, three rows without skew."""
    rows = entry.values.get("cameraMatrix")
    if not isinstance(rows, list) or len(rows) != 3:
        raise entry.error(f"cameraMatrix: expected three rows, got {shortened(rows)}")
    named = Entry({f"cameraMatrix row {i}": row for i, row in enumerate(rows)}, *entry[1:])
    first, second, third = (named.numbers(f"cameraMatrix row {i}", 3) for i in range(3))
    if (first[1], second[0], *third) != (0, 0, 0, 0, 1):
        raise entry.error(
            f"cameraMatrix: expected [fx 0 cx], [0 fy cy], [0 0 1], got {shortened(rows)}"
        )
    return first[0], second[1], first[2], second[2]


def _positive(entry: Entry, key: str) -> float:
    value = entry.number(key)
    if value <= 0:
        raise entry.error(f"{key}: expected a positive number, got {value}")
    return value
