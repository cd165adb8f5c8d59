"""Layers for maps in polar coordinates, equivariant to rotation about the origin.

The rows of a map are radii, its columns angles. A rotation about the origin by a whole number of
columns is a cyclic shift along the angle, with which every layer here commutes (Esteves et al.,
"Polar Transformer Networks", ICLR 2018). The boundary of a polar map is right by nature:

* along the angle it is cyclic, as a spectral filter is;
* beyond the innermost ring lies the ring itself, half a turn further: the point at radius ``-r``
  and angle ``a`` is that at radius ``r`` and angle ``a + pi``.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ffpose._internal.choices import PolarMixer
from ffpose.errors import expect
from ffpose.nn.spectral import SpectralFilter

KERNEL = 3


class PolarConv(nn.Module):
    """Convolution of 3 x 3 cells with batch norm and ReLU; outside the outermost ring is zero.

    Strides along radius and angle are divisors of the map's sides.
    """

    def __init__(self, channels: int, out_channels: int, stride: tuple[int, int]) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, out_channels, KERNEL, stride, bias=False)
        self.norm = nn.BatchNorm2d(out_channels)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, out_channels, radii', angles')`` for ``x (B, channels, radii, angles)``."""
        x = torch.cat((half_turned(x[:, :, :1], 3), x), dim=2)
        x = torch.cat((x[..., -1:], x, x[..., :1]), dim=3)
        return F.relu(self.norm(self.conv(F.pad(x, (0, 0, 0, 1)))), inplace=True)


