"""The frames of a sequence on disk: images, times and, where they are known, poses."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

from ffpose.datasets.csv_set import camera_file, has_pose
from ffpose.datasets.parsing import Names, read_table
from ffpose.geometry import CAMERA_FILE, POSE_COLUMNS, Pose
from ffpose.imaging.images import is_image

logger = logging.getLogger(__name__)

TIMES = "frames.csv"


class Frame(NamedTuple):
    """One image of a sequence: middle of the exposure, seconds, and the true pose, if known."""

    image: Path
    time: float
    pose: Pose | None


def read_frames(folder: Path, times: Path | None = None) -> list[Frame]:
    """Read the frames of a folder, in the order of their times.

    ``times`` is a CSV file with the columns ``image`` (a path within the folder) and ``time``
    (seconds) and perhaps ``tx, ty, tz, qw, qx, qy, qz``, empty where a pose is not known; None for
    ``frames.csv`` in the folder, as ``ffpose render approach`` writes it. A column ``camera``, as
    sets of images may have (`ffpose.datasets.csv_set`), must be ``camera.json`` in each row. Images
    beside them that the file does not list are left out, and a warning says how many.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: A column is missing or unknown, a number is none, an image is listed twice or of
            another camera, or a time is not later than the one before; the error names file and
            line. Whether the images are there is seen when their turn comes.
    """
    path = times or folder / TIMES
    if not path.is_file():
        hint = "" if times else ", or another file as --times"
        raise FileNotFoundError(f"times: expected {path}{hint}, got no such file")
    names, frames = Names(), list[Frame]()
    for entry in read_table(path, ("image", "time"), POSE_COLUMNS, ("camera",)):
        image = folder / names.add(entry, entry.text("image"))
        if "camera" in entry.values and camera_file(folder, entry) != folder / CAMERA_FILE:
            expected = f"{CAMERA_FILE} in each row, as a track is of one camera"
            got = f"{entry.text('camera')}: copy it to {CAMERA_FILE}, and leave the column out"
            raise entry.error(f"camera: expected {expected}, got {got}")
        (time,) = entry.parsed(("time",))
        if frames and time <= frames[-1].time:
            before = frames[-1].time
            raise entry.error(f"time: expected later than {before} s, the row before, got {time} s")
        pose = None
        if has_pose(entry):
            values = entry.parsed(POSE_COLUMNS)
            pose = entry.made(Pose, values[:3], values[3:])
        frames.append(Frame(image, time, pose))
    if unlisted := _unlisted(folder, frames):
        logger.warning(
            "%s: %d images are left out, as %s does not list them", folder, unlisted, path
        )
    return frames


def _unlisted(folder: Path, frames: list[Frame]) -> int:
    """Return the number of images in the folder, and beside the frames, that are no frames."""
    listed = {frame.image for frame in frames}
    places = {folder, *(image.parent for image in listed)}
    there = (path for place in places for path in place.glob("*"))
    return sum(is_image(path) and path not in listed for path in there)
