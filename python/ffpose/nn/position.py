"""Position encodings for the tokens of a grid: half of the channels for the row, half the column.

A token's encoding is the concatenation of those of its row and its column, as in DETR and in the
multi-scene transformer that the paper builds on (reference 36).
"""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor, nn

from ffpose._internal.choices import PositionKind
from ffpose.errors import expect, expect_shape

LEARNED_STD = 0.02
LONGEST_WAVE = 10_000.0  # Vaswani et al., 2017, section 3.5


class PositionCode(nn.Module):
    """Position encoding added to each token of a grid.

    Args:
        grid: Rows and columns.
        dim: Number of channels of a token.
        kind: ``"learned"`` or ``"sinusoidal"``.

    Raises:
        ValueError: ``kind`` is unknown, or ``dim`` is not divisible by 2, sinusoidal by 4.
    """

    rows: Tensor
    columns: Tensor

    def __init__(self, grid: tuple[int, int], dim: int, kind: PositionKind = "learned") -> None:
        super().__init__()
        kinds = get_args(PositionKind)
        expect(kind in kinds, "kind", f"one of {kinds}", kind)
        divisor = 2 if kind == "learned" else 4
        expect(dim % divisor == 0, "dim", f"a multiple of {divisor} for the {kind} code", dim)
        self.grid, self.dim, self.kind = grid, dim, kind
        for name, length in zip(("rows", "columns"), grid, strict=True):
            if kind == "learned":
                code = nn.Parameter(torch.randn(length, dim // 2) * LEARNED_STD)
                self.register_parameter(name, code)
            else:
                self.register_buffer(name, sinusoids(length, dim // 2), persistent=False)

    def forward(self, tokens: Tensor) -> Tensor:
        """Return ``tokens (B, rows * columns, dim)`` with the encoding added.

        Raises:
            ValueError: ``tokens`` is not ``(B, rows * columns, dim)``.
        """
        rows, columns = self.grid
        expect_shape("tokens", tokens, rows * columns, self.dim)
        by_row = self.rows[:, None].expand(-1, columns, -1)
        by_column = self.columns[None].expand(rows, -1, -1)
        return tokens + torch.cat((by_row, by_column), dim=-1).flatten(0, 1)

    def extra_repr(self) -> str:
        """Return the arguments shown in the representation."""
        return f"{self.grid}, {self.dim}, kind={self.kind!r}"


def sinusoids(length: int, dim: int) -> Tensor:
    """Return the sinusoidal encoding ``(length, dim)`` of the positions 0 ... length - 1.

    Vaswani et al., "Attention Is All You Need", 2017, section 3.5; all sines first, then the
    cosines.
    """
    exponents = torch.arange(0, dim, 2) / dim
    angles = torch.arange(length)[:, None] * LONGEST_WAVE**-exponents
    return torch.cat((angles.sin(), angles.cos()), dim=1)
