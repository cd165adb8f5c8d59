"""The second look: a virtual camera at the same place, turned to the object.

A pinhole camera that only turns sees the same scene through the homography ``K_v R K^-1``:
rotation, crop and scale in one, exact for every depth. Turned to the object, with a field of view
that is a fixed number of meters at the object's distance, it shows a craft of one size in the
middle of the image, whatever its place in the frame: what is left to learn is the attitude, and
small corrections of the position. Poses go from camera to virtual camera and back by the rotation
alone::

    t_v = R t,   R_v = R R_object

The rotation `toward` is the least one that takes the optical axis to the viewing ray, so that
attitudes seen through the virtual camera are the allocentric ones. All functions take batches, are
differentiable, and consist of operators that export.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

PYRAMID_LEVELS = 4
SHARPNESS = 0.8
"""Pixels of the chosen pyramid level a pixel of the virtual camera, at least."""

LEAST_DEPTH = 1e-3
"""Of a ray in the source camera; rays that point farther backward see nothing."""

FAR_OUTSIDE = -1e6


class VirtualCamera(NamedTuple):
    """Cameras turned to the objects of a batch.

    Attributes:
        rotation: ``(B, 3, 3)``, from the camera's frame to the virtual one's.
        focal: ``(B,)`` focal length in pixels of the virtual image, whose center is the principal
            point.
        distance: ``(B,)`` meters to the point that was turned to.
        size: ``(height, width)`` of the virtual image.
    """

    rotation: Tensor
    focal: Tensor
    distance: Tensor
    size: tuple[int, int]

    def points(self, points: Tensor) -> Tensor:
        """Take points ``(B, 3)`` from the camera's frame to the virtual one's."""
        return (self.rotation @ points[:, :, None])[..., 0]

    def points_back(self, points: Tensor) -> Tensor:
        """Take points ``(B, 3)`` from the virtual camera's frame to the camera's."""
        return (self.rotation.transpose(1, 2) @ points[:, :, None])[..., 0]


def toward(directions: Tensor) -> Tensor:
    """Return the least rotations ``(B, 3, 3)`` that take the z axis to ``directions (B, 3)``.

    The directions need not have length one, but must not point along -z.
    """
    x, y, z = F.normalize(directions, dim=-1).unbind(-1)
    k = 1 / (1 + z)
    rows = [1 - k * x * x, -k * x * y, x, -k * x * y, 1 - k * y * y, y, -x, -y, z]
    return torch.unflatten(torch.stack(rows, dim=-1), -1, (3, 3))


def turned_about_axis(angles: Tensor) -> Tensor:
    """Return rotations ``(B, 3, 3)`` about the z axis by ``angles (B,)``, radians."""
    c, s, zero, one = angles.cos(), angles.sin(), torch.zeros_like(angles), torch.ones_like(angles)
    rows = [c, -s, zero, s, c, zero, zero, zero, one]
    return torch.unflatten(torch.stack(rows, dim=-1), -1, (3, 3))


def turn_to(
    points: Tensor, radius_m: float, size: tuple[int, int], twist: Tensor | None = None
) -> VirtualCamera:
    """Turn a virtual camera to points of the camera's frame.

    Args:
        points: ``(B, 3)`` meters, not behind the camera.
        radius_m: Meters at the point's distance from the middle of the image to its left edge.
        size: ``(height, width)`` of the image in pixels.
        twist: ``(B,)`` radians by which the scene is then turned about the viewing ray; None for
            not at all.
    """
    distance = points.norm(dim=-1)
    rotation = toward(points).transpose(1, 2)
    if twist is not None:
        rotation = turned_about_axis(twist) @ rotation
    return VirtualCamera(rotation, size[1] / 2 * distance / radius_m, distance, size)


def source_pixels(view: VirtualCamera, intrinsics: Tensor) -> Tensor:
    """Return where the pixels of a virtual image lie in the image that it is taken from.

    Args:
        view: The virtual cameras.
        intrinsics: ``(B, 4)`` or ``(4,)``: fx, fy, cx, cy of the source image.

    Returns:
        ``(B, h, w, 2)`` continuous pixel coordinates (u, v); far outside for rays that the source
        camera cannot see.
    """
    height, width = view.size
    like: dict[str, Any] = {"dtype": view.focal.dtype, "device": view.focal.device}
    u = (torch.arange(width, **like) + 0.5 - width / 2).expand(height, width)
    v = (torch.arange(height, **like) + 0.5 - height / 2)[:, None].expand(height, width)
    pixels = torch.stack([u, v, torch.ones_like(u)], dim=-1).flatten(0, 1)  # (h w, 3)
    seen = pixels @ homography(view, intrinsics).transpose(1, 2)  # (B, h w, 3)
    depth = seen[..., 2:]
    found = seen[..., :2] / depth.clamp_min(LEAST_DEPTH)
    found = torch.where(depth > LEAST_DEPTH, found, torch.full_like(found, FAR_OUTSIDE))
    return torch.unflatten(found, 1, view.size)


def homography(view: VirtualCamera, intrinsics: Tensor) -> Tensor:
    """Return ``K R^T K_v^-1`` ``(B, 3, 3)``: from virtual pixels to those of the source image.

    Virtual pixels count from the middle of the image. The third coordinate of the result is the
    depth of a ray whose depth in the virtual camera is one.
    """
    intrinsics = intrinsics.to(view.focal.dtype).expand(view.focal.shape[0], 4)
    fx, fy, cx, cy = intrinsics.unbind(1)
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    matrix = torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one], dim=-1)
    scale = torch.stack([1 / view.focal, 1 / view.focal, one], dim=-1)
    source = torch.unflatten(matrix, 1, (3, 3))
    return source @ view.rotation.transpose(1, 2) * scale[:, None, :]


def sample(image: Tensor, pixels: Tensor, mode: str = "bilinear") -> Tensor:
    """Sample images ``(B, C, H, W)`` at ``pixels (B, h, w, 2)``; zero outside."""
    height, width = image.shape[-2:]
    scale = pixels.new_tensor((2 / width, 2 / height))
    grid = (pixels * scale - 1).to(image.dtype)
    return F.grid_sample(image, grid, mode=mode, align_corners=False)


def joined(views: list[VirtualCamera]) -> VirtualCamera:
    """Return the cameras of several batches as one batch, those of the first before the others'."""
    return VirtualCamera(
        torch.cat([view.rotation for view in views]),
        torch.cat([view.focal for view in views]),
        torch.cat([view.distance for view in views]),
        views[0].size,
    )


