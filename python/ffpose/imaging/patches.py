"""Training patches of a network with a second look: cut from each image once, and stored.

A network whose orientation comes from a virtual camera (`ffpose.models.virtual_camera`) reads two
patches of an image: the downsampled whole frame, and the surroundings of the object at the
resolution of the virtual camera. Both are cut once and stored as memory-mapped uint8, so that an
epoch decodes and resizes nothing, and any number of processes share one copy:

* ``frames (N, h, w, 3)``: the image, downsampled by averaging `first_stride` pixels;
* ``windows (N, S, S, 3)``: a square around the object from the image pyramid, at the level whose
  resolution is about that of the virtual camera; black outside the image;
* ``coordinates (N, S/2, S/2, 4)``: object coordinates and mask of each cell of the window, where
  labels for dense supervision are available;
* ``labels (N, 13)``: pose, and the window's camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import expect
from ffpose.geometry import Camera, Pose

Bytes = NDArray[np.uint8]
Arrays = Mapping[str, NDArray[Any]]
"""Arrays by name, as in `PatchSpec.shapes`."""

Content = Literal["object", "empty", "decoy"]
"""Content of a patch: the object, nothing, or another object in its place."""

WINDOW_MARGIN = 16
"""Pixels by which a window is wider than twice the virtual camera's view.

Its resolution is up to 1.6 times as high: there is room for rotation and displacement too."""

LEVELS = 4
"""Levels of the image pyramid, the image itself among them."""

SHARPNESS = 0.8
"""Least number of pixels of the chosen pyramid level per pixel of the virtual camera."""

LABELS = ("tx", "ty", "tz", "qw", "qx", "qy", "qz", "fx", "fy", "cx", "cy", "level", "object")


@dataclass(frozen=True)
class PatchSpec:
    """Geometry of the two patches that are cut from an image.

    Attributes:
        camera: Camera of the network's input, the finest level of the image pyramid.
        first_stride: Pixels of the input per pixel of the first look.
        object_width: Width of the virtual camera's view, pixels.
        object_radius_m: Half the width of the virtual camera's view at the object, meters.
    """

    camera: Camera
    first_stride: int
    object_width: int
    object_radius_m: float

    @property
    def window(self) -> int:
        """Side of the window, pixels."""
        return 2 * self.object_width + WINDOW_MARGIN

    @property
    def frame_size(self) -> tuple[int, int]:
        """Size ``(height, width)`` of a frame."""
        return self.camera.height // self.first_stride, self.camera.width // self.first_stride

    def empty(self, count: int) -> dict[str, NDArray[Any]]:
        """Return the arrays for ``count`` images, zero."""
        return {name: np.zeros(*shape) for name, shape in self.shapes(count).items()}

    def shapes(self, count: int) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
        """Return shape and dtype of each array for ``count`` images."""
        return {
            "frames": ((count, *self.frame_size, 3), np.uint8),
            "windows": ((count, self.window, self.window, 3), np.uint8),
            "coordinates": ((count, self.window // 2, self.window // 2, 4), np.uint8),
            "labels": ((count, len(LABELS)), np.float64),
        }

    def level(self, translation: NDArray[np.float64]) -> int:
        """Return the pyramid level for an object at ``translation (3,)``, meters, z > 0."""
        expect(translation[2] > 0, "translation", "z > 0", translation)
        distance = float(np.linalg.norm(translation))
        focal = self.object_width / 2 * distance / self.object_radius_m
        ratio = self.camera.fx / focal * distance / float(translation[2])
        return min(LEVELS - 1, max(0, math.floor(math.log2(ratio / SHARPNESS))))

    def level_camera(self, level: int) -> Camera:
        """Return the camera of a pyramid level; incomplete blocks at its border are dropped."""
        width, height = self.camera.width >> level, self.camera.height >> level
        covered = self.camera.cropped(0, 0, width << level, height << level)
        return covered.resized(width, height)

    def window_camera(self, translation: NDArray[np.float64], level: int) -> Camera:
        """Return the camera of the window around an object at ``translation``, on a level."""
        camera = self.level_camera(level)
        u, v = camera.project(translation)
        left, top = round(u - self.window / 2), round(v - self.window / 2)
        return camera.cropped(left, top, self.window, self.window)


def averaged(image: Bytes, side: int) -> Bytes:
    """Average blocks of ``side`` x ``side`` pixels of an image ``(H, W, 3)``; a rest is dropped."""
    if side == 1:
        return image
    height, width = image.shape[0] // side, image.shape[1] // side
    blocks = image[: height * side, : width * side].reshape(height, side, width, side, 3)
    # One slice after another, which NumPy adds several times as fast as it sums over two axes.
    columns = sum((blocks[:, row] for row in range(1, side)), blocks[:, 0].astype(np.uint32))
    sums = sum((columns[:, :, column] for column in range(1, side)), columns[:, :, 0])
    area = side * side
    return ((sums + area // 2) // area).astype(np.uint8)


def in_frame(window: Camera, whole: Camera) -> NDArray[np.bool_]:
    """Return which pixels of a window from `PatchSpec.window_camera` lie in the image."""
    _, _, columns, rows = _places(whole, window)
    return np.asarray(rows[:, None] & columns)


def nearest_pixels(picture: Bytes, camera: Camera, other: Camera) -> Bytes:
    """Resample an image ``(H, W, C)`` for another camera of the same pose, by nearest neighbor.

    Returns:
        Image ``(other.height, other.width, C)``; zero outside the given one.
    """
    column, row, columns, rows = _places(camera, other)
    seen = np.zeros((other.height, other.width, picture.shape[2]), np.uint8)
    seen[np.ix_(rows, columns)] = picture[np.ix_(row[rows], column[columns])]
    return seen


def _places(
    camera: Camera, other: Camera
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return column and row of a camera's image that another shows, and which lie in it."""
    columns = (np.arange(other.width) + 0.5 - other.cx) / other.fx * camera.fx + camera.cx
    rows = (np.arange(other.height) + 0.5 - other.cy) / other.fy * camera.fy + camera.cy
    column, row = np.floor(columns).astype(np.intp), np.floor(rows).astype(np.intp)
    inside = (column >= 0) & (column < camera.width), (row >= 0) & (row < camera.height)
    return column, row, *inside


