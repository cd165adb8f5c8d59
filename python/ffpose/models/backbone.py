"""Convolutional backbone: a timm network truncated after the last feature map in use.

The paper reads two maps of EfficientNet-B0, 14 x 14 x 112 for translation and 28 x 28 x 40 for
orientation (section 3.1); here a map is identified by its stride (timm's "reduction"), the pixels
per cell. Layers after the coarsest map in use are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ffpose.errors import require
from ffpose.imaging.preprocessing import Mode, Preprocessing
from ffpose.models.compact_resnet import REDUCTIONS, WIDTHS, CompactResNet
from ffpose.models.hub import BackboneSource, load_backbone_weights

COMPACT_STD = (0.25, 0.25, 0.25)
"""Standard deviation of the input of `ffpose.models.compact_resnet`, whose mean is zero."""


class Backbone(nn.Module):
    """Feature extractor that returns maps at given strides.

    Args:
        features: A timm model created with ``features_only``.
        channels: Number of channels of each map to return.
        order: Index of each map to return among those of ``features``.
        source: Source of the weights, as in `ffpose.models.WeightsMetadata`.
    """

    def __init__(
        self,
        features: nn.Module,
        channels: Sequence[int],
        order: Sequence[int],
        source: BackboneSource | None = None,
    ) -> None:
        super().__init__()
        self.source = source
        self.features = features
        self.channels = tuple(channels)
        self.order = tuple(order)

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        """Return a map ``(B, channels[i], h_i, w_i)`` per stride of ``images (B, 3, H, W)``."""
        maps = self.features(images.contiguous(memory_format=torch.channels_last))
        return tuple(maps[place] for place in self.order)


def build_backbone(name: str, reductions: Sequence[int], weights: str | Path = "none") -> Backbone:
    """Build a backbone from timm.

    Args:
        name: timm's name of the model, for example ``"efficientnet_b0"``, or one of
            `ffpose.models.compact_resnet.WIDTHS`, which have no pretrained weights.
        reductions: Stride of each map to return.
        weights: ``"auto"`` for pretrained weights from the hub or its cache; ``"none"`` for random
            weights; otherwise a safetensors or PyTorch file. `Backbone.source` records the source.

    Raises:
        ValueError: timm has no such model, or the model has no map of a given stride.
        FileNotFoundError: The weights file does not exist, or the pretrained weights are not
            available.
        ffpose.DataError: The file does not hold this model's weights.
    """
    if name in WIDTHS:
        return _compact(name, reductions, weights)
    timm = require("timm", "pose")
    if not timm.is_model(name):
        near = ", ".join([*WIDTHS, *timm.list_models(f"*{name.split('_')[0]}*")[:8]])
        raise ValueError(f"backbone: expected a model of timm or ours, as {near}; got {name!r}")
    available = timm.create_model(name, features_only=True).feature_info.reduction()
    missing = [reduction for reduction in reductions if reduction not in available]
    if missing:
        raise ValueError(f"backbone: {name} gives reductions {available}, expected {missing}")
    indices = sorted({available.index(reduction) for reduction in reductions})
    features = timm.create_model(name, features_only=True, out_indices=indices)
    _drop_unused_blocks(features)
    source = load_backbone_weights(features, name, weights)
    order = [indices.index(available.index(reduction)) for reduction in reductions]
    channels = [features.feature_info.channels()[place] for place in order]
    # Channels-last convolutions are up to twice as fast on CPUs, with maps laid out as tokens.
    return Backbone(features.to(memory_format=torch.channels_last), channels, order, source)


def backbone_preprocessing(
    name: str, size: tuple[int, int], mode: Mode = "resize"
) -> Preprocessing:
    """Return the preprocessing to ``size (height, width)`` that a backbone's weights expect.

    Mean, standard deviation and interpolation are those in timm's ``pretrained_cfg``, which are not
    ImageNet's for every network. They are used with random weights as well; a network unknown to
    timm uses ImageNet's.
    """
    if name in WIDTHS:  # black is zero, as is everything outside an image
        return Preprocessing(size, mode, (0.0, 0.0, 0.0), COMPACT_STD)
    expected = require("timm", "pose").models.get_pretrained_cfg(name)
    if expected is None:
        return Preprocessing(size, mode)
    return Preprocessing(size, mode, expected.mean, expected.std, expected.interpolation)


def _compact(name: str, reductions: Sequence[int], weights: str | Path) -> Backbone:
    if weights not in ("auto", "none"):
        raise ValueError(f"backbone: expected no pretrained weights for {name}, got {weights}")
    missing = [reduction for reduction in reductions if reduction not in REDUCTIONS]
    if missing:
        raise ValueError(f"backbone: {name} gives reductions {REDUCTIONS}, expected {missing}")
    features = CompactResNet(WIDTHS[name], max(reductions))
    return Backbone(
        features.to(memory_format=torch.channels_last),
        [features.channels[reduction] for reduction in reductions],
        [REDUCTIONS.index(reduction) for reduction in reductions],
        "none",
    )


def _drop_unused_blocks(features: Any) -> None:
    """Remove the blocks after the last map, which timm's EfficientNet and MobileNet would run."""
    module, _, last = features.feature_info.module_name()[-1].partition(".")
    if module == "blocks" and last.isdigit():
        features.blocks = features.blocks[: int(last) + 1]
