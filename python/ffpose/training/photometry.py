"""What a camera does to color, brightness, sharpness and noise, varied at random for training."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ffpose.nn.pyramid import halve
from ffpose.training.config import PatchAugmentation

SUPPLY = 1 << 21
"""Number of stored normal random numbers, from which noise is taken on a CPU."""

LEAST_BLUR, LEAST_NOISE = 0.02, 0.001
"""Blur and noise below these are left out: they change nothing, and cost as much as any."""


class Photometry:
    """Varies images in [0, 255], and standardizes them, black being zero.

    ``std`` is that of the input's preprocessing, whose mean is zero.
    """

    def __init__(
        self, augmentation: PatchAugmentation, std: tuple[float, float, float], device: torch.device
    ) -> None:
        self.augmentation = augmentation
        self.unit = (1 / torch.tensor(std, device=device))[:, None, None]  # white, standardized
        self.scale = self.unit / 255
        self.supply = torch.randn(SUPPLY, generator=torch.Generator().manual_seed(0))

    def one(self, image: Tensor, generator: torch.Generator) -> Tensor:
        """Vary an image ``(1, 3, h, w)`` on a CPU, and do no more than its draws ask for."""
        a = self.augmentation
        if a.monochrome > 0 and draw(generator) < a.monochrome:
            image = _monochrome(image, torch.rand(1, 3, generator=generator))
        noisy = image.shape
        stops = a.brightness * float(torch.randn((), generator=generator))
        image = image * (self.scale * 2**stops)
        if a.blur > 0 and (share := a.blur * draw(generator) ** 2) > LEAST_BLUR:
            image = torch.lerp(image, _smooth(image), share)
        if a.noise > 0 and (sigma := a.noise * draw(generator) ** 2) > LEAST_NOISE:
            noise = self._normal(noisy, generator)
            image = torch.addcmul(image, noise, sigma * self.unit)
        return image

    def together(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Vary images ``(B, 3, h, w)`` on any device, each by its own draws, without waiting."""
        a, device = self.augmentation, images.device

        each = (len(images), 1, 1, 1)
        without = torch.zeros(each, dtype=torch.bool, device=device)
        if a.monochrome > 0:
            without = torch.rand(each, generator=generator, device=device) < a.monochrome
            weights = torch.rand(len(images), 3, generator=generator, device=device)
            images = torch.where(without, _monochrome(images, weights), images)
        stops = a.brightness * torch.randn(each, generator=generator, device=device)
        images = images * (self.scale * 2**stops)
        if a.blur > 0:
            share = a.blur * torch.rand(each, generator=generator, device=device).square()
            images = torch.lerp(images, _smooth(images), share)
        if a.noise > 0:
            sigma = a.noise * torch.rand(each, generator=generator, device=device).square()
            noise = torch.randn(images.shape, generator=generator, device=device)
            images = torch.addcmul(
                images, torch.where(without, noise[:, :1], noise), sigma * self.unit
            )
        return images

    def _normal(self, shape: torch.Size, generator: torch.Generator) -> Tensor:
        """Return a slice of the stored normal random numbers, which is cheaper than drawing."""
        count = shape.numel()
        if count > len(self.supply) // 2:
            return torch.randn(shape, generator=generator)
        start = int(torch.randint(len(self.supply) - count, (), generator=generator))
        return self.supply[start : start + count].view(shape)


def draw(generator: torch.Generator) -> float:
    """Return a number between 0 and 1, all equally likely, of a generator on the CPU."""
    return float(torch.rand((), generator=generator))


def _monochrome(images: Tensor, weights: Tensor) -> Tensor:
    """Return the means ``(B, 1, h, w)`` of images' colors by positive weights ``(B, 3)``."""
    shares = weights / weights.sum(1, keepdim=True)
    return (images * shares[:, :, None, None]).sum(1, keepdim=True)


def _smooth(images: Tensor) -> Tensor:
    return F.interpolate(halve(images), images.shape[-2:], mode="bilinear")
