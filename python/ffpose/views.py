"""What a network with a second look trains on: small pieces of each image, cut once and kept.

A network whose orientation comes from a virtual camera (`ffpose.models.virtual_camera`) sees two
things of an image: the whole frame, small, and the surroundings of the object, at the resolution
that the virtual camera needs. Both are cut from the image once and stored as memory-mapped uint8,
so that an epoch decodes and resizes nothing, and any number of processes share one copy:

* ``frames (N, h, w, 3)``: the image, `first_stride` pixels averaged to one;
* ``windows (N, S, S, 3)``: a square around the object out of the image's pyramid, from the level
  whose pixels are about those of the virtual camera; black outside the image;
* ``coordinates (N, S/2, S/2, 4)``: which point of the object each place of the window shows, and
  whether it shows the object, where labels for dense supervision are known;
* ``labels (N, 13)``: pose, and the window's camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry import Camera, Pose

Bytes = NDArray[np.uint8]
Arrays = Mapping[str, NDArray[Any]]
"""By name, the arrays of `ViewSpec.shapes`."""

Content = Literal["object", "empty", "decoy"]
"""What is in view: the object, nothing, or another one in its place."""

WINDOW = 144
"""Side of the window: the virtual camera's 64 pixels, twice finer at most, turned and displaced."""

LEVELS = 4
SHARPNESS = 0.8
"""Pixels of the chosen pyramid level a pixel of the virtual camera, at least."""

LABELS = ("tx", "ty", "tz", "qw", "qx", "qy", "qz", "fx", "fy", "cx", "cy", "level", "object")


