"""UrsoNet: location by regression, orientation by soft classification.

Proenca and Gao, "Deep Learning for Spacecraft Pose Estimation from Photorealistic Rendering", ICRA
2020. A ResNet without its pooling; a 3 x 3 convolution of stride 2, the *bottleneck*, compresses
its last feature map, which both branches read as one vector through a fully connected layer. The
location branch ends in three numbers, with the relative location loss ``||t - t_hat|| / ||t||``;
the orientation branch in logits over a grid of Euler angles (`ffpose.nn.euler_bins`). Both losses
have fixed weights.

Details are those of the authors' program (github.com/pedropro/UrsoNet): no nonlinearity after the
bottleneck, one hidden layer with ReLU in each branch. Its last layer clips logits at zero, which
is left out here: a clipped logit gets no gradient.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

from ffpose.config import UrsoNetConfig
from ffpose.models.backbone import Backbone, build_backbone
from ffpose.models.base import FrameNetwork
from ffpose.nn.euler_bins import EulerBinsHead


class BottleneckBackbone(Backbone):
    """A backbone with one feature map, and the convolution that compresses it to a width."""

    def __init__(self, backbone: Backbone, width: int) -> None:
        super().__init__(backbone.features, (width,), backbone.order, backbone.source)
        self.bottleneck = nn.Conv2d(backbone.channels[0], width, 3, stride=2, padding=1)

    def forward(self, images: Tensor) -> tuple[Tensor]:
        """Return a map ``(B, width, h / 2, w / 2)`` for ``images (B, 3, H, W)``."""
        (feature_map,) = super().forward(images)
        return (self.bottleneck(feature_map),)


class UrsoNet(FrameNetwork):
    """UrsoNet; `from_config` builds it with its backbone, `from_pretrained` reads a file.

    Args:
        config: Architecture of the network.
        backbone: Backbone with one feature map, of stride ``2 * config.reduction``.
    """

    config_type: ClassVar[type[UrsoNetConfig]] = UrsoNetConfig

    config: UrsoNetConfig

    def __init__(self, config: UrsoNetConfig, backbone: BottleneckBackbone) -> None:
        super().__init__(config)
        self.backbone = backbone
        self.orientation = EulerBinsHead(config.bins_per_dim, config.smoothing)
        rows, columns = config.grid(2 * config.reduction)
        features = config.bottleneck * rows * columns
        self.translation_branch = _branch(features, config.hidden, 3)
        self.orientation_branch = _branch(features, config.hidden, self.orientation.features)

    @classmethod
    def build(cls, config: UrsoNetConfig, backbone_weights: str | Path) -> Self:
        """Build a network with new weights."""
        backbone = build_backbone(config.backbone, (config.reduction,), backbone_weights)
        return cls(config, BottleneckBackbone(backbone, config.bottleneck))

    def regress(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Compute translations ``(B, 3)``, meters, and logits ``(B, bins)``."""
        (feature_map,) = self.backbone(images)
        translation = self.in_meters(self.translation_branch(feature_map))
        return translation, self.orientation_branch(feature_map)

    def translation_loss(self, t_hat: Tensor, t: Tensor) -> Tensor:
        """Return the relative location loss ``||t - t_hat|| / ||t||`` of each sample ``(B,)``."""
        distance: Tensor = torch.linalg.vector_norm(t, dim=-1)
        return super().translation_loss(t_hat, t) / distance


def _branch(features: int, hidden: int, out_features: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Flatten(), nn.Linear(features, hidden), nn.ReLU(), nn.Linear(hidden, out_features)
    )
