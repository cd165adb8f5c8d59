"""PolarPose: pose by a first look at the frame, and equivariant second looks of spectral filters.

The first look is a heat map of the downsampled frame (`ffpose.models.heat_map`): its highest peaks
are candidates. A virtual camera is pointed at the highest (`ffpose.models.virtual_camera`), and its
view, sampled in polar coordinates about the viewing ray, gives attitude, offset, uncertainty and
whether the object is there (`ffpose.models.polar_second_look`). Where the next peak might still be
likelier, the camera is pointed there too, and the likelier of both looks is kept; where it cannot
be, which is nearly always, that look goes where the offset says that the object is. The last look
goes there too.

The error of a look depends on how the cells of its feature map happen to lie on the object. Each of
n looks is therefore rotated about the viewing ray by an n-th of a cell more than the one before,
and the attitude is the mean of those that agree with the last look: most of the error that depends
on the cells cancels. The position is the mean of the last two looks, the last of which has a view
for a greater distance, which shows the object larger. With ``looks`` 1 the pose is that of the
likeliest look alone.
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
from ffpose.errors import expect_shape
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

FARTHER = 1.05
"""Distance that the last look's view is made for, relative to where the one before found it."""

AGREEMENT_DEG = 15.0
"""Largest angle from the last look's attitude of those that count in the mean, degrees."""

ONE_LOOK_VARIANCE = 1.15
"""Variance of the attitude's error of one look relative to that of the mean of three.

It is 1.11 to 1.23 for `soyuz` and `dragon`, that of the position 0.93 to 1.10 (``python -m
benchmarks look soyuz --images 200``). Calibration scales the covariances of the mean, for the
numbers of looks and candidates in the header; `PolarPose.forward` scales them for no others."""

DISTANCE_SMOOTH = 0.05
"""Errors of the first look's log distance below it count by their square (Huber)."""


