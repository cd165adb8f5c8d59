"""PolarPose: pose by a first look at the frame, and equivariant second looks of spectral filters.

The first look is a heat map of the downsampled frame (`ffpose.models.heat_map`): its highest peaks
are candidates. A virtual camera is pointed at the highest (`ffpose.models.virtual_camera`), and its
view, sampled in polar coordinates about the viewing ray, gives attitude, offset, uncertainty and
whether the object is there (`ffpose.models.polar_second_look`). Where the next peak might still be
likelier, that is looked at too, and the likelier of both is kept; where it cannot be, which is
nearly always, that look is spent where the offset says that the object is. A last look goes there.

A look errs by how its cells happen to lie on the object. The last look is therefore turned by half
a cell about the viewing ray, in a view made for a greater distance, which shows the object larger;
where it agrees with the one before, their mean is the pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.config import PolarPoseConfig
from ffpose.models.backbone import Backbone, build_backbone
from ffpose.models.base import BaseNetwork, UncertainPose
from ffpose.models.heat_map import HeatMap
from ffpose.models.polar_second_look import PolarBackbone, PolarHead, map_angles
from ffpose.models.second_look import (
    SecondLook,
    SecondLookOutput,
    calibrated,
    covariances,
    half_in_learned_parts,
    in_front,
    placed,
)
from ffpose.models.virtual_camera import (
    VirtualCamera,
    chosen,
    downsampled,
    pyramid,
    render_virtual,
    turn_to,
)
from ffpose.nn.polar_bins import PolarBinsHead

FARTHER = 1.1
"""Distance that the last look's view is made for, relative to where the one before found it."""

AGREEMENT_DEG = 15.0
"""Largest angle between the attitudes of two looks whose mean is the pose, degrees."""

ONE_LOOK_VARIANCE = 1.15
"""Variance of one look's errors relative to that of the mean of two, which calibration scales.

Of `soyuz`, whose errors of two such looks correlate by 0.74: ``2 / (1 + 0.74)``. Covariances
are calibrated for the numbers of looks and candidates in the header: `PolarPose.forward` does not
scale them for others."""

DISTANCE_SMOOTH = 0.05
"""Errors of the first look's log distance below it count by their square (Huber)."""


