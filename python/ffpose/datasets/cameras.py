"""The camera of a set whose images are all of one: its ``camera.json``, or the published one."""

from __future__ import annotations

from pathlib import Path

from ffpose.datasets.records import Record
from ffpose.geometry import CAMERA_FILE, Camera


def read_camera(root: Path, first: Record, published: Camera) -> Camera:
    """Return the camera of ``camera.json``, else the published one at the size of the first image.

    Args:
        root: The dataset's folder.
        first: The first image.
        published: Camera of the images as published; smaller ones of its shape are taken as
            resized.

    Raises:
        DataError: The camera is invalid, or the images are larger than the published ones or of
            another shape.
    """
    path = root / CAMERA_FILE
    if path.exists():
        return Camera.read(path)
    width, height = first.size()
    if not published.has_aspect(width, height) or width > published.width:
        raise first.error(
            f"expected at most {published.width}x{published.height} pixels, of that shape, "
            f"where there is no {path.name}, got {width}x{height}"
        )
    return published.resized(width, height)
