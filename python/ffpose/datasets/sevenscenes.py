"""Reader of 7Scenes: rooms seen by a handheld Kinect (Shotton et al., CVPR 2013).

A set is the folder of a scene with ``TrainSplit.txt`` and ``TestSplit.txt``, whose lines name
sequences (``sequence1`` is the folder ``seq-01``). A sequence has ``frame-000000.color.png`` and
``frame-000000.pose.txt``, a 4x4 matrix that transforms points of the camera to the world, meters.

The camera is that of ``camera.json`` (`ffpose.geometry.Camera.read`) if there is one, else
`CAMERA`, at the size of the first image.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ffpose._internal.entries import Entry
from ffpose.datasets.parsing import Names, existing_splits, read_lines, split_file
from ffpose.datasets.records import Record, with_camera
from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose, camera_pose
from ffpose.geometry.rotations import from_matrix

CAMERA = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=320.0, cy=240.0)
"""Nominal camera of the color images, which were not calibrated; only drawings depend on it."""

FILES = {"train": "TrainSplit.txt", "test": "TestSplit.txt"}

ROTATION_TOLERANCE = 5e-3
"""Deviation of ``R.T @ R`` from the identity, element by element, that is taken as rounding."""


def splits(root: Path) -> list[str]:
    """Return the splits of the set, in the order train, test."""
    return existing_splits(root, "7Scenes", FILES)


def read(root: Path, split: str) -> list[Record]:
    """Read the labeled images of a split, sequence by sequence."""
    path = split_file(root, "7Scenes", FILES, split)
    records, names = [], Names()
    for line, text in enumerate(read_lines(path), start=1):
        match = re.fullmatch(r"sequence(\d+)", text.strip())
        if match is None:
            raise DataError(f"expected a line such as sequence1, got {text!r}", path, line)
        name = names.once(Entry({}, path, line), f"seq-{int(match[1]):02d}")
        records += _read_sequence(root / name, path, line)
    if not records:
        raise DataError("expected at least one sequence, got none", path)
    return with_camera(records, root, CAMERA)


def _read_sequence(folder: Path, source: Path, line: int) -> list[Record]:
    """Read the frames of a sequence, which must each have an image and a matrix."""
    frames = sorted({path.name.split(".")[0] for path in folder.glob("frame-*")})
    if not frames:
        raise DataError(f"expected frames in {folder}, got none", source, line)
    records = []
    for frame in frames:
        image, label = folder / f"{frame}.color.png", folder / f"{frame}.pose.txt"
        for path in (image, label):
            if not path.is_file():
                raise DataError(f"expected {path}, got no such file", source, line)
        name = f"{folder.name}/{image.name}"
        pose = read_pose(label)
        records.append(Record(image, name, CAMERA, pose, label, 1, target="camera"))
    return records


def read_pose(path: Path) -> Pose:
    """Read the matrix from an image's camera to the world, as the world in the camera frame."""
    lines = read_lines(path)
    if len(lines) != 4:
        raise DataError(f"expected four rows of four numbers, got {len(lines)} rows", path)
    matrix = np.array([_row(text, path, line) for line, text in enumerate(lines, start=1)])
    rotation = matrix[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise DataError(f"expected a rotation in the first three columns, got {rotation}", path)
    if matrix[3].tolist() != [0, 0, 0, 1]:
        raise DataError(f"expected 0 0 0 1, got {lines[3]!r}", path, 4)
    return camera_pose(matrix[:3, 3], from_matrix(rotation.T))


def _row(text: str, path: Path, line: int) -> list[float]:
    try:
        row = [float(field) for field in text.split()]
    except ValueError as error:
        raise DataError(f"expected four numbers: {error}", path, line) from error
    if len(row) != 4 or not np.isfinite(row).all():
        raise DataError(f"expected four finite numbers, got {text!r}", path, line)
    return row
