"""Outputs of the second look: orientation, refined position, and their uncertainty.

Ye et al. decouple translation and orientation by two branches that read the same image; here their
views are decoupled as well. The orientation branch reads the view of a virtual camera pointed at
the object (`ffpose.models.virtual_camera`) and predicts, in that camera's frame,

* the orientation, by one of the heads of `ffpose.nn.orientation`;
* the offset of the object from the point that the camera was pointed at: ``(x / z, y / z)`` in
  quarters of the image's width, and the log of the ratio of the distances, times four;
* the log standard deviations of the offset and of the rotation vector (Kendall and Gal, "What
  Uncertainties Do We Need in Bayesian Deep Learning for Computer Vision?", NeurIPS 2017);
* the logit of the object being in view.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.models.virtual_camera import LEAST_DEPTH, VirtualCamera, toward

OFFSET_SCALE = 4.0
OFFSET_LIMIT = 4.0
"""Bound on the offset; 2 is half of the image's width, and 4 is a factor e of the distance."""

LOG_SIGMA_LIMITS = (-6.0, 1.5)
"""Bounds on the log standard deviations, beyond which float32 covariances lose precision."""

SMALL_NUMBERS = 3 + 6 + 1
"""Number of outputs besides the orientation's: offset, log standard deviations, logit."""


DISK_POINTS = 256
"""Number of points for which the share of the object outside of the frame is counted."""

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
"""Angle between successive points, with which they cover a disk evenly (Vogel, "A better way to
construct the sunflower head", Mathematical Biosciences, 1979)."""


class LookNumbers(NamedTuple):
    """Outputs of the second look for a batch of views.

    Attributes:
        orientation: ``(B, features)``, outputs for the orientation head.
        offset: ``(B, 3)``, offset of the object.
        log_sigma: ``(B, 6)``, log standard deviations of the offset and of the rotation vector
            (radians).
        in_view: ``(B,)``, logits of the object being in view.
    """

    orientation: Tensor
    offset: Tensor
    log_sigma: Tensor
    in_view: Tensor


class LookHead(nn.Module):
    """Head that computes the outputs of the second look from a latent vector.

    Args:
        orientation: Module from the latent vector to the orientation head's inputs.
        small: Module from the latent vector to the other `SMALL_NUMBERS` outputs.
    """

    def __init__(self, orientation: nn.Module, small: nn.Module) -> None:
        super().__init__()
        self.orientation, self.small = orientation, small

    def forward(self, z: Tensor) -> Tensor:
        """Return ``(B, SMALL_NUMBERS + features)`` for a latent vector ``z``."""
        return torch.cat((self.small(z), self.orientation(z)), dim=1)


def split_numbers(numbers: Tensor) -> LookNumbers:
    """Split the output ``(B, SMALL_NUMBERS + features)`` of `LookHead` into named parts."""
    return LookNumbers(
        orientation=numbers[:, SMALL_NUMBERS:],
        offset=numbers[:, :3],
        log_sigma=numbers[:, 3:9].clamp(*LOG_SIGMA_LIMITS),
        in_view=numbers[:, 9],
    )


def offset_of(points: Tensor, view: VirtualCamera) -> Tensor:
    """Return the offsets ``(B, 3)`` of points ``(B, 3)`` in a virtual camera's frame."""
    x, y, z = points.unbind(-1)
    pixels = view.focal * OFFSET_SCALE
    ratio = points.norm(dim=-1) / view.distance
    return torch.stack(
        [x / z * pixels / view.size[1], y / z * pixels / view.size[0], OFFSET_SCALE * ratio.log()],
        dim=-1,
    )


def points_at(offset: Tensor, view: VirtualCamera) -> Tensor:
    """Return the points ``(B, 3)`` of offsets in a virtual camera's frame; inverts `offset_of`.

    Offsets are clamped to `OFFSET_LIMIT`, beyond which the object is out of view.
    """
    bounded = offset.clamp(-OFFSET_LIMIT, OFFSET_LIMIT)
    pixels = view.focal * OFFSET_SCALE
    rays = torch.stack(
        [
            bounded[:, 0] * view.size[1] / pixels,
            bounded[:, 1] * view.size[0] / pixels,
            torch.ones_like(pixels),
        ],
        dim=-1,
    )
    distance = view.distance * torch.exp(bounded[:, 2] / OFFSET_SCALE)
    return F.normalize(rays, dim=-1) * distance[:, None]