class Patches(NamedTuple):
    """The stored patches of one image.

    Attributes:
        frame: ``(h, w, 3)`` uint8.
        window: ``(S, S, 3)`` uint8, S being `PatchSpec.window`.
        coordinates: ``(S / 2, S / 2, 4)`` uint8, zero where unknown.
        pose: Pose of the object; without an object, the pose that the window was cut around.
        camera: Camera of the window.
        level: Pyramid level of the window, 0 the finest.
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
        """Write the patches to a row of the arrays of `PatchSpec.shapes`."""
        c = self.camera
        arrays["frames"][row] = self.frame
        arrays["windows"][row] = self.window
        arrays["coordinates"][row] = self.coordinates
        arrays["labels"][row] = (
            *self.pose.vector,
            *(c.fx, c.fy, c.cx, c.cy, self.level, float(self.present)),
        )


def extract_patches(
    image: Bytes,
    pose: Pose,
    spec: PatchSpec,
    coordinates: Callable[[Camera], Bytes] | None = None,
    halved: int = 0,
) -> Patches:
    """Extract the stored patches from an image of the network's camera.

    Args:
        image: Image ``(H, W, 3)`` of ``spec.level_camera(halved)``, uint8.
        pose: Pose of the object.
        spec: Geometry of the patches.
        coordinates: Function that returns the object coordinates ``(h, w, 4)`` for a camera of the
            same view, as `ffpose.render.layers.object_coordinates`; None where unknown.
        halved: Level of the image pyramid that the image is, at most `PatchSpec.level` of the pose.

    Raises:
        ValueError: The image's size differs from its camera's, or the object is not in front of it.
    """
    given = spec.level_camera(halved)
    expected = (given.height, given.width, 3)
    expect(image.shape == expected, "image", f"shape {expected}", image.shape)
    level = spec.level(pose.t)
    camera = spec.window_camera(pose.t, level)
    half = spec.window // 2
    return Patches(
        averaged(image, spec.first_stride >> halved),
        nearest_pixels(averaged(image, 1 << (level - halved)), spec.level_camera(level), camera),
        np.zeros((half, half, 4), np.uint8)
        if coordinates is None
        else coordinates(camera.resized(half, half)),
        pose,
        camera,
        level,
        True,
    )
