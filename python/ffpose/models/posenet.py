"""Direct regression in the manner of PoseNet: one backbone, a linear layer for each part.

Kendall et al., "PoseNet: A Convolutional Network for Real-Time 6-DOF Camera Relocalization", ICCV
2015: translation and quaternion are regressed from the pooled features of a classifier, with the
loss ``||t - t_hat|| + beta ||q - q_hat / ||q_hat|| ||``. Kendall and Cipolla, "Geometric Loss
Functions for Camera Pose Regression with Deep Learning", CVPR 2017, learn both weights instead
(`ffpose.training.losses`), which is the default here. As later comparisons do, it takes any
backbone in place of GoogLeNet, and has no layer of 2,048 features between backbone and outputs: a
ResNet's pooled features are as many.

The last bias of the orientation is initialized to the identity quaternion, so that the norm to
divide by is not close to zero at first.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

from ffpose.config import PoseNetConfig
from ffpose.models.backbone import Backbone, build_backbone
from ffpose.models.base import FrameNetwork
from ffpose.nn.orientation import QuaternionHead


class PoseNet(FrameNetwork):
    """Direct regression; `from_config` builds it with its backbone, `from_pretrained` reads a file.

    Args:
        config: Architecture of the network.
        backbone: Backbone with one feature map, of stride ``config.reduction``.
    """

    config_type: ClassVar[type[PoseNetConfig]] = PoseNetConfig

    config: PoseNetConfig

    def __init__(self, config: PoseNetConfig, backbone: Backbone) -> None:
        super().__init__(config)
        self.backbone = backbone
        self.orientation = QuaternionHead()
        self.dropout = nn.Dropout(config.dropout)
        self.translation_branch = nn.Linear(backbone.channels[0], 3)
        self.orientation_branch = nn.Linear(backbone.channels[0], self.orientation.features)
        with torch.no_grad():
            self.orientation_branch.bias.copy_(torch.tensor(QuaternionHead.start))

    @classmethod
    def build(cls, config: PoseNetConfig, backbone_weights: str | Path) -> Self:
        """Build a network with new weights."""
        return cls(config, build_backbone(config.backbone, (config.reduction,), backbone_weights))

    def regress(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Compute translations ``(B, 3)``, meters, and quaternions ``(B, 4)`` of any norm."""
        (feature_map,) = self.backbone(images)
        features = self.dropout(feature_map.mean((2, 3)))  # (B, channels)
        translation = self.in_meters(self.translation_branch(features))
        return translation, self.orientation_branch(features)
