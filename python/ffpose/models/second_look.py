"""Outputs of the second look: orientation, refined position, and their uncertainty.

Ye et al. decouple translation and orientation by two branches that read the same image; here their
views are decoupled as well. The orientation branch reads the view of a virtual camera pointed at
the object (`ffpose.models.virtual_camera`) and predicts, in that camera's frame,

* the orientation (`ffpose.nn.polar_bins`);
* the offset of the object from the point that the camera was pointed at: ``(x / z, y / z)`` in
  quarters of the view's width, and the log of the ratio of the distances, times four;
* the log standard deviations of the offset and of the rotation vector (Kendall and Gal, "What
  Uncertainties Do We Need in Bayesian Deep Learning for Computer Vision?", NeurIPS 2017), and how
  they differ by direction across the viewing ray;
* the logit of the object being in view.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple, TypeVar, cast

import torch
from torch import Tensor, nn

from ffpose._internal.torch_internals import constant
from ffpose.config import PolarPoseConfig
from ffpose.models.base import UncertainPose
from ffpose.models.virtual_camera import VirtualCamera

OFFSET_SCALE = 4.0
OFFSET_LIMIT = 4.0
"""Bound on the offset; across the ray 2 is half of the view's width, along it 4 is a factor e."""

LOG_SIGMA_LIMITS = (-6.0, 1.5)
"""Bounds on the log standard deviations, beyond which float32 covariances lose precision."""

Predict = TypeVar("Predict", bound=Callable[..., UncertainPose])

TAIL = 4.0
"""Degrees of freedom of the errors' t distribution in training."""


class SecondLookOutput(NamedTuple):
    """Outputs of the second look for a batch of views.

    Attributes:
        orientation: ``(B, features)``, outputs for the orientation head.
        offset: ``(B, 3)``, offset of the object.
        log_sigma: ``(B, 6)``, log standard deviations of offset and rotation vector (radians).
        in_view: ``(B,)``, logits of the object being in view.
        shear: ``(B, 4)``, of offset and rotation vector the logs ``(a, b)`` by which deviations
            across the ray differ by direction (`covariance_of`).
    """

    orientation: Tensor
    offset: Tensor
    log_sigma: Tensor
    in_view: Tensor
    shear: Tensor

    def of(self, rows: Tensor) -> SecondLookOutput:
        """Return the output of some views, ``rows`` being indices or a mask."""
        return SecondLookOutput(*(part[rows] for part in self))

    def float(self) -> SecondLookOutput:
        """Return the output in float32."""
        return SecondLookOutput(*map(Tensor.float, self))


def half_in_learned_parts(predict: Predict) -> Predict:
    """Let ``torch.autocast`` change `locate`, `encode` and `decode` alone, not the geometry.

    In bfloat16 a pose would be off by degrees; ``predict`` takes float32 images and gives float32.
    """

    @wraps(predict)
    def exact(self: nn.Module, images: Tensor, *args: Any, **named: Any) -> UncertainPose:
        kind = images.device.type
        if not torch.is_autocast_enabled(kind):
            return predict(self, images, *args, **named)
        network = copy.copy(self)  # which shares all weights
        half = torch.autocast(kind, torch.get_autocast_dtype(kind))
        for name in ("locate", "encode", "decode"):
            setattr(network, name, _in_float(half(getattr(self, name))))
        with torch.autocast(kind, enabled=False):
            return predict(network, images.float(), *args, **named)

    return cast("Predict", exact)


def _in_float(part: Callable[..., Any]) -> Callable[..., Any]:
    def called(*args: Any) -> Any:
        found = part(*args)
        is_pair = type(found) is tuple
        return tuple(each.float() for each in found) if is_pair else found.float()

    return called


def offset_of(points: Tensor, view: VirtualCamera) -> Tensor:
    """Return the offsets ``(B, 3)`` of points ``(B, 3)`` in a virtual camera's frame."""
    scale = OFFSET_SCALE * view.focal / view.width
    across = points[:, :2] / points[:, 2:] * scale[:, None]
    ratio = points.norm(dim=-1, keepdim=True) / view.distance[:, None]
    return torch.cat((across, OFFSET_SCALE * ratio.log()), dim=1)


def points_at(offset: Tensor, view: VirtualCamera) -> Tensor:
    """Return the points ``(B, 3)`` of offsets in a virtual camera's frame; inverts `offset_of`.

    Offsets across and along the ray are shortened to `OFFSET_LIMIT`, beyond which the object is out
    of view.
    """
    across, along = offset[:, :2], offset[:, 2:]
    length = across.norm(dim=1, keepdim=True)
    shortened = across * (OFFSET_LIMIT / length.clamp_min(OFFSET_LIMIT))
    tangents = shortened * _tangent_of_one(view)
    rays = torch.cat((tangents, torch.ones_like(length)), dim=1)
    along = along.clamp(-OFFSET_LIMIT, OFFSET_LIMIT) / OFFSET_SCALE
    points: Tensor = rays * (view.distance[:, None] * along.exp() / rays.norm(dim=1, keepdim=True))
    return points


def offset_jacobian(point: Tensor, view: VirtualCamera) -> Tensor:
    """Return the derivatives ``(B, 3, 3)`` of `points_at` with respect to the offset.

    They are those at the offset whose point is ``point (B, 3)``.
    """
    distance = point.norm(dim=1, keepdim=True)
    ray = point / distance  # (B, 3)
    # Meters per unit of the offset, as the ray is normalized again.
    slope = distance * ray[:, 2:] * _tangent_of_one(view)
    unit = torch.eye(3, 2, dtype=ray.dtype, device=ray.device)
    across = unit - ray[:, :, None] * ray[:, None, :2]
    return torch.cat((across * slope[:, None], point[:, :, None] / OFFSET_SCALE), dim=2)


