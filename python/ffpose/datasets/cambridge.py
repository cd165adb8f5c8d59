"""Reader of Cambridge Landmarks: photographs of buildings (Kendall et al., PoseNet, ICCV 2015).

A set is the folder of a scene with ``dataset_train.txt`` and ``dataset_test.txt``: three lines of
header, then for each image ``seq1/frame00001.png X Y Z W P Q R``. Or it is a folder with CSV files
of the columns ``scene, split, seq, img_path, t1, t2, t3, q1, q2, q3, q4`` in any order, whose paths
are relative to it; then the column ``split`` names the splits, and several scenes may be joined.

Either way a label is the camera's center in the world, meters, and the quaternion from the world to
the camera frame, scalar first. Some have norms up to 1.043 and are normalized.

The camera is that of ``camera.json`` (`ffpose.geometry.Camera.read`) if there is one, else
`CAMERA`, at the size of the first image.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from ffpose._internal.entries import Entry
from ffpose.datasets.parsing import (
    Names,
    expect_set,
    expect_split,
    find_image,
    find_tables,
    read_lines,
    read_table,
)
from ffpose.datasets.records import Record, with_camera
from ffpose.errors import DataError
from ffpose.geometry import Camera, camera_pose

CAMERA = Camera(width=1920, height=1080, fx=1674.0, fy=1674.0, cx=960.0, cy=540.0)
"""Camera of the photographs: the focal length that Brachmann and Rother (CVPR 2018) use, 744 pixels
at a height of 480. The images' own differ by some percent; only drawings depend on it."""

NORM_TOLERANCE = 0.05
"""Deviation of a quaternion's norm from one that is normalized; published ones reach 0.043."""

POSE = ("X", "Y", "Z", "W", "P", "Q", "R")
CSV_POSE = ("t1", "t2", "t3", "q1", "q2", "q3", "q4")
COLUMNS = ("scene", "split", "seq", "img_path", *CSV_POSE)
TEXT_FILES = {split: f"dataset_{split}.txt" for split in ("train", "test")}
_HEADER = "ImageFile, Camera Position [X Y Z W P Q R]"


def splits(root: Path) -> list[str]:
    """Return the splits of the set, train first."""
    expect_set(root, "Cambridge Landmarks")
    found = [split for split, file in TEXT_FILES.items() if (root / file).is_file()]
    if found:
        return found
    named = dict.fromkeys(entry.text("split") for entry in _csv_entries(root))
    return sorted(named, key=lambda split: split != "train")


def read(root: Path, split: str) -> list[Record]:
    """Read the labeled images of a split."""
    expect_split(split, splits(root))
    path = root / TEXT_FILES.get(split, "")
    if path.is_file():
        rows = [(e, e.text("image"), e.parsed(POSE)) for e in _text_entries(path)]
    else:
        chosen = (entry for entry in _csv_entries(root) if entry.text("split") == split)
        rows = [(e, e.text("img_path"), e.parsed(CSV_POSE)) for e in chosen]
    names = Names()
    records = [_record(root, names, *row) for row in rows]
    return with_camera(records, root, CAMERA)


def _text_entries(path: Path) -> Iterator[Entry]:
    lines = read_lines(path)
    if [line.strip() for line in lines[1:3]] not in ([_HEADER, ""], [_HEADER]):
        raise DataError(f"expected {_HEADER!r} on line 2 and line 3 empty", path, 2)
    columns = ("image", *POSE)
    for line, text in enumerate(lines[3:], start=4):
        fields = text.split()
        if len(fields) != len(columns):
            raise DataError(f"expected {' '.join(columns)}, got {text!r}", path, line)
        yield Entry(dict(zip(columns, fields, strict=True)), path, line)
    if len(lines) <= 3:
        raise DataError("expected at least one image, got none", path)


def _csv_entries(root: Path) -> Iterator[Entry]:
    paths = find_tables(root)
    if not paths:
        names = ", ".join(TEXT_FILES.values())
        raise FileNotFoundError(
            f"Cambridge Landmarks set: expected one of {names}, or a CSV file, in {root}, got none"
        )
    for path in paths:
        yield from read_table(path, COLUMNS)


def _record(root: Path, names: Names, entry: Entry, name: str, values: tuple[float, ...]) -> Record:
    name, (w, x, y, z) = names.add(entry, name), values[3:]
    norm = math.hypot(w, x, y, z)
    if abs(norm - 1) > NORM_TOLERANCE:
        raise entry.error(f"quaternion: expected norm 1 within {NORM_TOLERANCE}, got {norm:.6g}")
    pose = camera_pose(values[:3], [value / norm for value in values[3:]])
    image = find_image(root, name, entry)
    raw = (w, x, y, z)
    return Record(image, name, CAMERA, pose, entry.file, entry.line, raw, target="camera")