class PolarPose(BaseNetwork):
    """Pose network; `from_config` builds it, `from_pretrained` reads a file.

    It can be exported by `torch.export`, with any batch size if ``dynamic_shapes`` says so. Import
    `ffpose.models` before loading a saved program, to register its operators and result types.

    On a GPU leave float32 products as exact as torch has them by default. In TensorFloat-32
    (``torch.set_float32_matmul_precision("high")``) the geometry is rounded too, by which poses of
    `soyuz` move by 0.04° and 0.04 % of the distance in the median of six views, and by 0.07° and
    0.13 % at most (computed on a CPU, with numbers rounded as a GPU does).

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
        expect_shape("images", images, 3, *self.config.image_size)
        levels = pyramid(images)
        maps = self.locate(downsampled(levels, self.config.first_stride))
        points, log_masses = self.translation_branch.candidates(*maps, self.config.candidates)
        first, *others = zip(points.unbind(1), log_masses.unbind(1), strict=True)
        look, kept = self._second_look(levels, first[0]), first[1]
        score = _log_likelihood(kept, look)
        earlier = list[tuple[SecondLook, Tensor]]()  # looks, and where they are at what is kept
        for number, (point, log_mass) in enumerate(others, 1):
            # If the object were surely there, would that be likelier?
            rival = log_mass > score
            place = torch.where(rival[:, None], point, look.place)
            found = self._second_look(levels, place, number)
            weight = torch.where(rival, log_mass, kept)
            likelihood = _log_likelihood(weight, found)
            moved = rival & (likelihood > score)
            earlier = [(each, same & ~moved) for each, same in earlier] + [(look, ~rival)]
            taken = ~rival | moved
            look, kept = chosen(taken, found, look), torch.where(taken, weight, kept)
            score = torch.where(taken, likelihood, score)
        if self.config.looks == 1:
            return calibrated(self._pose(look), self.config)
        everywhere = torch.ones_like(score, dtype=torch.bool)
        for number in range(self.config.candidates, self.config.total_looks - 1):
            earlier.append((look, everywhere))
            look = self._second_look(levels, look.place, number)
        last = self._second_look(levels, FARTHER * look.place, self.config.total_looks - 1)
        looks, same = zip((look, everywhere), *earlier, strict=True)
        attitudes = list(zip(self._orientations(looks), same, strict=True))
        return calibrated(_mean(look.place, attitudes, self._pose(last)), self.config)

    @half_in_learned_parts
    def predict_near(self, images: Tensor, points: Tensor) -> UncertainPose:
        """Predict the poses of objects that are known to be near given points.

        One second look, without a first one and without a correction of where to look. Its offset
        is zero where the object is, and is divided by its slope there (``config.look_slope``),
        which is a step of Newton's. An attitude of `forward` is the mean of several looks, if
        ``looks`` is above 1, whose covariance calibration scales: that of one look is
        `ONE_LOOK_VARIANCE` times as large.

        Args:
            images: As in `forward`.
            points: ``(B, 3)``, meters, camera frame, in front of the camera.

        Raises:
            ValueError: The shape of ``images`` or ``points`` is not as above.
        """
        expect_shape("images", images, 3, *self.config.image_size)
        expect_shape("points", points, 3)
        output, view = self._look_at(pyramid(images), in_front(points))
        across, along = self.config.look_slope
        slopes = output.offset.new_tensor([across, across, along])
        pose = self._pose(placed(output._replace(offset=output.offset / slopes), view))
        if self.config.looks > 1:
            pose = pose._replace(rotation_covariance=pose.rotation_covariance * ONE_LOOK_VARIANCE)
        return calibrated(pose, self.config)

    def _second_look(self, levels: Sequence[Tensor], points: Tensor, number: int = 0) -> SecondLook:
        """Look at points ``(B, 3)``, turned as the look of a number, from 0, of `total_looks`."""
        cell = 2 * math.pi / self.config.object_grid[1]
        angle = number * cell / self.config.total_looks if self.config.looks > 1 else 0.0
        twist = points.new_full(points.shape[:1], angle) if angle else None
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

    def _orientations(self, looks: Sequence[SecondLook]) -> list[Tensor]:
        """Return the orientations ``(B, 4)`` of `_pose` alone, decoded together."""
        raw = torch.stack([look.output.orientation for look in looks])
        found = torch.unflatten(self.orientation.decode(raw.flatten(0, 1)), 0, (len(looks), -1))
        return [look.view.turned_back(q) for look, q in zip(looks, found.unbind(), strict=True)]

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


def _mean(
    translation: Tensor, looks: Sequence[tuple[Tensor, Tensor]], last: UncertainPose
) -> UncertainPose:
    """Return the last look's pose, with the mean attitude of those that agree with it.

    Its position is the mean with that of the look before, where their attitudes agree.

    The mean of unit quaternions that stand for nearly the same rotation, with the signs that bring
    them next to each other, is their normalized sum: of two exactly, of more up to the cubes of the
    angles between them (Markley et al., "Averaging Quaternions", Journal of Guidance, Control, and
    Dynamics 30(4), 2007).

    Args:
        translation: ``(B, 3)``, of the look before the last.
        looks: Orientations ``(B, 4)``, that of this look first, each with where it is of the same
            object as the last one, ``(B,)`` bool.
        last: Poses of the last look.
    """
    total, least = last.orientation, math.cos(math.radians(AGREEMENT_DEG) / 2)
    near = list[Tensor]()
    for orientation, same in looks:
        cosine = (orientation * last.orientation).sum(-1, keepdim=True)  # of half the angle
        near.append((cosine.abs() > least) & same[:, None])
        signed = torch.where(cosine < 0, -orientation, orientation)
        total = total + torch.where(near[-1], signed, torch.zeros_like(signed))
    middle = (translation + last.translation) / 2
    return last._replace(
        translation=torch.where(near[0], middle, last.translation),
        orientation=F.normalize(total, dim=-1),
    )


def _log_likelihood(log_mass: Tensor, look: SecondLook) -> Tensor:
    """Return the logs ``(B,)`` of how likely candidates of a first look are after a look at them.

    Not logsigmoid: in graphs that is a sigmoid's, which runtimes clamp at 18.
    """
    return log_mass - F.softplus(-look.output.in_view)