def look(images: Tensor, view: VirtualCamera, points: Tensor, intrinsics: Tensor) -> Tensor:
    """Return what virtual cameras see, ``(B, C, h, w)``.

    Each image of the batch is read from that level of its pyramid of 2 x 2 means whose pixels are
    about as large as those of the virtual camera, so that distant and near objects are sampled
    alike and nothing aliases.

    Args:
        images: ``(B, C, H, W)``; what lies outside counts as zero.
        view: The virtual cameras.
        points: ``(B, 3)``, what they are turned to.
        intrinsics: ``(4,)``: fx, fy, cx, cy of the images.
    """
    return look_into(pyramid(images), view, points, intrinsics)


def pyramid(images: Tensor) -> list[Tensor]:
    """Return the levels of images ``(B, C, H, W)``, the finest first, each half the one before."""
    levels = [images]
    for _ in range(1, PYRAMID_LEVELS):
        levels.append(F.avg_pool2d(levels[-1], 2))
    return levels


def look_into(
    levels: list[Tensor], view: VirtualCamera, points: Tensor, intrinsics: Tensor
) -> Tensor:
    """Return what `look` does, for the levels of a `pyramid`."""
    level = pyramid_level(view, points, intrinsics)
    pixels = source_pixels(view, intrinsics)
    result = sample(levels[0], pixels)
    for number in range(1, len(levels)):
        seen = sample(levels[number], pixels / 2**number)
        result = torch.where((level == number)[:, None, None, None], seen, result)
    return result


def pyramid_level(view: VirtualCamera, points: Tensor, intrinsics: Tensor) -> Tensor:
    """Return the level ``(B,)`` of the pyramid that suits a virtual camera, 0 the finest."""
    # Off the axis a pinhole image is larger by one over the cosine of the angle.
    oblique = view.distance / points[:, 2].clamp_min(LEAST_DEPTH)
    ratio = intrinsics[0] / view.focal * oblique / SHARPNESS
    level = torch.floor(torch.log(ratio) / math.log(2))
    return level.clamp(0, PYRAMID_LEVELS - 1)
