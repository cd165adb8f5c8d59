"""Layers on polar maps: laws of a rotation about the origin, and convolutions by hand."""

from typing import get_args

import pytest
import torch
from torch.nn import functional as F

from ffpose._internal.choices import PolarMixer
from ffpose.nn.polar import PolarBlock, PolarConv, SpectralPool, half_turned, through_origin


@pytest.fixture(autouse=True)
def seed():
    torch.manual_seed(0)


@pytest.mark.parametrize("stride", [(1, 1), (2, 2), (2, 1)])
def test_a_convolution_commutes_with_a_shift_of_its_cells(stride):
    layer = PolarConv(3, 5, stride).eval()
    x = torch.randn(2, 3, 8, 24)
    for cells in (1, 7):
        got = layer(x.roll(cells * stride[1], 3))
        torch.testing.assert_close(got, layer(x).roll(cells, 3), rtol=1e-5, atol=1e-5)


def test_a_convolution_is_torchs_on_a_map_continued_by_hand():
    """Inside, the innermost ring half a turn further; outside, zero; beside the seam, the rest."""
    layer = PolarConv(2, 4, (1, 1)).eval()
    x = torch.randn(1, 2, 3, 8)
    padded = torch.zeros(1, 2, 5, 10)
    for angle in range(-1, 9):
        padded[:, :, 1:4, angle + 1] = x[:, :, :, angle % 8]
        padded[:, :, 0, angle + 1] = x[:, :, 0, (angle + 4) % 8]
    norm = layer.norm
    expected = F.relu(norm(F.conv2d(padded, layer.conv.weight)))
    torch.testing.assert_close(layer(x), expected)


def test_half_a_turn_twice_is_none():
    x = torch.randn(2, 3, 10, 4)
    assert torch.equal(half_turned(half_turned(x, 2), 2), x)
    assert torch.equal(half_turned(x, 2)[:, :, 2], x[:, :, 7])


def test_a_map_through_the_origin_is_its_image_along_a_line():
    """f(r, a) = x = r cos a is odd along every line through the origin, which it continues."""
    radius = torch.arange(4) + 0.5
    angle = (torch.arange(12) + 0.5) * 2 * torch.pi / 12
    x = (radius[:, None] * angle.cos())[None, :, :, None]
    both = torch.cat((-radius.flip(0), radius))
    expected = (both[:, None] * angle.cos())[None, :, :, None]
    torch.testing.assert_close(through_origin(x, 4), expected)


def a_block(mixer):
    block = PolarBlock((4, 12, 16), mixer).eval()
    for layer in block.modules():
        if isinstance(layer, torch.nn.Linear):
            torch.nn.init.normal_(layer.weight, std=0.25)
    if mixer in ("attention", "filterformer"):
        torch.nn.init.normal_(block.attention.bias)
    return block


@pytest.mark.parametrize("mixer", get_args(PolarMixer))
def test_every_block_commutes_with_shifts_along_the_angle_alone(mixer):
    block, x = a_block(mixer), torch.randn(2, 4, 12, 16)
    torch.testing.assert_close(block(x.roll(5, 2)), block(x).roll(5, 2), rtol=1e-4, atol=1e-4)
    assert (block(x.roll(1, 1)) - block(x).roll(1, 1)).abs().max() > 0.1


@pytest.mark.parametrize("mixer", get_args(PolarMixer))
def test_every_weight_of_a_block_learns(mixer):
    block = a_block(mixer)
    block(torch.randn(2, 4, 12, 16)).square().sum().backward()
    assert all(p.grad.abs().sum() > 0 for p in block.parameters())


@pytest.mark.parametrize(("mixer", "reach"), [("filter", 1), ("depthwise3", 1), ("depthwise7", 3)])
def test_an_impulse_is_seen_as_far_as_the_kernel_reaches_across_the_origin_too(mixer, reach):
    """A new filter is a convolution of 3 x 3 cells. The impulse is in the innermost ring."""
    x = torch.zeros(1, 4, 24, 16)
    x[0, 0, 5] = 1
    y = PolarBlock((4, 24, 16), mixer).mixer(x)[0].abs().sum(-1)
    lit = {(int(r), int(a)) for r, a in zip(*torch.nonzero(y > 1e-4, as_tuple=True), strict=True)}
    beside = range(-reach, reach + 1)
    near = {(row, 5 + step) for row in range(reach + 1) for step in beside}
    assert lit == near | {(row, 17 + step) for row in range(reach) for step in beside}


def test_attention_is_torchs_with_the_bias_of_radii_and_turn():
    attention = a_block("attention").attention
    x = torch.randn(1, 4, 12, 16)
    tokens = attention.norm(x).view(48, 16)
    q, k, v = attention.qkv(tokens).view(48, 3, 4, 4).permute(1, 2, 0, 3)
    bias = torch.empty(4, 48, 48)
    for one in range(48):
        for other in range(48):
            (i, a), (j, b) = divmod(one, 12), divmod(other, 12)
            bias[:, one, other] = attention.bias.view(4, 4, 4, 12)[:, i, j, (a - b) % 12]
    weights = (q @ k.mT / 2 + bias).softmax(-1)
    expected = x + attention.out((weights @ v).permute(1, 0, 2).reshape(48, 16)).view_as(x)
    torch.testing.assert_close(attention(x), expected, rtol=1e-4, atol=1e-5)


def test_pooling_keeps_the_lower_half_of_the_frequencies_by_the_fft():
    x = torch.randn(2, 3, 24, 5, dtype=torch.float64)
    spectrum = torch.fft.rfft(x, dim=2)[:, :, :6]
    expected = torch.fft.irfft(F.pad(spectrum, (0, 0, 0, 1)), 12, dim=2) / 2
    torch.testing.assert_close(SpectralPool(24).double()(x), expected, atol=1e-6, rtol=1e-6)


def test_pooling_commutes_with_a_rotation_by_any_angle():
    """A shift by one of 24 angles is one by half an angle of 12, which the spectrum can tell."""
    x = torch.randn(1, 1, 24, 1)
    pool = SpectralPool(24)
    spectrum = torch.fft.rfft(pool(x), dim=2)
    half = torch.exp(-2j * torch.pi * torch.arange(7) * 0.5 / 12)[:, None]
    expected = torch.fft.irfft(spectrum * half, 12, dim=2)
    torch.testing.assert_close(pool(x.roll(1, 2)), expected, atol=1e-5, rtol=1e-5)
