"""Images seen by a camera that is rotated about its center: a homography of their pixels.

Coordinates are continuous pixels: the first pixel's center is at one half.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

LEAST_DEPTH = 1e-3
"""Least depth of a ray in the source camera's frame; other rays see nothing."""

FAR_OUTSIDE = -1e6


def pixel_centers(height: int, width: int) -> Tensor:
    """Return the centers ``(2, h, w)`` of an image's pixels, columns u and rows v."""
    u, v = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    return torch.stack([u.expand(height, width), v[:, None].expand(height, width)])


def source_planes(homographies: Tensor, plane: Tensor) -> tuple[Tensor, Tensor]:
    """Return the source coordinates u and v ``(V, h, w)`` of places ``(2, h, w)``.

    They are far outside for rays that the source camera cannot see. Planes, as runtimes compute on
    whole planes in vectors, and on pairs of coordinates one by one.
    """
    pixels = torch.cat((plane, torch.ones_like(plane[:1]))).flatten(1)  # (3, h w)
    x, y, depth = torch.unflatten(homographies @ pixels, 2, plane.shape[1:]).unbind(1)
    ahead, least = depth > LEAST_DEPTH, depth.clamp_min(LEAST_DEPTH)
    far = torch.full_like(depth, FAR_OUTSIDE)
    return torch.where(ahead, x / least, far), torch.where(ahead, y / least, far)


def sample_planes(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Sample images ``(B, C, H, W)`` at the coordinates ``u`` and ``v``, each ``(B, h, w)``.

    They are zero outside.
    """
    rows, columns = image.shape[-2:]
    grid = torch.stack((u * (2 / columns) - 1, v * (2 / rows) - 1), dim=-1)
    return F.grid_sample(image, grid.to(image.dtype), align_corners=False)
