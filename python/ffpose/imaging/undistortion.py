"""Undistortion of images: what a pinhole camera with the same intrinsics would have seen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ffpose.geometry import DistortedCamera


def undistort(image: Image.Image, camera: DistortedCamera) -> Image.Image:
    """Return an RGB image as ``camera.pinhole`` sees it, interpolated bilinearly.

    It has the size of the camera's images, and is black where the original shows nothing.
    """
    expected = ("RGB", (camera.width, camera.height))
    if (image.mode, image.size) != expected:
        raise ValueError(f"image: expected mode and size {expected}, got {image.mode, image.size}")
    height, width = camera.height, camera.width
    bordered = np.pad(np.asarray(image, np.float32), ((1, 1), (1, 1), (0, 0)))
    pixels = bordered.reshape(-1, 3)
    seen = np.zeros((height * width, 3), np.float32)
    for place, weight in _corners(camera):
        seen += pixels[place] * weight[:, None]
    return Image.fromarray(np.rint(seen).astype(np.uint8).reshape(height, width, 3))


@lru_cache(maxsize=2)
def _corners(camera: DistortedCamera) -> list[tuple[NDArray[np.intp], NDArray[np.float32]]]:
    """Return place and weight ``(H W,)`` of the four pixels between which the image shows each one.

    Places count in the image with a black border of one pixel, where all that lies outside is.
    """
    width, height = camera.width, camera.height
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = (np.stack([columns, rows], axis=-1) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    seen = camera.distort(rays) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    x, y = (np.clip(seen + 0.5, 0, (width + 1, height + 1))).reshape(-1, 2).T  # center 0.5 is at 1
    left, top = np.minimum(x, width).astype(np.intp), np.minimum(y, height).astype(np.intp)
    across, down = x - left, y - top
    corners = []
    for right, low in np.ndindex(2, 2):
        weight = np.where(right, across, 1 - across) * np.where(low, down, 1 - down)
        corners.append(((top + low) * (width + 2) + left + right, weight.astype(np.float32)))
    return corners