def offset_jacobian(offset: Tensor, view: VirtualCamera) -> Tensor:
    """Return the derivatives ``(B, 3, 3)`` of `points_at` with respect to the offset."""
    point = points_at(offset, view)
    distance = point.norm(dim=-1, keepdim=True)
    ray = point / distance  # (B, 3)
    slope = distance * ray[:, 2:]  # meters per unit of x / z, before the ray is normalized again
    pixels = (view.focal * OFFSET_SCALE)[:, None]
    columns = []
    for axis, side in enumerate((view.size[1], view.size[0])):
        unit = F.one_hot(torch.tensor(axis, device=ray.device), 3).to(ray.dtype)
        across = unit - ray * ray[:, axis : axis + 1]
        columns.append(slope * across * side / pixels)
    columns.append(point / OFFSET_SCALE)
    return torch.stack(columns, dim=-1)


def rotation_vector(difference: Tensor) -> Tensor:
    """Convert unit quaternions ``(B, 4)`` to rotation vectors ``(B, 3)``, radians."""
    q = torch.where(difference[:, :1] < 0, -difference, difference)
    sine = q[:, 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, q[:, :1])
    return q[:, 1:] * torch.where(sine > 1e-6, angle / sine.clamp_min(1e-6), 2.0)


def rotation_between(q_from: Tensor, q_to: Tensor) -> Tensor:
    """Return the rotations ``q_to conj(q_from)`` of unit quaternions ``(B, 4)``."""
    a, v = q_to[:, :1], q_to[:, 1:]
    b, u = q_from[:, :1], -q_from[:, 1:]
    scalar = a * b - (v * u).sum(-1, keepdim=True)
    return torch.cat((scalar, a * u + b * v + torch.linalg.cross(v, u)), dim=1)


def covariances(numbers: LookNumbers, view: VirtualCamera) -> tuple[Tensor, Tensor]:
    """Return the covariances of translation and rotation, ``(B, 3, 3)`` each, camera frame.

    Args:
        numbers: Outputs of the second look.
        view: The virtual camera.
    """
    variance = (2 * numbers.log_sigma).exp()  # (B, 6)
    back = view.rotation.transpose(1, 2)
    to_camera = back @ offset_jacobian(numbers.offset, view)
    translation = (to_camera * variance[:, None, :3]) @ to_camera.transpose(1, 2)
    rotation = (back * variance[:, None, 3:]) @ view.rotation
    return translation, rotation


def total_covariance(covariance: Tensor, deviation: Tensor) -> Tensor:
    """Return the covariance ``(B, 3, 3)`` of a mean over V views, by the law of total variance.

    It is the mean of the views' covariances plus the covariance of what they predict: views that
    disagree are as uncertain as their disagreement, whatever each says of itself.

    Args:
        covariance: ``(B, V, 3, 3)``, what each view predicts.
        deviation: ``(B, V, 3)``, deviation of each view's prediction from the mean.
    """
    return covariance.mean(1) + deviation.transpose(1, 2) @ deviation / deviation.shape[1]


def hidden_share(
    points: Tensor, radius_m: float, intrinsics: Tensor, size: tuple[int, int]
) -> Tensor:
    """Return the share ``(B,)`` of a disk about each point that the frame does not show.

    The disk faces the camera; `DISK_POINTS` spread over it are projected.

    Args:
        points: Centers ``(B, 3)``, meters, camera frame, not behind the camera.
        radius_m: Radius of the disk.
        intrinsics: ``(4,)``, fx, fy, cx, cy of the frame.
        size: ``(height, width)`` of the frame in pixels.
    """
    number = torch.arange(DISK_POINTS, dtype=points.dtype, device=points.device) + 0.5
    radius, angle = radius_m * (number / DISK_POINTS).sqrt(), number * GOLDEN_ANGLE
    disk = torch.stack([radius * angle.cos(), radius * angle.sin(), torch.zeros_like(radius)])
    x, y, z = (toward(points) @ disk + points[:, :, None]).unbind(1)  # (B, DISK_POINTS)
    fx, fy, cx, cy = intrinsics.unbind(-1)
    depth = z.clamp_min(LEAST_DEPTH)
    u, v = x / depth * fx + cx, y / depth * fy + cy
    seen = (z > LEAST_DEPTH) & (u > 0) & (u < size[1]) & (v > 0) & (v < size[0])
    return 1 - seen.to(points.dtype).mean(1)


def sigma_loss(log_sigma: Tensor, residual: Tensor) -> Tensor:
    """Return the Gaussian negative log likelihood of residuals, averaged over the last axis."""
    return (0.5 * (residual * torch.exp(-log_sigma)).square() + log_sigma).mean(-1)
