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

``docs/datasets.md`` has an example. Motions and keypoints of an object are CSV files too.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ffpose._internal.entries import Entry
from ffpose._internal.urso import CONDITIONS
from ffpose.datasets.parsing import (
    Names,
    expect_set,
    expect_split,
    find_image,
    find_tables,
    read_table,
)
from ffpose.datasets.records import Record
from ffpose.errors import DataError
from ffpose.geometry import CAMERA_FILE, POSE_COLUMNS, Camera, FloatArray, Pose
from ffpose.geometry.trajectory import Trajectory

KEYPOINT = ("name", "x", "y", "z")
FIRST = ("train", "val", "test")
"""Splits that stand before others."""


def splits(root: Path) -> list[str]:
    """Return the splits of the set: train, val, test, then others by name."""
    expect_set(root, "CSV")
    tables = (path for path in find_tables(root) if path.name != CONDITIONS)
    found = sorted(path.stem for path in tables if not _has_keypoints(path))
    if not found:
        raise FileNotFoundError(f"CSV set: expected a file such as train.csv in {root}, got none")
    return sorted(found, key=lambda split: FIRST.index(split) if split in FIRST else len(FIRST))


def _has_keypoints(path: Path) -> bool:
    """Return whether a table's header is that of `read_keypoints`."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        names = next(csv.reader([file.readline()]), [])
        return {name.strip() for name in names} == set(KEYPOINT)


def read(root: Path, split: str) -> list[Record]:
    """Read the images of a split, with labels where it has them."""
    expect_split(split, splits(root))
    path = root / f"{split}.csv"
    names, camera = Names(), cache(Camera.read)
    records = []
    for entry in read_table(path, ("image",), POSE_COLUMNS, ("camera",), ("time",)):
        name = names.add(entry, entry.text("image"))
        image = find_image(root, name, entry)
        seen_by = camera(camera_file(root, entry))
        time = entry.parsed(("time",))[0] if "time" in entry.values else None
        record = Record(image, name, seen_by, None, path, entry.line, time=time)
        if POSE_COLUMNS[0] in entry.values:
            *t, w, x, y, z = entry.parsed(POSE_COLUMNS)
            raw = (w, x, y, z)
            record = replace(record, pose=entry.made(Pose, t, raw), raw_quaternion=raw)
        records.append(record)
    return records


def camera_file(root: Path, entry: Entry) -> Path:
    """Return the camera file of a row's image, or raise a DataError if there is no such file."""
    named = "camera" in entry.values
    path = root / (entry.text("camera") if named else CAMERA_FILE)
    if not path.is_file():
        hint = "" if named else ", the camera of all images where there is no column camera"
        raise entry.error(f"expected {path}{hint}, got no such file")
    return path


def has_pose(entry: Entry) -> bool:
    """Return whether a row has a pose: any of its seven columns is there and filled."""
    return any(entry.values.get(name, "").strip() for name in POSE_COLUMNS)


def read_trajectory(path: Path) -> Trajectory:
    """Read poses over time from a CSV file of ``time,tx,ty,tz,qw,qx,qy,qz``, in any order.

    Other columns are left out, and so are rows whose pose is empty throughout: ``trajectory.csv``
    of ``ffpose track`` is one too.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: A column is missing, a number is none, a quaternion is not of norm one, or a time
            is not later than the one before, and the error names file and line; or no row has a
            pose.
    """
    entries = read_table(path, ("time", *POSE_COLUMNS), others=True)
    times: list[float] = []
    poses = []
    for entry in filter(has_pose, entries):
        time, *values = entry.parsed(("time", *POSE_COLUMNS))
        poses.append(entry.made(Pose.from_vector, values))
        if times and time <= times[-1]:
            raise entry.error(
                f"time: expected later than {times[-1]} s, the row before, got {time}"
            )
        times.append(time)
    if not poses:
        raise DataError("expected at least one row with a pose, got none", path)
    return Trajectory.through(np.array(times), poses)


def read_keypoints(path: Path) -> FloatArray:
    """Read named points ``(K, 3)`` of the object's frame, meters, from a CSV file.

    Its columns, in any order, are ``name``, ``x``, ``y`` and ``z``. Projected through an image's
    pose the points are labels of it, for dense supervision: SPEED+ as it is published has neither
    keypoints nor masks, but Tango's points can be reconstructed from its images (Park et al.,
    "Towards Robust Learning-Based Pose Estimation of Noncooperative Spacecraft", 2019).

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The columns are others, a number is not finite, or a name is there twice; the
            error names file and line.
    """
    entries, names = read_table(path, KEYPOINT), Names()
    for entry in entries:
        names.once(entry, entry.text("name"))
    return np.array([entry.parsed(KEYPOINT[1:]) for entry in entries])
