"""Halved images, against torch's average pooling."""

import pytest
import torch
from torch.nn import functional as F

from ffpose.nn.pyramid import halve


@pytest.mark.parametrize("size", [(8, 6), (7, 9), (2, 3), (0, 4)])
def test_halved_images_are_means_of_four_pixels(size):
    images = torch.randn(2, 3, *size, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(
        halve(images),
        F.avg_pool2d(images, 2) if size[0] else images.new_zeros(2, 3, 0, 2),
        rtol=0,
        atol=1e-15,
    )


def test_gradients_of_halved_images():
    images = torch.randn(1, 2, 5, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(halve, images)