class SpectralPool(nn.Module):
    """Halves the number of angles of a map by leaving out the upper half of their frequencies.

    No frequency is taken for another, so it commutes with rotations by any angle, not only by whole
    cells (Rippel et al., "Spectral Representations for Convolutional Neural Networks", NeurIPS
    2015). It is one product with a matrix, the real transform and its inverse in one. The number
    of angles of the input is a multiple of 4.
    """

    matrix: Tensor

    def __init__(self, angles: int) -> None:
        super().__init__()
        kept = torch.arange(angles // 2, dtype=torch.float64) * (4 * math.pi / angles)
        given = torch.arange(angles, dtype=torch.float64) * (2 * math.pi / angles)
        matrix = interpolation(given, kept, (angles // 2 - 1) // 2)
        self.register_buffer("matrix", matrix.float(), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, radii, angles / 2, channels)`` for ``x (B, radii, angles, channels)``."""
        return self.matrix.to(x.dtype) @ x


class PolarFilter(nn.Module):
    """Spectral filter over radius and angle, which sees the map continued through the origin.

    So only its outermost rings meet where none does in the image. Filters begin as random kernels
    of 3 x 3 cells. The map's size is ``(radii, angles, channels)``, of an even number of angles.
    """

    def __init__(self, size: tuple[int, int, int]) -> None:
        super().__init__()
        radii, angles, channels = size
        self.filter = SpectralFilter((2 * radii, angles, channels), layout="grid")
        kernel = torch.zeros(2 * radii, angles, channels)
        for row in (-1, 0, 1):
            for column in (-1, 0, 1):
                kernel[row, column] = torch.randn(channels) / KERNEL
        with torch.no_grad():
            self.filter.weight.copy_(torch.view_as_real(torch.fft.rfft2(kernel, dim=(0, 1))))

    def forward(self, x: Tensor) -> Tensor:
        """Return the filtered map for one ``(B, radii, angles, channels)``."""
        filtered: Tensor = self.filter(through_origin(x, x.shape[1]))
        return filtered[:, x.shape[1] :]


class PolarDepthwise(nn.Module):
    """Depthwise convolution of an odd side, the comparison with the filter; zero outside."""

    def __init__(self, channels: int, kernel: int) -> None:
        super().__init__()
        self.reach = kernel // 2
        self.conv = nn.Conv2d(channels, channels, kernel, groups=channels, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the convolved map for one ``(B, radii, angles, channels)``."""
        reach = self.reach
        x = through_origin(x, reach)
        x = torch.cat((x, torch.zeros_like(x[:, :reach])), dim=1)
        x = torch.cat((x[:, :, -reach:], x, x[:, :, :reach]), dim=2)
        convolved: Tensor = self.conv(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
        return convolved


class PolarAttention(nn.Module):
    """Self-attention over the cells of a map, with a bias by both radii and the angle between.

    It commutes with shifts along the angle, as positions count by their difference alone (relative
    position bias; Shaw et al., NAACL 2018).
    """

    between: Tensor

    def __init__(self, size: tuple[int, int, int], heads: int = 4) -> None:
        super().__init__()
        radii, angles, channels = size
        expect(channels % heads == 0, "channels", f"a multiple of the {heads} heads", channels)
        self.heads = heads
        self.norm = nn.LayerNorm(channels)
        self.qkv = nn.Linear(channels, 3 * channels)
        self.out = nn.Linear(channels, channels)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.bias = nn.Parameter(torch.zeros(heads, radii * radii * angles))
        cells = torch.cartesian_prod(torch.arange(radii), torch.arange(angles))
        radius, angle = cells.unbind(1)
        turn = (angle[:, None] - angle) % angles
        between = (radius[:, None] * radii + radius) * angles + turn  # (cells, cells)
        self.register_buffer("between", between, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the map ``(B, radii, angles, channels)`` plus what its cells attend to."""
        tokens = self.norm(x).flatten(1, 2)  # (B, cells, channels)
        q, k, v = (
            part.unflatten(2, (self.heads, -1)).transpose(1, 2)
            for part in self.qkv(tokens).chunk(3, dim=2)
        )
        bias = self.bias[:, self.between].to(q.dtype)
        seen = F.scaled_dot_product_attention(q, k, v, attn_mask=bias)
        result: Tensor = x + self.out(seen.transpose(1, 2).flatten(2)).view_as(x)
        return result


class PolarBlock(nn.Module):
    """What mixes the cells of a map, then a perceptron at each: ``x + MLP(N(M(x)))``.

    With a spectral filter it is a filterformer block without attention: filter, layer norm and
    pointwise perceptron (Ye et al., Sensors 2023, 23, 8633, Eq. 1-3; Rao et al., "Global Filter
    Networks", 2021); ``"filterformer"`` is one with attention.

    Args:
        size: ``(radii, angles, channels)`` of the map; an even number of angles.
        mixer: What mixes the cells; attention is a residual sublayer before the others.
        expansion: Width of the perceptron relative to the channels.
    """

    def __init__(
        self, size: tuple[int, int, int], mixer: PolarMixer = "filter", expansion: int = 2
    ) -> None:
        super().__init__()
        channels = size[2]
        attends = mixer in ("attention", "filterformer")
        self.attention = PolarAttention(size) if attends else nn.Identity()
        self.mixer: nn.Module
        match mixer:
            case "depthwise3" | "depthwise7":
                self.mixer = PolarDepthwise(channels, int(mixer[-1]))
            case "attention":
                self.mixer = nn.Identity()
            case _:
                self.mixer = PolarFilter(size)
        self.norm = nn.LayerNorm(channels)
        self.up = nn.Linear(channels, expansion * channels)
        self.down = nn.Linear(expansion * channels, channels)
        nn.init.normal_(self.down.weight, std=0.02)
        nn.init.zeros_(self.down.bias)

    def forward(self, x: Tensor) -> Tensor:
        """Return the map ``(B, radii, angles, channels)`` for one of the same shape."""
        x = self.attention(x)
        cells = self.norm(self.mixer(x)).flatten(0, 2)  # rows: a graph has one Gemm of each Linear
        hidden = self.down(F.relu(self.up(cells), inplace=True))
        return x + torch.unflatten(hidden, 0, (-1, *x.shape[1:3]))


def half_turned(x: Tensor, dim: int) -> Tensor:
    """Return a map whose angles, axis ``dim``, are shifted by half a turn."""
    half = x.shape[dim] // 2  # not `roll`, which on CUDA gives up channels last
    return torch.cat((x.narrow(dim, half, half), x.narrow(dim, 0, half)), dim=dim)


def through_origin(x: Tensor, radii: int) -> Tensor:
    """Continue a map ``(B, R, A, C)`` to some negative radii: ``(B, radii + R, A, C)``."""
    return torch.cat((half_turned(x[:, :radii].flip(1), 2), x), dim=1)


def interpolation(at: Tensor, to: Tensor, highest: int | None = None) -> Tensor:
    """Return the matrix ``(to, at)`` of the Fourier series through values at equal angles ``at``.

    Angles are in radians. The series goes up to the ``highest`` frequency, by default all but the
    highest of an even number of values, whose phase they do not determine.
    """
    count = len(at)
    highest = (count - 1) // 2 if highest is None else highest
    orders = torch.arange(-highest, highest + 1)
    return torch.cos(orders * (to[:, None, None] - at[:, None])).sum(-1) / count
