"""Label files in URSO's layout: a table of all poses, and names and poses of each split.

Labels are in URSO's own frame (`ffpose._internal.urso`) and keep every digit. A table of each
image's conditions, which URSO's layout does not have, stands beside them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffpose._internal import urso
from ffpose._internal.files import atomic_write
from ffpose.geometry import CAMERA_FILE, Camera, Pose
from ffpose.render.renderer import situation
from ffpose.render.sampler import meets_earth, visible_share
from ffpose.render.scene import Scene
from ffpose.render.scene_file import find_scene


class Conditions(NamedTuple):
    """The conditions of one image.

    Attributes:
        distance_m: Distance from the camera to the object's origin, meters.
        eclipsed: Whether the Earth hides the sun; a lamp at the camera then gives light.
        sun_angle_deg: Angle between the viewing ray, which goes to the object's origin, and the
            direction to the sun; below 90 degrees the sun is in front of the camera and a sunlit
            object is back-lit.
        earth_behind: Whether the viewing ray goes on to the Earth, and the image shows the Earth
            there rather than the random background of `ffpose.render.Randomization`.
        visible_share: Fraction of points on the spacecraft's surface that lie in the frame.
    """

    distance_m: float
    eclipsed: bool
    sun_angle_deg: float
    earth_behind: bool
    visible_share: float


def conditions_of(scene: Scene | str, seed: int, index: int) -> Conditions:
    """Return the conditions of the image that `render` makes of these arguments, at any size."""
    scene = find_scene(scene)
    pose, around, backdrop = situation(scene, seed, index)
    distance = float(np.linalg.norm(pose.t))
    ray = pose.t / distance
    across = float(np.linalg.norm(np.cross(ray, around.sun)))
    return Conditions(
        distance_m=distance,
        eclipsed=around.eclipsed,
        sun_angle_deg=float(np.degrees(np.arctan2(across, ray @ around.sun))),
        earth_behind=not backdrop and meets_earth(ray, around.nadir, around.altitude),
        visible_share=visible_share(pose.transform(scene.build().outline), scene.camera),
    )


def split_of(index: int) -> str:
    """Return the split of image `index`: of ten in a row, eight train, one val, one test.

    A longer set therefore never moves an image from one split to another.
    """
    return {1: "val", 2: "test"}.get(index % 10, "train")


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
    camera.write(folder / CAMERA_FILE)
    names = [CAMERA_FILE]
    if 0 in poses:
        names.append(urso.TABLE)
        _write_poses(folder / urso.TABLE, poses.values())
    for split in urso.SPLITS:
        members = [index for index in poses if split_of(index) == split]
        if members:
            names += [urso.images_file(split), urso.poses_file(split)]
            with atomic_write(folder / names[-2]) as path:
                lines = [f"{urso.image_name(index)}\n" for index in members]
                path.write_text("".join(lines), encoding="utf-8")
            _write_poses(folder / names[-1], [poses[index] for index in members])
    return names


def write_conditions(folder: Path, conditions: Mapping[int, Conditions]) -> str:
    """Write the conditions of images, given by index, and return the name of the file."""
    target = folder / urso.CONDITIONS
    with atomic_write(target) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["image", *Conditions._fields])
        for index, row in conditions.items():
            values = (int(value) if isinstance(value, bool) else value for value in row)
            writer.writerow([urso.image_name(index), *values])
    return target.name


def _write_poses(target: Path, poses: Iterable[Pose]) -> None:
    with atomic_write(target) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, urso.COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: repr(v) for k, v in pose.to_urso().items()} for pose in poses)
