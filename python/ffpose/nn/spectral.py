"""Learnable spectral filters: `SpectralFilter`, and `GlobalFilter` with GFNet's interface.

Both compute ``irfft2(rfft2(x) * W)`` by `ffpose.ops.spectral_filter`. GFNet transforms with
``norm="ortho"``; the norms of the two transforms cancel, and so its weights mean the same here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ffpose.ops import Layout, spectral_filter, weight_shape

INIT_STD = 0.02


class SpectralFilter(nn.Module):
    """Multiplies the half spectrum of its input with a learned weight; keeps shape and dtype.

    The paper's filter layer (Ye et al., Sensors 2023, 23, 8633, Eq. 1-3) is layout ``"tokens"``.

    The weight starts as small Gaussian noise rather than as ones: within ``x + filter(norm(x))`` a
    filter near zero leaves a new block near the identity, while ones would double the stream in
    every block.

    Args:
        size: ``(X, Y)`` in layout ``"tokens"``; ``(H, W, C)`` in layout ``"grid"``.
        layout: ``"tokens"`` or ``"grid"``.
        std: Standard deviation of real and imaginary part at the start.
        device: Of the parameter.
        dtype: Of the parameter: float32 or float64. Half precision input takes a float32 weight.

    Attributes:
        weight: Real parameter ``(X, Y//2+1, 2)`` or ``(H, W//2+1, C, 2)``.

    Raises:
        ValueError: An unknown layout, a wrong number of sizes, or a size below one.

    Example:
        >>> filter = SpectralFilter((14, 14, 256), layout="grid")
        >>> filter(torch.zeros(2, 14, 14, 256)).shape
        torch.Size([2, 14, 14, 256])
    """

    def __init__(
        self,
        size: Sequence[int],
        layout: Layout = "tokens",
        *,
        std: float = INIT_STD,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        shape = weight_shape(size, layout)
        if min(size) < 1:
            raise ValueError(f"size: expected each at least 1, got {tuple(size)}")
        self.size = tuple(size)
        self.layout = layout
        self.std = std
        self.weight = nn.Parameter(torch.empty(shape, device=device, dtype=dtype))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draw the weight anew."""
        nn.init.normal_(self.weight, std=self.std)

    def forward(self, x: Tensor) -> Tensor:
        """Filter ``x (..., *size)``; any number of leading dimensions.

        Raises:
            ValueError: The last dimensions are not ``size``, or the device is not the weight's.
            TypeError: The dtype does not go with the weight's.
        """
        if tuple(x.shape[-len(self.size) :]) != self.size:
            sizes = ", ".join(map(str, self.size))
            raise ValueError(f"x: expected shape (..., {sizes}), got {tuple(x.shape)}")
        return spectral_filter(x, self.weight, self.layout)

    def extra_repr(self) -> str:
        """Return what ``print`` shows between the parentheses."""
        return f"{self.size}, layout={self.layout!r}"


class GlobalFilter(nn.Module):
    """Replaces GFNet's class of this name: same arguments, parameter name, forward and numbers.

    Rao et al., "Global Filter Networks for Image Classification", 2021. Other than the original it
    keeps the input's dtype where that is float64 or half precision.

    Args:
        dim: Channels C.
        h: Rows of the grid.
        w: Columns of its half spectrum, ``columns // 2 + 1``.

    Attributes:
        complex_weight: Real parameter ``(h, w, dim, 2)``.

    Raises:
        ValueError: An argument below one.
    """

    def __init__(self, dim: int, h: int = 14, w: int = 8) -> None:
        super().__init__()
        if min(dim, h, w) < 1:
            raise ValueError(f"dim, h, w: expected each at least 1, got {(dim, h, w)}")
        self.dim, self.h, self.w = dim, h, w
        self.complex_weight = nn.Parameter(torch.randn(h, w, dim, 2) * INIT_STD)

    def forward(self, x: Tensor, spatial_size: tuple[int, int] | None = None) -> Tensor:
        """Filter ``x (B, N, C)``, whose tokens are the rows of a grid one after the other.

        Args:
            x: ``(B, N, C)`` with ``C = dim``.
            spatial_size: ``(rows, columns)`` of the grid, with product N; a square when None.

        Returns:
            ``(B, N, C)``.

        Raises:
            ValueError: The shape of ``x`` or the grid fits neither the other nor the weight.
            TypeError: The dtype does not go with the weight's.
        """
        if x.dim() != 3 or x.shape[2] != self.dim:
            raise ValueError(f"x: expected shape (B, N, {self.dim}), got {tuple(x.shape)}")
        rows, columns = spatial_size or (math.isqrt(x.shape[1]),) * 2
        if rows * columns != x.shape[1]:
            raise ValueError(
                f"spatial_size: expected a grid of {x.shape[1]} tokens, got {(rows, columns)}"
            )
        grid = x.reshape(-1, rows, columns, self.dim)
        return spectral_filter(grid, self.complex_weight, "grid").reshape(x.shape)

    def extra_repr(self) -> str:
        """Return what ``print`` shows between the parentheses."""
        return f"{self.dim}, h={self.h}, w={self.w}"