class PolarPose(BaseNetwork):
    """Pose network; `from_config` builds it, `from_pretrained` reads a file.

    It can be exported by `torch.export`, with any batch size if ``dynamic_shapes`` says so. Import
    `ffpose.models` before loading a saved program, to register its operators and result types.

    Args:
        config: Architecture of the network.
        backbone: Backbone of the first look, with one feature map of stride
            ``config.first_reduction``.

    Attributes:
        translation_branch: Heat map of the first look.
        object_backbone: Backbone of the second look.
        orientation_branch: Head of the second look.
        orientation: Orientation head.
    """

    config_type: ClassVar[type[PolarPoseConfig]] = PolarPoseConfig

    config: PolarPoseConfig
    orientation: PolarBinsHead
    intrinsics: Tensor
    variance_scales: Tensor

    def __init__(self, config: PolarPoseConfig, backbone: Backbone) -> None:
        super().__init__(config)
        self.backbone = backbone
        self.translation_branch = HeatMap(config, backbone.channels[0])
        self.object_backbone = PolarBackbone(config)
        self.orientation_branch = PolarHead(config)
        self.orientation = PolarBinsHead(
            config.latent,
            map_angles(config),
            config.angles,
            config.directions,
            config.bins_width_deg,
        )
        self.register_buffer("intrinsics", torch.tensor(config.camera), persistent=False)
        self.register_buffer("variance_scales", torch.ones(2))

    @half_in_learned_parts
    def forward(self, images: Tensor) -> UncertainPose:
        """Predict the pose of the object in each image, as `BaseNetwork.forward`."""
        self.check_images(images)
        levels = pyramid(images)
        maps = self.locate(downsampled(levels, self.config.first_stride))
        points, log_masses = self.translation_branch.candidates(*maps, self.config.candidates)
        first, *others = zip(points.unbind(1), log_masses.unbind(1), strict=True)
        look, kept = self._second_look(levels, first[0]), first[1]
        score = _log_likelihood(kept, look)
        for point, log_mass in others:
            # If the object were surely there, would that be likelier?
            rival = log_mass > score
            found = self._second_look(levels, torch.where(rival[:, None], point, look.place))
            weight = torch.where(rival, log_mass, kept)
            likelihood = _log_likelihood(weight, found)
            taken = ~rival | (likelihood > score)
            look, kept = chosen(taken, found, look), torch.where(taken, weight, kept)
            score = torch.where(taken, likelihood, score)
        if self.config.looks == 1:
            return calibrated(self._pose(look), self.config)
        for _ in range(2, self.config.looks):
            look = self._second_look(levels, look.place)
        pose = self._pose(self._second_look(levels, look.place, turned=True))
        return calibrated(_mean(look.place, self._orientation(look), pose), self.config)

    @half_in_learned_parts
    def predict_near(self, images: Tensor, points: Tensor) -> UncertainPose:
        """Predict the poses of objects that are known to be near given points.

        One second look, without a first one and without a correction of where to look. Its offset
        is zero where the object is, and is divided by its slope there (``config.look_slope``),
        which is a step of Newton's. A pose of `forward` is the mean of two looks, if ``looks`` is
        above 1, whose covariance calibration scales: that of one look is `ONE_LOOK_VARIANCE` times
        as large.

        Args:
            images: As in `forward`.
            points: ``(B, 3)``, meters, camera frame, in front of the camera.

        Raises:
            ValueError: The shape of ``images`` is not as above.
        """
        self.check_images(images)
        output, view = self._look_at(pyramid(images), in_front(points))
        across, along = self.config.look_slope
        slopes = output.offset.new_tensor([across, across, along])
        pose = self._pose(placed(output._replace(offset=output.offset / slopes), view))
        if self.config.looks > 1:
            pose = pose._replace(
                translation_covariance=pose.translation_covariance * ONE_LOOK_VARIANCE,
                rotation_covariance=pose.rotation_covariance * ONE_LOOK_VARIANCE,
            )
        return calibrated(pose, self.config)

    def _second_look(
        self, levels: Sequence[Tensor], points: Tensor, *, turned: bool = False
    ) -> SecondLook:
        """Look at points ``(B, 3)``; ``turned`` by half a cell, in a view for a longer distance."""
        twist = None
        if turned:
            points = FARTHER * points
            twist = points.new_full(points.shape[:1], math.pi / self.config.object_grid[1])
        return placed(*self._look_at(levels, points, twist))

    def _look_at(
        self, levels: Sequence[Tensor], points: Tensor, twist: Tensor | None = None
    ) -> tuple[SecondLookOutput, VirtualCamera]:
        view = self.view_at(points, twist)
        crops = render_virtual(levels, view, points, self.intrinsics)
        return self.decode(self.encode(crops, view.tan_half_angle)), view

    def _pose(self, look: SecondLook) -> UncertainPose:
        """Return the poses that second looks found, in the camera's frame."""
        modes = self.orientation.modes(look.output.orientation)
        translation, rotation = covariances(look)
        return UncertainPose(
            look.place,
            look.view.turned_back(modes.orientation),
            translation * self.variance_scales[0],
            rotation * self.variance_scales[1],
            look.output.in_view.sigmoid(),
            look.view.turned_back(modes.alternative),
            modes.probabilities,
        )

    def _orientation(self, look: SecondLook) -> Tensor:
        """Return the orientations ``(B, 4)`` of `_pose` alone."""
        return look.view.turned_back(self.orientation.decode(look.output.orientation))

    def view_at(self, points: Tensor, twist: Tensor | None = None) -> VirtualCamera:
        """Return the virtual cameras of second looks at points, as `virtual_camera.turn_to`."""
        c = self.config
        return turn_to(points, c.object_radius_m, c.object_size, c.object_width, twist)

    def locate(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Compute heat map and distances, as `HeatMap.forward`, of downsampled frames."""
        maps = self.backbone(frames)
        logits, distances = self.translation_branch(maps[0])
        return logits, distances

    def first_loss(self, frames: Tensor, translation: Tensor) -> Tensor:
        """Return the loss of the first look at ``frames (B, 3, h, w)`` of objects at ``(B, 3)``."""
        logits, distances = self.locate(frames)
        with torch.autocast(frames.device.type, enabled=False):
            return self.translation_branch.loss(
                logits.float(), distances.float(), translation, DISTANCE_SMOOTH
            )

    def encode(self, views: Tensor, tan_half_angle: Tensor) -> Tensor:
        """Compute the feature map of polar views, as `PolarBackbone.forward`."""
        feature_map: Tensor = self.object_backbone(views, tan_half_angle)
        return feature_map

    def decode(self, feature_map: Tensor) -> SecondLookOutput:
        """Compute the second look's outputs for its feature map."""
        output: SecondLookOutput = self.orientation_branch(feature_map)
        return output

    @classmethod
    def build(cls, config: PolarPoseConfig, backbone_weights: str | Path) -> Self:
        """Build a network with new weights."""
        return cls(
            config, build_backbone(config.backbone, (config.first_reduction,), backbone_weights)
        )


class NearPoint(nn.Module):
    """`PolarPose.predict_near` as a module's forward."""

    def __init__(self, network: PolarPose) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor, point: Tensor) -> UncertainPose:
        """Predict poses of objects near points, as `PolarPose.predict_near`."""
        return self.network.predict_near(images, point)


def _mean(translation: Tensor, orientation: Tensor, other: UncertainPose) -> UncertainPose:
    """Return the mean pose of two looks where they agree, elsewhere the other's; all else is its.

    The mean of two unit quaternions that stand for nearly the same rotation, one or the negative of
    one and the other, normalized, is half the rotation between them (Markley et al., "Averaging
    Quaternions", Journal of Guidance, Control, and Dynamics 30(4), 2007).
    """
    cosine = (orientation * other.orientation).sum(-1, keepdim=True)  # of half the angle
    same = torch.where(cosine < 0, -orientation, orientation)
    agree = cosine.abs() > math.cos(math.radians(AGREEMENT_DEG) / 2)
    orientation = F.normalize(same + other.orientation, dim=-1)
    middle = (translation + other.translation) / 2
    return other._replace(
        translation=torch.where(agree, middle, other.translation),
        orientation=torch.where(agree, orientation, other.orientation),
    )


def _log_likelihood(log_mass: Tensor, look: SecondLook) -> Tensor:
    """Return the logs ``(B,)`` of how likely candidates of a first look are after a look at them.

    Not logsigmoid: in graphs that is a sigmoid's, which runtimes clamp at 18.
    """
    return log_mass - F.softplus(-look.output.in_view)
