"""The filterformer: a transformer encoder with a spectral filter before each self-attention.

Ye et al., Sensors 2023, 23, 8633, section 3.1 and Figure 4. A block is three residual sublayers:
filter, multi-head attention, feed-forward. Two things the paper leaves open are read so:

* Normalisation stands before each sublayer (``norm="pre"``), and once after the last block.
  ``"post"`` is the original transformer's order.
* A pose token, which joins the tokens to gather the answer, is kept out of the filter: it has no
  place in the grid, and the number of tokens with it (197) is prime.
"""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor, nn
from torch.nn.functional import linear, scaled_dot_product_attention

from ffpose.choices import FilterKind, NormPlace
from ffpose.nn.spectral import INIT_STD, SpectralFilter

FILTERS: tuple[FilterKind, ...] = get_args(FilterKind)


def make_filter(
    kind: FilterKind, grid: tuple[int, int], dim: int, *, std: float = INIT_STD
) -> nn.Module | None:
    """Build the filter for tokens ``(B, rows * columns, dim)``.

    Args:
        kind: ``"tokens"``: the paper's equations, a DFT over tokens and channels. ``"grid"``: the
            reading of GFNet, a DFT over rows and columns for each channel. ``"none"``: no filter,
            which makes the network the paper's TransformerPose (Table 3).
        grid: ``(rows, columns)``.
        dim: Channels.
        std: Of the filter's weight at the start.

    Raises:
        ValueError: An unknown kind.
    """
    rows, columns = grid
    match kind:
        case "tokens":
            return SpectralFilter((rows * columns, dim), "tokens", std=std)
        case "grid":
            return nn.Sequential(
                nn.Unflatten(1, grid),
                SpectralFilter((rows, columns, dim), "grid", std=std),
                nn.Flatten(1, 2),
            )
        case "none":
            return None
        case _:
            raise ValueError(f"filter: expected one of {FILTERS}, got {kind!r}")


class SelfAttention(nn.Module):
    """Multi-head attention of tokens to themselves (Eq. 4-6).

    ``attention`` holds the parameters, starts them, and would give the same numbers. What it runs
    in evaluation on CPUs writes all ``N x N`` scores to memory; ours goes through them in blocks.
    So it does in training, unless it drops weights: torch has no kernel for that on CPUs, and both
    then write all scores, which makes a step of ``base`` four times as long.

    Args:
        dim: Channels.
        heads: Number of heads; divides ``dim``.
        dropout: Of the attention weights.
    """

    def __init__(self, dim: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.attention = nn.MultiheadAttention(dim, heads, dropout=dropout, batch_first=True)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, N, dim)`` for ``x (B, N, dim)``."""
        batch, count, _ = x.shape
        parts = linear(x, self.attention.in_proj_weight, self.attention.in_proj_bias)
        parts = parts.view(batch, count, 3, self.attention.num_heads, self.attention.head_dim)
        query, key, value = parts.permute(2, 0, 3, 1, 4)  # each (B, heads, N, dim / heads)
        dropout = self.attention.dropout if self.training else 0.0
        mixed = scaled_dot_product_attention(query, key, value, dropout_p=dropout)
        result: Tensor = self.attention.out_proj(mixed.transpose(1, 2).flatten(2))
        return result


class Residual(nn.Module):
    """A sublayer with its skip connection, normalisation and dropout.

    Args:
        sublayer: Keeps the shape of its input.
        dim: Channels.
        dropout: Of the sublayer's result.
        norm: ``"pre"``: ``x + f(norm(x))``; ``"post"``: ``norm(x + f(x))``.
    """

    def __init__(self, sublayer: nn.Module, dim: int, dropout: float, norm: NormPlace) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(dim)
        self.sublayer = sublayer
        self.dropout = nn.Dropout(dropout)
        self.norm_first = norm == "pre"

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, N, dim)`` for ``x (B, N, dim)``."""
        if self.norm_first:
            change: Tensor = self.dropout(self.sublayer(self.norm(x)))
            return x + change
        result: Tensor = self.norm(x + self.dropout(self.sublayer(x)))
        return result


class FilterformerBlock(nn.Module):
    """One block: filter, multi-head attention, feed-forward.

    Args:
        dim: Channels.
        filter: Takes and gives ``(B, N, dim)``; None leaves the sublayer out.
        heads: Attention heads.
        hidden: Width of the feed-forward network.
        dropout: Of each sublayer's result, the attention weights and the hidden layer.
        norm: Where the sublayers normalise.
        extra_tokens: How many tokens at the front pass the filter by.
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
    ) -> None:
        super().__init__()
        feed_forward = nn.Sequential(
            nn.Linear(dim, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, dim)
        )
        self.extra_tokens = extra_tokens
        self.filter = None if filter is None else Residual(filter, dim, dropout, norm)
        self.attention = Residual(SelfAttention(dim, heads, dropout), dim, dropout, norm)
        self.feed_forward = Residual(feed_forward, dim, dropout, norm)

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, extra_tokens + N, dim)`` for an ``x`` of that shape."""
        if self.filter is not None:
            extra, tokens = x[:, : self.extra_tokens], x[:, self.extra_tokens :]
            x = torch.cat((extra, self.filter(tokens)), dim=1)
        result: Tensor = self.feed_forward(self.attention(x))
        return result


class Filterformer(nn.Module):
    """The encoder: blocks of one kind, each with its own filter, and a last normalisation.

    Args:
        grid: ``(rows, columns)`` of the feature map that the tokens come from.
        dim: Channels.
        depth: Number of blocks, N in the paper (Table 2).
        filter: ``"tokens"``, ``"grid"`` or ``"none"``, see `make_filter`.
        filter_std: Of the filters' weights at the start.
        heads: Attention heads; divides ``dim``.
        hidden: Width of the feed-forward networks.
        dropout: See `FilterformerBlock`.
        norm: ``"pre"`` or ``"post"``.
        extra_tokens: How many tokens stand before those of the grid.

    Raises:
        ValueError: An unknown choice, or heads that do not divide ``dim``.
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
    ) -> None:
        super().__init__()
        if norm not in get_args(NormPlace):
            raise ValueError(f"norm: expected one of {get_args(NormPlace)}, got {norm!r}")
        if dim % heads:
            raise ValueError(f"heads: expected a divisor of dim {dim}, got {heads}")
        self.length = extra_tokens + grid[0] * grid[1]
        self.dim = dim
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
                )
                for _ in range(depth)
            )
        )
        self.norm = nn.LayerNorm(dim) if norm == "pre" else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, extra_tokens + rows * columns, dim)`` for an ``x`` of that shape.

        Raises:
            ValueError: ``x`` has another shape.
        """
        if x.dim() != 3 or x.shape[1:] != (self.length, self.dim):
            raise ValueError(
                f"x: expected shape (B, {self.length}, {self.dim}), got {tuple(x.shape)}"
            )
        result: Tensor = self.norm(self.blocks(x))
        return result
