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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry import Camera, Pose

Bytes = NDArray[np.uint8]
Arrays = dict[str, NDArray[Any]]

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
        object_radius_m: Metres at the object from the middle of that image to its edge.
    """

    camera: Camera
    first_stride: int
    object_width: int
    object_radius_m: float

    @property
    def frame_size(self) -> tuple[int, int]:
        """``(height, width)`` of a frame."""
        return self.camera.height // self.first_stride, self.camera.width // self.first_stride

    def shapes(self, count: int) -> dict[str, tuple[tuple[int, ...], type]]:
        """Return shape and dtype of each array for ``count`` images."""
        return {
            "frames": ((count, *self.frame_size, 3), np.uint8),
            "windows": ((count, WINDOW, WINDOW, 3), np.uint8),
            "coordinates": ((count, WINDOW // 2, WINDOW // 2, 4), np.uint8),
            "labels": ((count, len(LABELS)), np.float64),
        }

    def level(self, translation: NDArray[np.float64]) -> int:
        """Return the pyramid level for an object at ``translation (3,)``, metres.

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


def halved(image: Bytes, times: int) -> Bytes:
    """Average blocks of ``2**times`` pixels squared of an image ``(H, W, 3)``."""
    if times == 0:
        return image
    return averaged(image, 1 << times)


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


def write_view(
    arrays: Arrays,
    index: int,
    image: Bytes,
    pose: Pose,
    spec: ViewSpec,
    coordinates: Callable[[Pose, Camera], Bytes] | None,
    present: bool = True,
) -> None:
    """Cut an image of the network's camera and store its pieces in row ``index``.

    Args:
        arrays: The arrays of `ViewSpec.shapes`.
        index: The row.
        image: ``(H, W, 3)``, taken by ``spec.camera``.
        pose: Where the object is; without an object, where to cut.
        spec: How to cut.
        coordinates: Gives the object's coordinates ``(h, w, 4)`` as a camera sees them, as
            `ffpose.render.layers.object_coordinates`; None where they are not known.
        present: Whether the image shows the object.

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
    arrays["frames"][index] = averaged(image, spec.first_stride)
    arrays["windows"][index] = cut(halved(image, level), left, top)
    if coordinates is not None and present:
        arrays["coordinates"][index] = coordinates(pose, camera.resized(WINDOW // 2, WINDOW // 2))
    arrays["labels"][index] = (
        *pose.vector,
        *(camera.fx, camera.fy, camera.cx, camera.cy, level, float(present)),
    )


def open_arrays(folder: Path, mode: Literal["r", "r+"] = "r") -> Arrays:
    """Map the arrays of a folder of views into memory."""
    names = ("frames", "windows", "coordinates", "labels")
    return {name: np.load(folder / f"{name}.npy", mmap_mode=mode) for name in names}
