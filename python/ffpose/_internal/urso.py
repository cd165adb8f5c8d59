"""URSO's format: file names, columns, splits, camera, and the conversion of its labels.

A set is a folder with images ``N_rgb.png``, a table ``gt.csv`` whose row N labels image N, and for
each split the list ``{split}_images.csv`` (no header, one file name a line) and the table
``{split}_poses_gt.csv`` of their labels, row by row. The sets of ``ffpose render`` have a camera
file (`ffpose.geometry.CAMERA_FILE`) and a table of conditions besides.

URSO (Proença and Gao, 2020) labels its images in a left-handed camera frame (x right, y *up*, z
depth) with a JPL quaternion ``(q1, q2, q3, q4)``, scalar last, whose matrix is the transpose of
Hamilton's for the same four numbers. Mirroring y with ``M = diag(1, -1, 1)`` takes camera and
object to right-handed frames: ``t = M t_urso`` and ``R = M C M``, ``C`` being JPL's matrix. The
transpose negates the vector part; the mirror maps an axis ``a`` to ``det(M) M a = (-a1, a2, -a3)``;
together ``q = (q4, q1, -q2, q3)``, and a point of the object is ours with its y negated.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

Label = tuple[float, float, float, float, float, float, float]
"""A row of labels in the order of `COLUMNS`."""

COLUMNS = ("x", "y", "z", "q1", "q2", "q3", "q4")
SPLITS = ("train", "val", "test")
LISTS = {split: f"{split}_images.csv" for split in SPLITS}
TABLES = {split: f"{split}_poses_gt.csv" for split in SPLITS}
"""Names of the files of a split: list of images, table of labels."""

TABLE = "gt.csv"
CONDITIONS = "conditions.csv"

SIZE = (1280, 960)
"""Width and height of the published images, in pixels."""
FOCAL_LENGTHS = (640.0, 640.463)
CENTER = (640.0, 480.0)


def image_name(index: int) -> str:
    """Return the file name of image ``index``."""
    return f"{index}_rgb.png"


def index_of(name: str) -> int | None:
    """Return the index of the image with this file name, None if it is no image's name."""
    match = re.fullmatch(r"(\d+)_rgb\.png", name)
    return int(match[1]) if match else None


def from_label(
    x: float, y: float, z: float, q1: float, q2: float, q3: float, q4: float
) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Return translation and quaternion in the conventions of `ffpose.geometry`, not normalized."""
    return (x, -y, z), (q4, q1, -q2, q3)


def to_label(t: Iterable[float], q: Iterable[float]) -> Label:
    """Return the row of labels of translation and quaternion: the inverse of `from_label`."""
    (tx, ty, tz), (w, x, y, z) = t, q
    return tx, -ty, tz, x, -y, z, w
