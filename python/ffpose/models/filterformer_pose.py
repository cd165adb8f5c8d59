"""FilterformerPose: regression of a satellite's pose from one image.

Ye et al., Sensors 2023, 23, 8633, section 3 and Figure 3. A convolutional backbone computes two
feature maps, each the input of a branch (1 x 1 convolution, tokens, filterformer, hypernetwork
head). The coarser one gives the translation, the finer one the orientation, a quaternion that a
quaternion activation normalizes. The fields of `FilterformerPoseConfig` say what the paper leaves
open, and how it is read here.

Beyond the paper, the translation may be standardized by mean and standard deviation of the training
set, and the last bias of the orientation head is initialized to the identity quaternion, so that
the norm to divide by is not close to zero at first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose.config import FLAT_CHANNELS, FLAT_LATENT, FilterformerPoseConfig
from ffpose.models.backbone import Backbone, build_backbone
from ffpose.models.base import FrameNetwork, PosePrediction, UncertainPose
from ffpose.models.second_look import (
    SMALL_OUTPUTS,
    SecondLookHead,
    SecondLookOutput,
    calibrated,
    covariances,
    half_in_learned_parts,
    placed,
    split_output,
)
from ffpose.models.virtual_camera import (
    VirtualCamera,
    downsampled,
    pyramid,
    render_virtual,
    turn_to,
)
from ffpose.nn import Filterformer, HyperHead, PositionCode
from ffpose.nn.orientation import (
    BinsHead,
    OrientationHead,
    QuaternionHead,
    SixNumbersHead,
)

TOKEN_STD = 0.02

LOCATION_SMOOTH = 0.05
"""Errors of the first look below it count by their square (Huber)."""


class PoseBranch(nn.Module):
    """Branch from a feature map to its outputs: projection, tokens, filterformer, head."""

    def __init__(
        self,
        config: FilterformerPoseConfig,
        channels: int,
        grid: tuple[int, int],
        head: nn.Module,
    ) -> None:
        super().__init__()
        self.projection = nn.Conv2d(channels, config.dim, kernel_size=1)
        self.position = PositionCode(grid, config.dim, config.position)
        self.pose_token = self.encoder = self.flatten = None
        extra = 1 if config.pooling == "token" else 0
        if extra:
            self.pose_token = nn.Parameter(torch.randn(1, 1, config.dim) * TOKEN_STD)
        if config.depth > 0:
            self.encoder = Filterformer(
                grid,
                config.dim,
                depth=config.depth,
                filter=config.filter,
                filter_std=config.filter_std,
                heads=config.heads,
                hidden=config.feed_forward,
                dropout=config.dropout,
                norm=config.norm,
                extra_tokens=extra,
                outputs=extra or None,
            )
        if config.pooling == "flatten":
            self.flatten = nn.Sequential(
                nn.Linear(config.dim, FLAT_CHANNELS),
                nn.ReLU(),
                nn.Flatten(),
                nn.Linear(FLAT_CHANNELS * grid[0] * grid[1], FLAT_LATENT),
                nn.ReLU(),
            )
        self.head = head

    def forward(self, features: Tensor) -> Tensor:
        """Map features ``(B, channels, rows, columns)`` to outputs ``(B, out_features)``."""
        tokens = self.projection(features).flatten(2).transpose(1, 2)  # (B, rows * columns, dim)
        tokens = self.position(tokens)
        if self.pose_token is not None:
            token = self.pose_token.expand(tokens.shape[0], -1, -1)
            tokens = torch.cat((token, tokens), dim=1)  # (B, 1 + rows * columns, dim)
        if self.encoder is not None:
            tokens = self.encoder(tokens)
        result: Tensor = self.head(self._latent(tokens))
        return result

    def _latent(self, tokens: Tensor) -> Tensor:
        """Pool tokens to the latent vector, ``(B, dim)`` or ``(B, FLAT_LATENT)``."""
        if self.pose_token is not None:
            return tokens[:, 0]
        if self.flatten is None:
            return tokens.mean(1)
        latent: Tensor = self.flatten(tokens)
        return latent


def hyper_head(config: FilterformerPoseConfig, out_features: int, mlp_dim: int) -> HyperHead:
    """Build a hypernetwork head on a branch's latent vector."""
    return HyperHead(config.latent, out_features, hidden=config.head_hidden, mlp_dim=mlp_dim)


