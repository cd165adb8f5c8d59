"""Configuration of FilterformerPose; each reading of the paper is a field, saved with the weights.

Ye et al., Sensors 2023, 23, 8633, leave details open; the network's predecessors (MS-Transformer,
HyperPose) settle most. ``base`` is the paper's network in this reading. ``small`` and ``tiny`` have
its structure in other sizes; ``compact`` looks twice. Nothing here needs torch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from ffpose._internal.choices import FilterKind, NormPlace, PositionKind
from ffpose.config.network import FrameConfig
from ffpose.config.second_look import SecondLookConfig
from ffpose.errors import expect

Pooling = Literal["token", "mean", "flatten"]
OrientationView = Literal["frame", "object"]
OrientationHead = Literal["quaternion", "6d", "bins"]


FLAT_CHANNELS = 32
"""Number of channels per token to which pooling "flatten" reduces."""

FLAT_LATENT = 256
"""Size of the latent vector after pooling "flatten"."""


@dataclass(frozen=True)
class FilterformerPoseConfig(SecondLookConfig, FrameConfig):
    """Architecture of the network; sizes of images and grids are ``(height, width)``.

    Fields that other networks have too are described by the bases.

    Attributes:
        translation_reduction: Stride of the feature map of the translation branch, pixels per cell;
            16 with EfficientNet-B0 at 224 is the paper's 14 x 14 x 112.
        orientation_reduction: Stride of the feature map of the orientation branch; 8 is the paper's
            28 x 28 x 40.
        dim: Number of channels of the tokens, Y in Eq. 1.
        depth: Number of filterformer blocks in each branch, N in Table 2; may be 0 with pooling
            ``"flatten"``.
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
            of the tokens; ``"flatten"``: all tokens, reduced to `FLAT_CHANNELS` each, through one
            linear layer.
        head_hidden: Hidden width of the heads' static perceptron.
        translation_mlp_dim: Width of the generated perceptron for translation (Table 1).
        orientation_mlp_dim: Width of the generated perceptron for orientation (Table 1).
        orientation_view: ``"frame"``: orientation from the whole image, the paper's reading;
            ``"object"``: from a second look, through a virtual camera pointed to where the first
            look found the object (`ffpose.models.virtual_camera`); needs ``camera``.
        orientation_head: ``"quaternion"`` (the paper's), ``"6d"`` or ``"bins"``, see
            `ffpose.nn.orientation`.
        bins: Number of attitudes of the head ``"bins"``.
        bins_degree: Largest degree of its harmonics of SO(3).
        bins_width_deg: Standard deviation of its soft labels, degrees.
        object_backbone: Backbone of the second look, named as ``backbone``.
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
    orientation_view: OrientationView = "frame"
    orientation_head: OrientationHead = "quaternion"
    bins: int = 6000
    bins_degree: int = 5
    bins_width_deg: float = 8.0
    object_backbone: str = "compact_resnet"

    def _least(self, name: str) -> int:
        return 0 if name == "depth" and self.pooling == "flatten" else 1

    def _check_values(self) -> None:
        super()._check_values()
        divides = self.dim % self.heads == 0
        expect(divides, "heads", f"a divisor of dim {self.dim}", self.heads)
        expect(0 <= self.dropout < 1, "dropout", "0 <= dropout < 1", self.dropout)
        expect(self.filter_std >= 0, "filter_std", "at least 0", self.filter_std)

    @property
    def coarsest_reduction(self) -> int:
        """Stride of the coarser feature map, pixels per cell."""
        return max(self.translation_reduction, self.orientation_reduction)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the submodules that a training stage may freeze."""
        second = ("object_backbone",) if self.orientation_view == "object" else ()
        return ("backbone", *second, "translation_branch", "orientation_branch")

    @property
    def free_fields(self) -> tuple[str, ...]:
        """The number of second looks, where there is one."""
        return ("looks",) if self.orientation_view == "object" else ()

    @property
    def latent(self) -> int:
        """Size of the latent vector, the heads' input."""
        return FLAT_LATENT if self.pooling == "flatten" else self.dim

    @property
    def first_grid(self) -> tuple[int, int]:
        """Size ``(rows, columns)`` of the translation branch's feature map."""
        stride = self.first_stride if self.orientation_view == "object" else 1
        return self.grid(self.translation_reduction * stride)

    @property
    def orientation_grid(self) -> tuple[int, int]:
        """Size ``(rows, columns)`` of the orientation branch's feature map."""
        if self.orientation_view == "frame":
            return self.grid(self.orientation_reduction)
        return self.object_grid

    @property
    def looks_twice(self) -> bool:
        """Whether the orientation is seen through a virtual camera."""
        return self.orientation_view == "object"

    @property
    def object_grid(self) -> tuple[int, int]:
        """Size ``(rows, columns)`` of the second look's feature map."""
        rows, columns = (math.ceil(side / self.orientation_reduction) for side in self.object_size)
        return rows, columns

    @property
    def object_width(self) -> int:
        """Width of the virtual camera's image in pixels."""
        return self.object_size[1]


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
    "compact": FilterformerPoseConfig(
        image_size=(384, 512),
        backbone="compact_resnet_narrow",
        translation_reduction=8,
        dim=64,
        depth=0,
        heads=4,
        feed_forward=128,
        dropout=0.0,
        filter="grid",
        pooling="flatten",
        head_hidden=256,
        translation_mlp_dim=64,
        orientation_mlp_dim=64,
        camera=(256.0, 256.1852, 256.0, 192.0),  # URSO's at this size
        orientation_view="object",
        orientation_head="bins",
        first_stride=8,
    ),
}
CONFIGS["transformerpose"] = replace(CONFIGS["base"], filter="none")
"""Presets by name.

``base`` is the paper's network with 9.3 million parameters (backbone 0.85, translation 3.5,
orientation 4.9); ``small`` has 2.8 million. ``tiny`` has 0.33 million and trains from random
weights in minutes on two cores; both of its branches use the coarser feature map. ``compact``, with
1.7 million, looks twice, in rows and columns. ``transformerpose`` is ``base`` without filters, the
network that the paper compares with in its Table 3.
"""
