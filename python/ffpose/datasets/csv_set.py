"""Reader of a user's own images: one CSV file for each split, and images beside it.

A set is a folder with ``train.csv``, ``val.csv``, ``test.csv`` or files of any other name, each a
split. Columns, in any order:

* ``image``: path of the image, relative to the folder, with slashes.
* ``tx, ty, tz, qw, qx, qy, qz``: the label in the conventions of `ffpose.geometry`, the object in
  the camera frame, meters, scalar first. A split without labels lacks all seven.
* ``camera``, optional: path of the camera file of the image, relative to the folder; without the
  column, ``camera.json`` for all. `ffpose.geometry.Camera.read` says what it holds; ``distortion``
  is optional.
* ``time``, optional: time of the middle of the exposure, seconds; `ffpose track` needs it.

``docs/datasets.md`` has an example.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ffpose._internal.urso import CONDITIONS
from ffpose.datasets.parsing import Entry, Names, expect_set, find_image, read_table
from ffpose.datasets.records import Record
from ffpose.datasets.targets import Target
from ffpose.errors import DataError
from ffpose.geometry import CAMERA_FILE, Camera

TARGET: Target = "object"

POSE = ("tx", "ty", "tz", "qw", "qx", "qy", "qz")
FIRST = ("train", "val", "test")
"""Splits that stand before others."""


def splits(root: Path) -> list[str]:
    """Return the splits of the set: train, val, test, then others by name.

    Raises:
        FileNotFoundError: The folder does not exist, or contains no CSV file.
        NotADirectoryError: ``root`` is a file.
    """
    expect_set(root, "CSV")
    tables = (path for path in root.glob("*.csv") if path.is_file() and path.name != CONDITIONS)
    found = sorted(path.stem for path in tables if not path.name.startswith("."))
    if not found:
        raise FileNotFoundError(f"CSV set: expected a file such as train.csv in {root}, got none")
    return sorted(found, key=lambda split: FIRST.index(split) if split in FIRST else len(FIRST))


def read(root: Path, split: str) -> list[Record]:
    """Read the images of a split, with labels where it has them.

    Raises:
        ValueError: ``split`` is not in the set.
        FileNotFoundError: The folder does not exist, or contains no CSV file.
        NotADirectoryError: ``root`` is a file.
        DataError: A column is unknown or missing, a name, label or camera is invalid, or an image
            is missing or listed twice; the error names file and line.
    """
    known = splits(root)
    if split not in known:
        raise ValueError(f"split: expected one of {(*known, 'all')}, got {split!r}")
    path = root / f"{split}.csv"
    header, entries = read_table(path)
    labeled = _has_labels(header, path)
    names, camera = Names(), cache(Camera.read)
    records = []
    for entry in entries:
        name = names.add(entry, entry.text("image"))
        image = find_image(root, name, entry)
        seen_by = camera(_camera_file(root, entry))
        time = entry.parsed(("time",))[0] if "time" in header else None
        if not labeled:
            records.append(Record(image, name, seen_by, None, path, entry.line, time=time))
            continue
        tx, ty, tz, w, x, y, z = entry.parsed(POSE)
        pose = entry.pose((tx, ty, tz), (w, x, y, z))
        raw = (w, x, y, z)
        records.append(Record(image, name, seen_by, pose, path, entry.line, raw, time=time))
    return records


def _has_labels(header: list[str], path: Path) -> bool:
    """Return whether a split has labels; check its columns."""
    expected = f"expected the columns image, {', '.join(POSE)} and, optional, camera and time"
    labeled = any(name in header for name in POSE)
    required = {"image", *POSE} if labeled else {"image"}
    if set(header) - {"camera", "time"} != required:
        raise DataError(f"{expected}, got {', '.join(header)}", path, 1)
    return labeled


def _camera_file(root: Path, entry: Entry) -> Path:
    named = "camera" in entry.values
    path = root / (entry.text("camera") if named else CAMERA_FILE)
    if not path.is_file():
        hint = "" if named else ", the camera of all images where there is no column camera"
        raise entry.error(f"expected {path}{hint}, got no such file")
    return path
