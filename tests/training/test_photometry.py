"""Images as a camera without colors has them."""

import numpy as np
import pytest
import torch

from ffpose.training.config import PatchAugmentation
from ffpose.training.photometry import Photometry

STD = (0.2, 0.25, 0.3)
WHITE = 1 / torch.tensor(STD)[:, None, None]
"""Standardized white."""


@pytest.fixture(params=["one", "together"])
def varied(request):
    """Vary images (B, 3, h, w) in either way, each by draws of its own; return them in [0, 1]."""

    def vary(images, **changes):
        plain = {"brightness": 0.0, "noise": 0.0, "blur": 0.0}
        photometry = Photometry(PatchAugmentation(**(plain | changes)), STD, torch.device("cpu"))
        generator = torch.Generator().manual_seed(1)
        if request.param == "together":
            return photometry.together(images, generator) / WHITE
        each = [photometry.one(image, generator) for image in images[:, None]]
        return torch.cat(each) / WHITE

    return vary


def test_a_camera_without_colors_weighs_red_green_and_blue(varied):
    pure = 255 * torch.eye(3)[:, None].expand(3, 1, 3)  # a pixel of each color
    images = varied(pure.expand(50, 3, 1, 3), monochrome=1.0)
    np.testing.assert_allclose(images, images[:, :1].expand_as(images), atol=1e-6)
    np.testing.assert_allclose(images[:, 0].sum(-1), 1.0, rtol=1e-6)
    assert (images > 0).all()
    assert (images[:, 0, 0].std(0) > 0.05).all()


def test_its_noise_has_no_colors_either(varied):
    gray = torch.full((20, 3, 16, 16), 128.0)
    images = varied(gray, monochrome=1.0, noise=0.2)
    np.testing.assert_allclose(images, images[:, :1].expand_as(images), atol=1e-6)
    assert 0.03 < images[:, 0].std() < 0.2


def test_a_share_of_the_images_has_no_colors(varied):
    pure = 255 * torch.eye(3)[:, None].expand(3, 1, 3)
    images = varied(pure.expand(1000, 3, 1, 3), monochrome=0.3)
    colored = (images - images[:, :1]).abs().amax((1, 2, 3)) > 1e-6
    assert 0.64 < colored.float().mean() < 0.76  # four standard deviations
    np.testing.assert_allclose(images[colored], pure.expand_as(images[colored]) / 255, atol=1e-6)
