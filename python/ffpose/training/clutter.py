"""Out-of-distribution images: random charts, blocks, gradients and noise, as negatives."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

MOST_SHAPES = 8


def clutter(count: int, size: tuple[int, int], generator: torch.Generator) -> Tensor:
    """Return random images ``(count, 3, h, w)`` in [0, 1].

    Each is a gradient with filled rectangles and bars over it, and noise of a random grain size.
    They are on the generator's device.
    """
    height, width = size
    device = generator.device
    y = torch.linspace(-1, 1, height, device=device)[None, None, :, None]
    x = torch.linspace(-1, 1, width, device=device)[None, None, None, :]

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, device=device)

    slope = uniform(count, 2, 1, 1, 1) - 0.5
    pictures = uniform(count, 3, 1, 1) + slope[:, 0] * x + slope[:, 1] * y
    most = MOST_SHAPES + 1
    shapes = torch.randint(most, (count, 1, 1, 1), generator=generator, device=device)
    for number in range(MOST_SHAPES):
        place = 2 * uniform(count, 2, 1, 1, 1) - 1
        reach = uniform(count, 2, 1, 1, 1).square()  # bars are as likely as blocks
        inside = ((x - place[:, 0]).abs() < reach[:, 0]) & ((y - place[:, 1]).abs() < reach[:, 1])
        drawn = inside & (number < shapes)
        pictures = torch.where(drawn, uniform(count, 3, 1, 1), pictures)
    grain = int(torch.randint(1, 9, (), generator=generator, device=device))
    coarse = (count, 3, -(-height // grain), -(-width // grain))
    noise = torch.randn(coarse, generator=generator, device=device)
    noise = F.interpolate(noise, size, mode="bilinear", align_corners=False)
    strength = 0.5 * uniform(count, 1, 1, 1).square()
    return (pictures + strength * noise).clamp(0, 1) * uniform(count, 1, 1, 1)
