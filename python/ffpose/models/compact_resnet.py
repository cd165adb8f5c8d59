"""A residual network small enough to train from random weights on a CPU.

Basic blocks (He et al., "Deep Residual Learning for Image Recognition", 2016) of dense 3 x 3
convolutions with batch norm, which use a CPU's vector units better than the depthwise convolutions
of mobile networks. Channels are multiples of 16, the lanes of AVX-512. The last batch norm of a
block is initialized to zero, so that the block starts as its skip connection.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from torch import Tensor, nn
from torch.nn import functional as F

REDUCTIONS = (4, 8, 16)

WIDTHS = {"compact_resnet_narrow": (16, 32, 64, 96)}
"""Channels of the stem and of the maps of `REDUCTIONS`, by name."""


class BasicBlock(nn.Module):
    """Two convolutions, the first of a stride, and a skip connection."""

    def __init__(self, channels: int, out_channels: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, out_channels, 3, stride, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(out_channels)
        self.conv2 = nn.Conv2d(out_channels, out_channels, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(out_channels)
        self.skip = (
            nn.Identity()
            if stride == 1 and channels == out_channels
            else nn.Sequential(
                nn.Conv2d(channels, out_channels, 1, stride, bias=False),
                nn.BatchNorm2d(out_channels),
            )
        )
        nn.init.zeros_(self.norm2.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, out_channels, h / stride, w / stride)`` for ``x (B, channels, h, w)``."""
        y = F.relu(self.norm1(self.conv1(x)), inplace=True)
        return F.relu(self.norm2(self.conv2(y)) + self.skip(x), inplace=True)


class CompactResNet(nn.Module):
    """Residual network that returns feature maps at strides 4, 8 and optionally 16.

    ``widths`` are the channels of the stem and of the maps; later stages than that of the coarsest
    stride, ``reduction``, are not built.
    """

    def __init__(self, widths: Sequence[int], reduction: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(3, widths[0], 3, 2, 1, bias=False),
            nn.BatchNorm2d(widths[0]),
            nn.ReLU(inplace=True),
        )
        stages: list[nn.Module] = [BasicBlock(widths[0], widths[1], 2)]
        stages += [
            nn.Sequential(BasicBlock(before, after, 2), BasicBlock(after, after))
            for before, after in pairwise(widths[1:])
        ]
        self.stages = nn.ModuleList(stages[: REDUCTIONS.index(reduction) + 1])
        self.channels = dict(zip(REDUCTIONS, widths[1:], strict=True))

    def forward(self, images: Tensor) -> list[Tensor]:
        """Return the maps of ``images (B, 3, H, W)``, finest first."""
        x = self.stem(images)
        maps = []
        for stage in self.stages:
            x = stage(x)
            maps.append(x)
        return maps
