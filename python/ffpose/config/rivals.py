"""Configurations of the published networks that FilterformerPose is compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ffpose.config.network import FrameConfig
from ffpose.errors import expect


@dataclass(frozen=True)
class UrsoNetConfig(FrameConfig):
    """Architecture of UrsoNet (`ffpose.models.ursonet`).

    The defaults are those of the authors' program and of their commands for URSO, at half the size
    of its images.

    Attributes:
        reduction: Stride of the feature map that the bottleneck compresses, pixels per cell.
        bottleneck: Number of channels of the bottleneck.
        hidden: Width of the fully connected layer of each branch.
        bins_per_dim: Number of orientation bins for each Euler angle.
        smoothing: Width of the soft assignment in bins, the authors' beta.
        location_weight: Weight of the relative location loss.
        orientation_weight: Weight of the cross-entropy.
    """

    architecture: ClassVar[str] = "UrsoNet"

    image_size: tuple[int, int] = (480, 640)
    backbone: str = "resnet50"
    reduction: int = 32
    bottleneck: int = 32
    hidden: int = 1024
    bins_per_dim: int = 24
    smoothing: float = 6.0
    location_weight: float = 1.0
    orientation_weight: float = 1.0

    def _check_values(self) -> None:
        super()._check_values()
        expect(self.bins_per_dim >= 3, "bins_per_dim", "at least 3", self.bins_per_dim)
        for name in ("smoothing", "location_weight", "orientation_weight"):
            _expect_positive(name, getattr(self, name))

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the feature map, pixels per cell."""
        return self.reduction

    @property
    def loss_weights(self) -> tuple[float, float]:
        """Fixed weights of location and orientation loss."""
        return self.location_weight, self.orientation_weight


@dataclass(frozen=True)
class PoseNetConfig(FrameConfig):
    """Architecture of direct regression in the manner of PoseNet (`ffpose.models.posenet`).

    Attributes:
        reduction: Stride of the feature map that is averaged, pixels per cell.
        dropout: Dropout rate of the features.
        beta: Fixed weight of the quaternion loss (Kendall et al., 2015), beside 1 for the
            translation; None learns both weights (Kendall and Cipolla, 2017).
    """

    architecture: ClassVar[str] = "PoseNet"

    backbone: str = "resnet50"
    reduction: int = 32
    dropout: float = 0.0
    beta: float | None = None

    def _check_values(self) -> None:
        super()._check_values()
        expect(0 <= self.dropout < 1, "dropout", "0 <= dropout < 1", self.dropout)
        if self.beta is not None:
            _expect_positive("beta", self.beta)

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the feature map, pixels per cell."""
        return self.reduction

    @property
    def loss_weights(self) -> tuple[float, float] | None:
        """Weights 1 and ``beta``; None where they are learned."""
        return None if self.beta is None else (1.0, self.beta)


def _expect_positive(name: str, value: Any) -> None:
    positive = isinstance(value, int | float) and 0 < value < math.inf
    expect(positive, name, "a finite number above 0", value)
