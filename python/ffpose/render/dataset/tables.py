"""Label files in URSO's layout: a table of all poses, and names and poses of each split.

Labels are in URSO's own frame (`ffpose._internal.urso`) and keep every digit. A table of each
image's conditions, which URSO's layout does not have, stands beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffpose._internal import urso
from ffpose._internal.files import write_csv, write_text
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


def conditions_of(scene: Scene | str | Path, seed: int, index: int) -> Conditions:
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


def write_tables(
    folder: Path, camera: Camera, poses: Mapping[int, Pose], conditions: Mapping[int, Conditions]
) -> list[str]:
    """Write camera, labels, splits and conditions of a set, and return the names of the files.

    ``poses`` and ``conditions`` are by the images' indices, in order and without gaps. A split
    without images has no files. Row N of ``gt.csv`` is that of image N, so a set that does not
    begin with image 0 has no ``gt.csv``.
    """
    camera.write(folder / CAMERA_FILE)
    names = [CAMERA_FILE]
    if 0 in poses:
        names.append(urso.TABLE)
        _write_poses(folder / urso.TABLE, poses.values())
    for split in urso.SPLITS:
        members = [index for index in poses if split_of(index) == split]
        if members:
            names += [urso.LISTS[split], urso.TABLES[split]]
            lines = [f"{urso.image_name(index)}\n" for index in members]
            write_text(folder / names[-2], "".join(lines))
            _write_poses(folder / names[-1], [poses[index] for index in members])
    rows = (
        [urso.image_name(n), *(int(v) if isinstance(v, bool) else v for v in row)]
        for n, row in conditions.items()
    )
    write_csv(folder / urso.CONDITIONS, [("image", *Conditions._fields), *rows])
    return [*names, urso.CONDITIONS]


def _write_poses(target: Path, poses: Iterable[Pose]) -> None:
    write_csv(target, [urso.COLUMNS, *(pose.to_urso().values() for pose in poses)])