def build_orientation_head(config: FilterformerPoseConfig) -> OrientationHead:
    """Build the orientation head that ``config.orientation_head`` names."""
    match config.orientation_head:
        case "quaternion":
            return QuaternionHead()
        case "6d":
            return SixNumbersHead()
        case _:
            return BinsHead(config.bins, config.bins_degree, config.bins_width_deg)


class FilterformerPose(FrameNetwork):
    """Pose network; `from_config` builds it with its backbones, `from_pretrained` reads a file.

    With ``config.orientation_view`` ``"frame"``, as in the paper, both branches see the frame and
    the result is a `PosePrediction`. With ``"object"`` the translation branch sees the downsampled
    frame, the orientation branch a virtual camera's view of the object
    (`ffpose.models.second_look`), and the result is an `UncertainPose`.

    It can be exported by `torch.export`, with any batch size if ``dynamic_shapes`` says so. Import
    `ffpose.models` before loading a saved program, to register its operators and result types.

    Args:
        config: Architecture of the network.
        backbone: Backbone with feature maps of stride ``config.translation_reduction`` and, for
            view ``"frame"``, ``config.orientation_reduction``, in this order; frozen in stages 2
            and 3 of training.
        object_backbone: Backbone of the second look with a feature map of stride
            ``config.orientation_reduction``; for view ``"object"`` alone.

    Raises:
        ValueError: ``object_backbone`` is missing for view ``"object"``, or given for ``"frame"``.

    Attributes:
        translation_branch: `PoseBranch` of the first feature map; frozen in stage 3.
        orientation_branch: `PoseBranch` of the second feature map, or of the object's view; frozen
            in stage 2.
        orientation: Orientation head.
    """

    config_type: ClassVar[type[FilterformerPoseConfig]] = FilterformerPoseConfig

    config: FilterformerPoseConfig
    intrinsics: Tensor
    variance_scales: Tensor

    def __init__(
        self,
        config: FilterformerPoseConfig,
        backbone: Backbone,
        object_backbone: Backbone | None = None,
    ) -> None:
        super().__init__(config)
        if (object_backbone is None) == (config.orientation_view == "object"):
            wanted, given = ("one", "none") if object_backbone is None else ("none", "one")
            raise ValueError(
                f"object_backbone: expected {wanted} for orientation_view"
                f" {config.orientation_view!r}, got {given}"
            )
        self.backbone = backbone
        self.object_backbone = object_backbone
        self.orientation = build_orientation_head(config)
        channels = (*backbone.channels, *(object_backbone.channels if object_backbone else ()))
        self.translation_branch = PoseBranch(
            config,
            channels[0],
            config.first_grid,
            hyper_head(config, 3, config.translation_mlp_dim),
        )
        self.orientation_branch = PoseBranch(
            config, channels[1], config.orientation_grid, self._orientation_output()
        )
        if config.orientation_view == "object":
            self.register_buffer("intrinsics", torch.tensor(config.camera), persistent=False)
            self.register_buffer("variance_scales", torch.ones(2))

    def _orientation_output(self) -> nn.Module:
        """Build the module from the orientation branch's latent vector to its outputs."""
        config, features, start = self.config, self.orientation.features, self.orientation.start
        if start is None:
            head: nn.Module = nn.Linear(config.latent, features)
            if config.pooling != "flatten":  # which has a hidden layer of its own
                head = nn.Sequential(
                    nn.Linear(config.latent, config.head_hidden),
                    nn.GELU(),
                    nn.Linear(config.head_hidden, features),
                )
        else:
            head = hyper_head(config, features, config.orientation_mlp_dim)
            with torch.no_grad():
                head.bias.copy_(torch.tensor(start))
        if config.orientation_view == "frame":
            return head
        return SecondLookHead(head, hyper_head(config, SMALL_OUTPUTS, config.translation_mlp_dim))

    def forward(self, images: Tensor) -> PosePrediction | UncertainPose:
        """Predict the pose of the object in each image, as `BaseNetwork.forward`.

        An `UncertainPose` with ``config.orientation_view`` ``"object"``.
        """
        if self.config.orientation_view == "frame":
            return super().forward(images)
        self.check_images(images)
        return self._look_twice(images)

    def regress(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Compute translations ``(B, 3)``, meters, and the inputs of the orientation head."""
        maps = self.backbone(images)
        translation = self.in_meters(self.translation_branch(maps[0]))
        return translation, self.orientation_branch(maps[1])

    @half_in_learned_parts
    def _look_twice(self, images: Tensor) -> UncertainPose:
        """Locate the object in the frame, then look at it ``config.looks`` times."""
        levels = pyramid(images)
        points = self.located(self.locate(downsampled(levels, self.config.first_stride)))
        for _ in range(self.config.looks):
            pose = self._pose_at(levels, points)
            points = pose.translation
        return calibrated(pose, self.config)

    def view_at(self, points: Tensor, twist: Tensor | None = None) -> VirtualCamera:
        """Return the virtual cameras of second looks at points, as `virtual_camera.turn_to`."""
        return turn_to(points, self.config.object_radius_m, self.config.object_size, twist)

    def _pose_at(self, levels: Sequence[Tensor], points: Tensor) -> UncertainPose:
        """Look at points ``(B, 3)``; the covariances are multiplied by ``variance_scales``."""
        view = self.view_at(points)
        output = self.decode(self.encode(render_virtual(levels, view, points, self.intrinsics)))
        look = placed(output, view)
        q = view.turned_back(self.orientation.decode(output.orientation))
        translation, rotation = covariances(look)
        return UncertainPose(
            look.place,
            q,
            translation * self.variance_scales[0],
            rotation * self.variance_scales[1],
            output.in_view.sigmoid(),
            F.normalize(q, dim=-1),  # another tensor: an output of a graph has one name
            points.new_tensor([1.0, 0.0]).expand(points.shape[0], 2),
        )

    def locate(self, frames: Tensor) -> Tensor:
        """Compute the first look's outputs ``(B, 3)``: x / z, y / z, relative log distance."""
        maps = self.backbone(frames)
        result: Tensor = self.translation_branch(maps[0])
        return result

    def first_loss(self, frames: Tensor, translation: Tensor) -> Tensor:
        """Return the loss of the first look at ``frames (B, 3, h, w)`` of objects at ``(B, 3)``."""
        location = self.locate(frames)
        return F.smooth_l1_loss(location.float(), self.location(translation), beta=LOCATION_SMOOTH)

    def location(self, points: Tensor) -> Tensor:
        """Convert points ``(B, 3)`` in front of the camera, meters, to the outputs of `locate`."""
        x, y, z = points.unbind(-1)
        middle = math.sqrt(math.prod(self.config.distance_m))
        return torch.stack([x / z, y / z, (points.norm(dim=-1) / middle).log()], dim=-1)

    def located(self, output: Tensor) -> Tensor:
        """Convert the outputs of `locate` to points ``(B, 3)``, meters.

        Directions are clamped to the frame, and distances to between half the smallest and twice
        the largest of training, so that the second look points into the image.
        """
        near, far = self.config.distance_m
        logs = [math.log(d / math.sqrt(near * far)) for d in (near / 2, far * 2)]
        distance = math.sqrt(near * far) * output[:, 2].clamp(*logs).exp()
        height, width = self.config.image_size
        fx, fy, cx, cy = self.intrinsics.unbind(-1)
        x = torch.minimum(torch.maximum(output[:, 0], -cx / fx), (width - cx) / fx)
        y = torch.minimum(torch.maximum(output[:, 1], -cy / fy), (height - cy) / fy)
        rays = torch.stack([x, y, torch.ones_like(x)], dim=-1)
        return F.normalize(rays, dim=-1) * distance[:, None]

    def encode(self, views: Tensor, tan_half_angle: Tensor | None = None) -> Tensor:
        """Compute the feature map ``(B, C, rows, columns)`` of views of the object.

        It does not depend on the ``tan_half_angle`` of `PolarPose.encode`.
        """
        assert self.object_backbone is not None
        feature_map: Tensor = self.object_backbone(views)[0]
        return feature_map

    def decode(self, feature_map: Tensor) -> SecondLookOutput:
        """Compute the second look's outputs for its feature map."""
        return split_output(self.orientation_branch(feature_map))

    @classmethod
    def build(cls, config: FilterformerPoseConfig, backbone_weights: str | Path) -> Self:
        """Build a network with new weights."""
        reductions = (config.translation_reduction, config.orientation_reduction)
        if config.orientation_view == "frame":
            return cls(config, build_backbone(config.backbone, reductions, backbone_weights))
        return cls(
            config,
            build_backbone(config.backbone, reductions[:1], backbone_weights),
            build_backbone(config.object_backbone, reductions[1:], backbone_weights),
        )