def _tangent_of_one(view: VirtualCamera) -> Tensor:
    """Return the tangents ``(B, 1)`` of an offset of one across the ray."""
    return (view.width / OFFSET_SCALE / view.focal)[:, None]


def covariances(look: SecondLook) -> tuple[Tensor, Tensor]:
    """Return the covariances of translation and rotation, ``(B, 3, 3)`` each, camera frame."""
    output, view = look.output, look.view
    log_sigma = torch.unflatten(output.log_sigma, 1, (2, 3))
    shear = torch.unflatten(output.shear, 1, (2, 2))
    offset, rotation = covariance_of(log_sigma, shear).unbind(1)
    back = view.rotation.mT
    to_camera = back @ offset_jacobian(look.point, view)
    return to_camera @ offset @ to_camera.mT, back @ rotation @ view.rotation


def covariance_of(log_sigma: Tensor, shear: Tensor) -> Tensor:
    """Return the covariances ``(..., 3, 3)`` of log standard deviations, virtual camera's frame.

    The block across the ray is the variance of the first two deviations, which are equal, times
    ``exp 2 [[a, b], [b, -a]]`` of a shear ``(a, b)`` ``(..., 2)``, which has the determinant one. A
    rotation of the camera by ``w`` about the ray rotates ``(a, b)`` by ``2 w``: it is a second
    harmonic.
    """
    variance = (2 * log_sigma).exp()
    length = 2 * shear.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    parts = (length.cosh(), 2 * shear * (length.sinh() / length), torch.ones_like(length))
    blocks = torch.cat(parts, dim=-1) @ BLOCKS.to(length, non_blocking=True)
    return torch.unflatten(blocks, -1, (3, 3)) * variance[..., None]


BLOCKS = constant(
    [
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)
"""From ``(m, a, b, 1)`` to the rows of ``[[m + a, b, 0], [b, m - a, 0], [0, 0, 1]]``."""


def in_front(points: Tensor) -> Tensor:
    """Clamp z of points ``(B, 3)`` to at least a tenth of their distance."""
    least = points.norm(dim=-1, keepdim=True) / 10
    return torch.cat((points[:, :2], torch.maximum(points[:, 2:], least)), dim=1)


class SecondLook(NamedTuple):
    """Second looks of a batch, and where they found the object.

    Attributes:
        output: What the network says of the view.
        view: The virtual cameras.
        point: ``(B, 3)``, the object's origin, virtual camera's frame, meters.
        place: ``(B, 3)``, the same in the camera's frame, and in front of it.
    """

    output: SecondLookOutput
    view: VirtualCamera
    point: Tensor
    place: Tensor


def placed(output: SecondLookOutput, view: VirtualCamera) -> SecondLook:
    """Return the looks with the places that their offsets mean."""
    point = points_at(output.offset, view)
    return SecondLook(output, view, point, in_front(view.points_back(point)))


def calibrated(pose: UncertainPose, config: PolarPoseConfig) -> UncertainPose:
    """Apply what calibration found: factors on distances, and the growth of the uncertainty."""
    pose = pose._replace(translation=pose.translation * config.distance_scale)
    found = (*config.doubt_sigma, *config.truncation_sigma, config.truncation_distance)
    if not any(found):
        return pose
    doubt, cut = 1 - pose.probabilities[:, 0], truncation(pose.translation, config)
    translation, rotation = (growth.square()[:, None, None] for growth in config.growth(doubt, cut))
    nearer = torch.exp(-config.truncation_distance * cut.square())
    return pose._replace(
        translation=pose.translation * nearer[:, None],
        translation_covariance=pose.translation_covariance * translation,
        rotation_covariance=pose.rotation_covariance * rotation,
    )


def truncation(translation: Tensor, config: PolarPoseConfig) -> Tensor:
    """Return the shares ``(B,)`` of objects' views that the border of the frame cuts off, 0 to 1.

    Of the area of the square about the view, through the object's origin ``(B, 3)``, meters.
    """
    assert config.camera is not None
    (fx, fy, cx, cy), (height, width) = config.camera, config.image_size
    x, y, z = translation.unbind(1)
    radius, seen = config.object_radius_m, torch.ones_like(z)
    # Distances from the planes through the camera and the sides of the frame, along the image.
    for place, focal, center, side in ((x, fx, cx, width), (y, fy, cy, height)):
        before, after = place + z * (center / focal), z * ((side - center) / focal) - place
        inside = before.clamp(-radius, radius) + after.clamp(-radius, radius)
        seen = seen * (inside / (2 * radius)).clamp_min(0)
    return 1 - seen


def sigma_loss(output: SecondLookOutput, residual: Tensor) -> Tensor:
    """Return the negative log likelihood ``(B,)`` of residuals ``(B, 6)``, a sixth of it.

    The offset and the rotation vector have a multivariate t distribution each, of `TAIL`
    degrees of freedom: errors are now and then far larger than usual, and a Gaussian's scale would
    follow those (Lange, Little and Taylor, "Robust Statistical Modeling Using the t Distribution",
    JASA 1989).
    """
    scaled = torch.unflatten(residual * torch.exp(-output.log_sigma), 1, (2, 3))
    # The inverse of `covariance_of` is that of the negative shear, and of variances of one.
    halves = torch.unflatten(-output.shear / 2, 1, (2, 2))
    root = covariance_of(torch.zeros_like(scaled), halves)
    scaled = (root @ scaled[..., None])[..., 0]
    far = (TAIL + 3) / 2 * torch.log1p(scaled.square().sum(-1) / TAIL)
    return (far.sum(-1) + output.log_sigma.sum(-1)) / 6
