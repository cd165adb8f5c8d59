"""Undistortion of images: what a pinhole camera with the same intrinsics would have seen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import grid_sample

from ffpose.geometry import DistortedCamera


def undistort(image: Image.Image, camera: DistortedCamera) -> Image.Image:
    """Return an image as ``camera.pinhole`` sees it, interpolated bilinearly.

    Args:
        image: RGB image of the camera's size.
        camera: The camera that took it.

    Returns:
        An image of the same size, black where the original shows nothing.

    Raises:
        ValueError: The image is not RGB, or of another size.
    """
    expected = ("RGB", (camera.width, camera.height))
    if (image.mode, image.size) != expected:
        raise ValueError(f"image: expected mode and size {expected}, got {image.mode, image.size}")
    pixels = torch.from_numpy(np.array(image)).permute(2, 0, 1)[None].float()  # (1, 3, H, W)
    seen = grid_sample(pixels, _grid(camera), "bilinear", "zeros", align_corners=False)[0]
    return Image.fromarray(seen.permute(1, 2, 0).round().to(torch.uint8).numpy())


@lru_cache(maxsize=2)
def _grid(camera: DistortedCamera) -> Tensor:
    """Return where the image shows each pixel of the pinhole's, ``(1, H, W, 2)`` in [-1, 1].

    `grid_sample` without aligned corners has the edges of the image at -1 and 1, as
    `ffpose.geometry` has them at 0 and its size.
    """
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([columns, rows], axis=-1)
    focal, center = (camera.fx, camera.fy), (camera.cx, camera.cy)
    seen = camera.bend((pixels - center) / focal) * focal + center
    return torch.from_numpy(2 * seen / (camera.width, camera.height) - 1).float()[None]
