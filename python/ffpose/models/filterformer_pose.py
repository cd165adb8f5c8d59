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

from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

from ffpose.config import FilterformerPoseConfig
from ffpose.models.backbone import Backbone, build_backbone
from ffpose.models.base import FrameNetwork
from ffpose.nn import Filterformer, HyperHead, PositionCode
from ffpose.nn.orientation import BinsHead, OrientationHead, QuaternionHead

TOKEN_STD = 0.02


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
        self.pose_token = None
        extra = 1 if config.pooling == "token" else 0
        if extra:
            self.pose_token = nn.Parameter(torch.randn(1, 1, config.dim) * TOKEN_STD)
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
        self.head = head

    def forward(self, features: Tensor) -> Tensor:
        """Map features ``(B, channels, rows, columns)`` to outputs ``(B, out_features)``."""
        tokens = self.projection(features).flatten(2).transpose(1, 2)  # (B, rows * columns, dim)
        tokens = self.position(tokens)
        if self.pose_token is not None:
            token = self.pose_token.expand(tokens.shape[0], -1, -1)
            tokens = torch.cat((token, tokens), dim=1)  # (B, 1 + rows * columns, dim)
        tokens = self.encoder(tokens)
        latent = tokens.mean(1) if self.pose_token is None else tokens[:, 0]
        result: Tensor = self.head(latent)
        return result


class FilterformerPose(FrameNetwork):
    """Pose network; `from_config` builds it with its backbone, `from_pretrained` reads a file.

    It can be exported by `torch.export`, with any batch size if ``dynamic_shapes`` says so. Import
    `ffpose.models` before loading a saved program, to register its operators and result types.

    Args:
        config: Architecture of the network.
        backbone: Backbone with feature maps of stride ``config.translation_reduction`` and
            ``config.orientation_reduction``, in this order; frozen in stages 2 and 3 of training.

    Attributes:
        translation_branch: `PoseBranch` of the first feature map; frozen in stage 3.
        orientation_branch: `PoseBranch` of the second feature map; frozen in stage 2.
        orientation: Orientation head.
    """

    config_type: ClassVar[type[FilterformerPoseConfig]] = FilterformerPoseConfig

    config: FilterformerPoseConfig

    def __init__(self, config: FilterformerPoseConfig, backbone: Backbone) -> None:
        super().__init__(config)
        self.backbone = backbone
        self.orientation: OrientationHead = (
            BinsHead(config.bins, config.bins_degree, config.bins_width_deg)
            if config.orientation_head == "bins"
            else QuaternionHead()
        )
        self.translation_branch = PoseBranch(
            config,
            backbone.channels[0],
            config.grid(config.translation_reduction),
            HyperHead(config.dim, 3, hidden=config.head_hidden, mlp_dim=config.translation_mlp_dim),
        )
        self.orientation_branch = PoseBranch(
            config,
            backbone.channels[1],
            config.grid(config.orientation_reduction),
            self._orientation_output(),
        )

    def _orientation_output(self) -> nn.Module:
        """Build the module from the orientation branch's latent vector to its outputs."""
        config, features = self.config, self.orientation.features
        if config.orientation_head == "bins":
            return nn.Sequential(
                nn.Linear(config.dim, config.head_hidden),
                nn.GELU(),
                nn.Linear(config.head_hidden, features),
            )
        hidden, mlp_dim = config.head_hidden, config.orientation_mlp_dim
        head = HyperHead(config.dim, features, hidden=hidden, mlp_dim=mlp_dim)
        with torch.no_grad():
            head.bias.copy_(torch.tensor(QuaternionHead.start))
        return head

    def regress(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Compute translations ``(B, 3)``, meters, and the inputs of the orientation head."""
        maps = self.backbone(images)
        translation = self.in_meters(self.translation_branch(maps[0]))
        return translation, self.orientation_branch(maps[1])

    @classmethod
    def build(cls, config: FilterformerPoseConfig, backbone_weights: str | Path) -> Self:
        """Build a network with new weights."""
        reductions = (config.translation_reduction, config.orientation_reduction)
        return cls(config, build_backbone(config.backbone, reductions, backbone_weights))
