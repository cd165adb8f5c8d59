"""Configuration of FilterformerPose; each reading of the paper is a field, saved with the weights.

Ye et al., Sensors 2023, 23, 8633, leave details open; the network's predecessors (MS-Transformer,
HyperPose) settle most. ``base`` is the paper's network in this reading. ``small`` and ``tiny`` have
its structure in other sizes. Nothing here needs torch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from ffpose._internal.choices import FilterKind, NormPlace, PositionKind
from ffpose.config.network import FrameConfig
from ffpose.errors import expect

Pooling = Literal["token", "mean"]
OrientationHead = Literal["quaternion", "bins"]


@dataclass(frozen=True)
class FilterformerPoseConfig(FrameConfig):
    """Architecture of the network; sizes of images and grids are ``(height, width)``.

    Fields that other networks have too are described by the bases.

    Attributes:
        translation_reduction: Stride of the feature map of the translation branch, pixels per cell;
            16 with EfficientNet-B0 at 224 is the paper's 14 x 14 x 112.
        orientation_reduction: Stride of the feature map of the orientation branch; 8 is the paper's
            28 x 28 x 40.
        dim: Number of channels of the tokens, Y in Eq. 1.
        depth: Number of filterformer blocks in each branch, N in Table 2.
        heads: Number of attention heads.
        feed_forward: Hidden width of the blocks' feed-forward networks.
        dropout: Dropout rate in the blocks.
        norm: ``"pre"``: normalization before each sublayer and after the last block; ``"post"``:
            after each sublayer.
        filter: ``"tokens"``: the paper's Eq. 1-3; ``"grid"``: as in GFNet; ``"none"``: no filter,
            the paper's TransformerPose.
        filter_std: Standard deviation of the filters' initial weights.
        position: Position code of row and column, ``"learned"`` or ``"sinusoidal"``.
        pooling: ``"token"``: a learned pose token, which bypasses the filter; ``"mean"``: the mean
            of the tokens.
        head_hidden: Hidden width of the heads' static perceptron.
        translation_mlp_dim: Width of the generated perceptron for translation (Table 1).
        orientation_mlp_dim: Width of the generated perceptron for orientation (Table 1).
        orientation_head: ``"quaternion"`` (the paper's) or ``"bins"``, see
            `ffpose.nn.orientation`.
        bins: Number of attitudes of the head ``"bins"``.
        bins_degree: Largest degree of its harmonics of SO(3).
        bins_width_deg: Standard deviation of its soft labels, degrees.
    """

    architecture: ClassVar[str] = "FilterformerPose"

    translation_reduction: int = 16
    orientation_reduction: int = 8
    dim: int = 256
    depth: int = 7
    heads: int = 8
    feed_forward: int = 256
    dropout: float = 0.1
    norm: NormPlace = "pre"
    filter: FilterKind = "tokens"
    filter_std: float = 0.02
    position: PositionKind = "learned"
    pooling: Pooling = "token"
    head_hidden: int = 1024
    translation_mlp_dim: int = 128
    orientation_mlp_dim: int = 256
    orientation_head: OrientationHead = "quaternion"
    bins: int = 6000
    bins_degree: int = 5
    bins_width_deg: float = 8.0

    def _check_values(self) -> None:
        super()._check_values()
        divides = self.dim % self.heads == 0
        expect(divides, "heads", f"a divisor of dim {self.dim}", self.heads)
        expect(0 <= self.dropout < 1, "dropout", "0 <= dropout < 1", self.dropout)
        expect(self.filter_std >= 0, "filter_std", "at least 0", self.filter_std)
        width = self.bins_width_deg
        expect(0 < width < math.inf, "bins_width_deg", "a finite number above 0", width)

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the coarser feature map, pixels per cell."""
        return max(self.translation_reduction, self.orientation_reduction)


CONFIGS: dict[str, FilterformerPoseConfig] = {
    "base": FilterformerPoseConfig(),
    "small": FilterformerPoseConfig(
        image_size=(192, 256),
        backbone="efficientnet_lite0",
        dim=128,
        depth=4,
        heads=4,
        head_hidden=512,
    ),
    "tiny": FilterformerPoseConfig(
        image_size=(96, 128),
        backbone="mobilenetv4_conv_small_050",
        orientation_reduction=16,
        dim=64,
        depth=2,
        heads=4,
        feed_forward=128,
        dropout=0.0,
        filter="grid",
        head_hidden=256,
        translation_mlp_dim=64,
        orientation_mlp_dim=64,
    ),
}
CONFIGS["transformerpose"] = replace(CONFIGS["base"], filter="none")
"""Presets by name.

``base`` is the paper's network with 9.3 million parameters (backbone 0.85, translation 3.5,
orientation 4.9); ``small`` has 2.8 million. ``tiny`` has 0.33 million and trains from random
weights in minutes on two cores; both of its branches use the coarser feature map.
``transformerpose`` is ``base`` without filters, the network that the paper compares with in its
Table 3.
"""
