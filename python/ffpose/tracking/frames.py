"""The frames of a sequence on disk: images, times and, where they are known, poses."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ffpose.datasets.parsing import Names, read_table
from ffpose.errors import DataError
from ffpose.geometry import POSE_COLUMNS, Pose

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
    ``frames.csv`` in the folder, as ``ffpose render approach`` writes it.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: A column is missing or unknown, a number is none, an image is listed twice, or a
            time is not later than the one before; the error names file and line. Whether the images
            are there is seen when their turn comes.
    """
    path = times or folder / TIMES
    if not path.is_file():
        hint = "" if times else ", or another file as --times"
        raise FileNotFoundError(f"times: expected {path}{hint}, got no such file")
    header, entries = read_table(path)
    posed = any(name in header for name in POSE_COLUMNS)
    required = {"image", "time", *(POSE_COLUMNS if posed else ())}
    if set(header) - {"camera"} != required:
        expected = f"expected the columns image, time and perhaps {', '.join(POSE_COLUMNS)}"
        raise DataError(f"{expected}, got {', '.join(header)}", path, 1)
    names, frames = Names(), list[Frame]()
    for entry in entries:
        image = folder / names.add(entry, entry.text("image"))
        (time,) = entry.parsed(("time",))
        if frames and time <= frames[-1].time:
            before = frames[-1].time
            raise entry.error(f"time: expected later than {before} s, the row before, got {time} s")
        pose = None
        if posed and any(entry.values[name].strip() for name in POSE_COLUMNS):
            values = entry.parsed(POSE_COLUMNS)
            pose = entry.made(Pose, values[:3], values[3:])
        frames.append(Frame(image, time, pose))
    return frames
