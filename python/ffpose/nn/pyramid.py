"""Images of virtual cameras, sampled from the pyramids of their source images.

``ffpose::halve`` and ``ffpose::sample_pyramid`` are operators so that an exported graph can hold
each as one node; in torch they consist of torch's own, and are differentiable as these are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from ffpose.geometry.warping import sample_planes, source_planes

HALVE = "ffpose::halve"
SAMPLE_PYRAMID = "ffpose::sample_pyramid"

torch.library.define(
    SAMPLE_PYRAMID,
    "(Tensor homographies, Tensor levels, Tensor plane, Tensor[] pyramid) -> Tensor",
    tags=(torch.Tag.pt2_compliant_tag,),
)
_op: Callable[..., Tensor] = torch.ops.ffpose.sample_pyramid.default
torch.library.define(HALVE, "(Tensor images) -> Tensor", tags=(torch.Tag.pt2_compliant_tag,))


def halve(images: Tensor) -> Tensor:
    """Return the means ``(B, C, H // 2, W // 2)`` of 2 x 2 pixels of images ``(B, C, H, W)``.

    The images are of floating-point numbers. Several times as fast on a CPU as torch's average
    pooling.
    """
    halved: Tensor = torch.ops.ffpose.halve.default(images)
    return halved


def _halve(images: Tensor) -> Tensor:
    height, width = images.shape[-2:]
    whole = images[..., : height - height % 2, : width - width % 2]
    rows = whole[..., 0::2, :] + whole[..., 1::2, :]
    return (rows[..., 0::2] + rows[..., 1::2]) / 4


def sample_pyramid(
    homographies: Tensor, levels: Tensor, plane: Tensor, pyramid: Sequence[Tensor]
) -> Tensor:
    """Sample each view ``(V, C, h, w)`` from a level of its image: bilinear, zeros outside.

    Args:
        homographies: ``(V, 3, 3)``, from the places of a view's pixels to continuous pixel
            coordinates of the finest level, times the depth of the ray.
        levels: ``(V,)``, whole numbers: the level for each view, in the dtype of the homographies.
        plane: ``(2, h, w)``, the places of a view's pixels.
        pyramid: Levels of images ``(B, C, H, W)``, finest first, each of half the size of the one
            before; four in a graph. Views of the first image are first, ``V / B`` of each.
    """
    return _op(homographies, levels, plane, list(pyramid))


def _sample_pyramid(
    homographies: Tensor, levels: Tensor, plane: Tensor, pyramid: Sequence[Tensor]
) -> Tensor:
    """Sample all views at once, from an image that holds the levels below each other, amid zeros.

    One image is sampled once, whatever the level.
    """
    finest = pyramid[0]
    rows, first = [], 0
    for number, level in enumerate(pyramid):
        height, width = level.shape[-2:]
        rows.append((0.5**number, first, width, height))
        first += height + 1
    wide = finest.shape[-1]
    below = [F.pad(level, (0, wide - level.shape[-1], 1, 0)) for level in pyramid[1:]]
    atlas = torch.cat((finest, *below), dim=2)
    of_level = homographies.new_tensor(rows)[levels.long()]
    scale, top, right, bottom = (column[:, None, None] for column in of_level.unbind(-1))
    u, v = source_planes(homographies, plane)  # each (V, h, w)
    # Half a pixel outside a level there are zeros, as everywhere beyond.
    u = torch.minimum((u * scale).clamp_min(-0.5), right + 0.5)
    v = torch.minimum((v * scale).clamp_min(-0.5), bottom + 0.5) + top
    height, width = plane.shape[1:]
    views = homographies.shape[0] // max(finest.shape[0], 1)
    together = (finest.shape[0], views * height, width)  # the views of an image
    seen = sample_planes(atlas, u.view(together), v.view(together))
    return torch.unflatten(seen, 2, (views, height)).transpose(1, 2).flatten(0, 1)


torch.library.impl(HALVE, "CompositeImplicitAutograd", _halve)
torch.library.impl(SAMPLE_PYRAMID, "CompositeImplicitAutograd", _sample_pyramid)
