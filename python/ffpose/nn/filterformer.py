"""The filterformer: a transformer encoder with a spectral filter before each self-attention.

Ye et al., Sensors 2023, 23, 8633, section 3.1 and Figure 4. A block has three residual sublayers:
filter, multi-head attention, feed-forward. Two details that the paper leaves open are chosen here:

* Normalization precedes each sublayer (``norm="pre"``) and follows the last block; ``"post"`` is
  the order of the original transformer.
* The pose token, which is added to the tokens to collect the result, bypasses the filter: it has no
  position in the grid, and the number of tokens with it (197) is prime.
"""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor, nn

from ffpose._internal.choices import FilterKind, NormPlace
from ffpose.errors import expect, expect_shape
from ffpose.nn.attention import SelfAttention
from ffpose.nn.spectral import INIT_STD, SpectralFilter

FILTERS: tuple[FilterKind, ...] = get_args(FilterKind)


def make_filter(
    kind: FilterKind, grid: tuple[int, int], dim: int, *, std: float = INIT_STD
) -> nn.Module | None:
    """Build the filter for tokens ``(B, rows * columns, dim)`` of a grid.

    Args:
        kind: ``"tokens"``: the paper's equations, a DFT over tokens and channels. ``"grid"``: as in
            GFNet, a DFT over rows and columns for each channel. ``"none"``: no filter, which makes
            the network the paper's TransformerPose (Table 3).
        grid: ``(rows, columns)`` of the feature map.
        dim: Number of channels.
        std: Standard deviation of the initial weight.

    Raises:
        ValueError: ``kind`` is unknown.
    """
    expect(kind in FILTERS, "filter", f"one of {FILTERS}", kind)
    if kind == "none":
        return None
    if kind == "tokens":
        return SpectralFilter((grid[0] * grid[1], dim), "tokens", std=std)
    filter = SpectralFilter((*grid, dim), "grid", std=std)
    return nn.Sequential(nn.Unflatten(1, grid), filter, nn.Flatten(1, 2))


class Residual(nn.Module):
    """A sublayer with skip connection, normalization and dropout.

    ``"pre"``: ``x + f(norm(x))``; ``"post"``: ``norm(x + f(x))``. The sublayer's output has the
    shape of its input, or that of its leading tokens.
    """

    def __init__(self, sublayer: nn.Module, dim: int, dropout: float, norm: NormPlace) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(dim)
        self.sublayer = sublayer
        self.dropout = nn.Dropout(dropout)
        self.norm_first = norm == "pre"

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, N, dim)``, N as the sublayer returns it, for ``x (B, N, dim)``."""
        change: Tensor = self.dropout(self.sublayer(self.norm(x) if self.norm_first else x))
        total = x[:, : change.shape[1]] + change
        result: Tensor = total if self.norm_first else self.norm(total)
        return result


class FilterformerBlock(nn.Module):
    """One block: filter, multi-head attention, feed-forward; arguments as of `Filterformer`.

    ``filter`` maps ``(B, N, dim)`` to the same; None omits the sublayer. Leading ``extra_tokens``
    bypass it; ``outputs`` leading tokens are computed, all with None.
    """

    def __init__(
        self,
        dim: int,
        filter: nn.Module | None,
        *,
        heads: int = 8,
        hidden: int = 256,
        dropout: float = 0.1,
        norm: NormPlace = "pre",
        extra_tokens: int = 0,
        outputs: int | None = None,
    ) -> None:
        super().__init__()
        feed_forward = nn.Sequential(
            nn.Linear(dim, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, dim)
        )
        self.extra_tokens = extra_tokens
        self.filter = None if filter is None else Residual(filter, dim, dropout, norm)
        self.attention = Residual(SelfAttention(dim, heads, dropout, outputs), dim, dropout, norm)
        self.feed_forward = Residual(feed_forward, dim, dropout, norm)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, extra_tokens + N, dim)``, or the outputs, for an ``x`` of that shape."""
        if self.filter is not None:
            extra, tokens = x[:, : self.extra_tokens], x[:, self.extra_tokens :]
            x = torch.cat((extra, self.filter(tokens)), dim=1)
        result: Tensor = self.feed_forward(self.attention(x))
        return result


class Filterformer(nn.Module):
    """The encoder: a stack of `FilterformerBlock` and a final normalization.

    Args:
        grid: ``(rows, columns)`` of the feature map that the tokens come from.
        dim: Number of channels.
        depth: Number of blocks, N in the paper (Table 2).
        filter: ``"tokens"``, ``"grid"`` or ``"none"``, see `make_filter`.
        filter_std: Standard deviation of the filters' initial weights.
        heads: Number of attention heads; divides ``dim``.
        hidden: Width of the feed-forward networks.
        dropout: Dropout rate, as in `FilterformerBlock`.
        norm: ``"pre"`` or ``"post"``.
        extra_tokens: Number of tokens before those of the grid.
        outputs: Number of leading tokens that are returned; None: all. The last block computes no
            others, which gives the same numbers in less time.

    Raises:
        ValueError: ``filter`` or ``norm`` is unknown, ``heads`` does not divide ``dim``, or
            ``outputs`` is not a number of leading tokens.
    """

    def __init__(
        self,
        grid: tuple[int, int],
        dim: int = 256,
        *,
        depth: int = 7,
        filter: FilterKind = "tokens",
        filter_std: float = INIT_STD,
        heads: int = 8,
        hidden: int = 256,
        dropout: float = 0.1,
        norm: NormPlace = "pre",
        extra_tokens: int = 0,
        outputs: int | None = None,
    ) -> None:
        super().__init__()
        expect(norm in get_args(NormPlace), "norm", f"one of {get_args(NormPlace)}", norm)
        expect(dim % heads == 0, "heads", f"a divisor of dim {dim}", heads)
        self.length = extra_tokens + grid[0] * grid[1]
        self.dim = dim
        proper = outputs is None or (depth > 0 and 1 <= outputs <= self.length)
        expected = f"None, or 1 to {self.length} with depth at least 1 (it is {depth})"
        expect(proper, "outputs", expected, outputs)
        self.blocks = nn.Sequential(
            *(
                FilterformerBlock(
                    dim,
                    make_filter(filter, grid, dim, std=filter_std),
                    heads=heads,
                    hidden=hidden,
                    dropout=dropout,
                    norm=norm,
                    extra_tokens=extra_tokens,
                    outputs=outputs if block == depth - 1 else None,
                )
                for block in range(depth)
            )
        )
        self.norm = nn.LayerNorm(dim) if norm == "pre" else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, extra_tokens + rows * columns, dim)``, or the outputs, for that shape.

        Raises:
            ValueError: ``x`` is not ``(B, extra_tokens + rows * columns, dim)``.
        """
        expect_shape("x", x, self.length, self.dim)
        result: Tensor = self.norm(self.blocks(x))
        return result
