"""Label files in URSO's layout: a table of all poses, and names and poses of each split.

Labels are in URSO's own frame (`ffpose.geometry`) and keep every digit. A table of each image's
conditions, which URSO's layout does not have, stands beside them.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path

from ffpose.files import atomic_write
from ffpose.geometry import Camera, Pose
from ffpose.render.conditions import Conditions

SPLITS = ("train", "val", "test")
COLUMNS = ("x", "y", "z", "q1", "q2", "q3", "q4")


def split_of(index: int) -> str:
    """Return the split of image `index`: of ten in a row, eight train, one val, one test.

    A longer set therefore never moves an image from one split to another.
    """
    return {1: "val", 2: "test"}.get(index % 10, "train")


def image_name(index: int) -> str:
    """Return the file name of image `index`."""
    return f"{index}_rgb.png"


def index_of(name: str) -> int | None:
    """Return the index of the image with this file name, None if it is no image's name."""
    match = re.fullmatch(r"(\d+)_rgb\.png", name)
    return int(match[1]) if match else None


def write_tables(folder: Path, poses: Mapping[int, Pose], camera: Camera) -> list[str]:
    """Write labels, splits and camera of a set.

    A split without images has no files. Row N of ``gt.csv`` is that of image N, so a set that does
    not begin with image 0 has no ``gt.csv``.

    Args:
        folder: Folder of the images.
        poses: Label of each image by its index, in order and without gaps.
        camera: The camera of the images.

    Returns:
        The names of the files written.
    """
    _write_text(folder / "camera.json", json.dumps(asdict(camera), indent=1) + "\n")
    names = ["camera.json"]
    if 0 in poses:
        names.append("gt.csv")
        _write_poses(folder / "gt.csv", poses.values())
    for split in SPLITS:
        members = [index for index in poses if split_of(index) == split]
        if members:
            names += [f"{split}_images.csv", f"{split}_poses_gt.csv"]
            _write_text(folder / names[-2], "".join(f"{image_name(index)}\n" for index in members))
            _write_poses(folder / names[-1], [poses[index] for index in members])
    return names


def write_conditions(folder: Path, conditions: Mapping[int, Conditions]) -> str:
    """Write the conditions of images, given by index, and return the name of the file."""
    target = folder / "conditions.csv"
    with atomic_write(target) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["image", *Conditions._fields])
        for index, row in conditions.items():
            values = (int(value) if isinstance(value, bool) else value for value in row)
            writer.writerow([image_name(index), *values])
    return target.name


def _write_poses(target: Path, poses: Iterable[Pose]) -> None:
    with atomic_write(target) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: repr(v) for k, v in pose.to_urso().items()} for pose in poses)


def _write_text(target: Path, text: str) -> None:
    with atomic_write(target) as path:
        path.write_text(text, encoding="utf-8")