@dataclass(frozen=True)
class ViewSpec:
    """How images are cut.

    Attributes:
        camera: Of the network's input, whose image is the pyramid's finest level.
        first_stride: Pixels of that image a pixel of the first look.
        object_width: Pixels of the virtual camera's image.
        object_radius_m: Meters at the object from the middle of that image to its edge.
    """

    camera: Camera
    first_stride: int
    object_width: int
    object_radius_m: float

    @property
    def frame_size(self) -> tuple[int, int]:
        """``(height, width)`` of a frame."""
        return self.camera.height // self.first_stride, self.camera.width // self.first_stride

    def shapes(self, count: int) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
        """Return shape and dtype of each array for ``count`` images."""
        return {
            "frames": ((count, *self.frame_size, 3), np.uint8),
            "windows": ((count, WINDOW, WINDOW, 3), np.uint8),
            "coordinates": ((count, WINDOW // 2, WINDOW // 2, 4), np.uint8),
            "labels": ((count, len(LABELS)), np.float64),
        }

    def level(self, translation: NDArray[np.float64]) -> int:
        """Return the pyramid level for an object at ``translation (3,)``, meters.

        Raises:
            ValueError: The object is not before the camera.
        """
        if not translation[2] > 0:
            raise ValueError(f"translation: expected z > 0, before the camera, got {translation}")
        distance = float(np.linalg.norm(translation))
        focal = self.object_width / 2 * distance / self.object_radius_m
        ratio = self.camera.fx / focal * distance / float(translation[2])
        return min(LEVELS - 1, max(0, math.floor(math.log2(ratio / SHARPNESS))))

    def level_camera(self, level: int) -> Camera:
        """Return the camera of a level, whose means leave out a rest of columns and rows."""
        width, height = self.camera.width >> level, self.camera.height >> level
        covered = self.camera.cropped(0, 0, width << level, height << level)
        return covered.resized(width, height)

    def window_camera(self, translation: NDArray[np.float64], level: int) -> Camera:
        """Return the camera of the window around an object at ``translation``, on a level."""
        camera = self.level_camera(level)
        u, v = camera.project(translation)
        left, top = round(u - WINDOW / 2), round(v - WINDOW / 2)
        return camera.cropped(left, top, WINDOW, WINDOW)


def averaged(image: Bytes, side: int) -> Bytes:
    """Average blocks of ``side`` pixels squared of an image ``(H, W, 3)``; a rest is dropped."""
    height, width = image.shape[0] // side, image.shape[1] // side
    blocks = image[: height * side, : width * side].reshape(height, side, width, side, 3)
    sums: NDArray[np.uint32] = blocks.sum(axis=(1, 3), dtype=np.uint32)
    area = side * side
    return ((sums + area // 2) // area).astype(np.uint8)


def cut(image: Bytes, left: int, top: int) -> Bytes:
    """Return the window of an image ``(H, W, 3)`` whose corner is (left, top), black outside."""
    window = np.zeros((WINDOW, WINDOW, 3), np.uint8)
    height, width = image.shape[:2]
    rows = slice(max(0, top), min(height, top + WINDOW))
    columns = slice(max(0, left), min(width, left + WINDOW))
    if rows.start < rows.stop and columns.start < columns.stop:
        part = image[rows, columns]
        y, x = rows.start - top, columns.start - left
        window[y : y + part.shape[0], x : x + part.shape[1]] = part
    return window


def in_frame(window: Camera, whole: Camera) -> NDArray[np.bool_]:
    """Return which pixels of a window, as `ViewSpec.window_camera` gives it, lie in the image."""
    left, top = round(whole.cx - window.cx), round(whole.cy - window.cy)
    columns, rows = np.arange(WINDOW) + left, np.arange(WINDOW) + top
    inside_columns = (columns >= 0) & (columns < whole.width)
    inside_rows = (rows >= 0) & (rows < whole.height)
    return np.asarray(inside_rows[:, None] & inside_columns)


def nearest_pixels(picture: Bytes, camera: Camera, other: Camera) -> Bytes:
    """Return what another camera of the same direction sees of a picture, by the nearest pixels.

    Args:
        picture: ``(H, W, C)`` uint8, taken by ``camera``.
        camera: Of the picture.
        other: Any camera at the same place that looks the same way.

    Returns:
        ``(other.height, other.width, C)``; zero outside the picture.
    """
    columns = (np.arange(other.width) + 0.5 - other.cx) / other.fx * camera.fx + camera.cx
    rows = (np.arange(other.height) + 0.5 - other.cy) / other.fy * camera.fy + camera.cy
    column, row = np.floor(columns).astype(np.intp), np.floor(rows).astype(np.intp)
    inside_columns = (column >= 0) & (column < camera.width)
    inside_rows = (row >= 0) & (row < camera.height)
    seen = np.zeros((other.height, other.width, picture.shape[2]), np.uint8)
    found = picture[np.ix_(row[inside_rows], column[inside_columns])]
    seen[np.ix_(inside_rows, inside_columns)] = found
    return seen


class Pieces(NamedTuple):
    """What is kept of one image.

    Attributes:
        frame: ``(h, w, 3)`` uint8.
        window: ``(WINDOW, WINDOW, 3)`` uint8.
        coordinates: ``(WINDOW / 2, WINDOW / 2, 4)`` uint8, zero where they are not known.
        pose: Where the object is; without one, what the window was cut around.
        camera: Of the window.
        level: Of the pyramid, 0 the finest.
        present: Whether the image shows the object.
    """

    frame: Bytes
    window: Bytes
    coordinates: Bytes
    pose: Pose
    camera: Camera
    level: int
    present: bool

    def store(self, arrays: Arrays, row: int) -> None:
        """Write into a row of the arrays of `ViewSpec.shapes`."""
        c = self.camera
        arrays["frames"][row] = self.frame
        arrays["windows"][row] = self.window
        arrays["coordinates"][row] = self.coordinates
        arrays["labels"][row] = (
            *self.pose.vector,
            *(c.fx, c.fy, c.cx, c.cy, self.level, float(self.present)),
        )


def cut_pieces(
    image: Bytes,
    pose: Pose,
    spec: ViewSpec,
    coordinates: Callable[[Pose, Camera], Bytes] | None = None,
) -> Pieces:
    """Cut an image of the network's camera into what is kept of it.

    Args:
        image: ``(H, W, 3)`` uint8, taken by ``spec.camera``.
        pose: Where the object is.
        spec: How to cut.
        coordinates: Gives the object's coordinates ``(h, w, 4)`` as a camera sees them, as
            `ffpose.render.layers.object_coordinates`; None where they are not known.

    Raises:
        ValueError: The image has another size than its camera, or the object is not before it.
    """
    expected = (spec.camera.height, spec.camera.width, 3)
    if image.shape != expected:
        raise ValueError(f"image: expected shape {expected}, got {image.shape}")
    level = spec.level(pose.t)
    camera = spec.window_camera(pose.t, level)
    whole = spec.level_camera(level)
    left, top = round(whole.cx - camera.cx), round(whole.cy - camera.cy)
    half = WINDOW // 2
    return Pieces(
        averaged(image, spec.first_stride),
        cut(averaged(image, 1 << level), left, top),
        np.zeros((half, half, 4), np.uint8)
        if coordinates is None
        else coordinates(pose, camera.resized(half, half)),
        pose,
        camera,
        level,
        True,
    )


def make_arrays(folder: Path, count: int, spec: ViewSpec) -> dict[str, np.memmap[Any, Any]]:
    """Make the arrays of a folder of views, mapped into memory, to be filled."""
    return {
        name: np.lib.format.open_memmap(folder / f"{name}.npy", "w+", dtype, shape)
        for name, (shape, dtype) in spec.shapes(count).items()
    }


def open_arrays(folder: Path) -> dict[str, NDArray[Any]]:
    """Map the arrays of a folder of views into memory, to be read."""
    names = ("frames", "windows", "coordinates", "labels")
    return {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in names}
