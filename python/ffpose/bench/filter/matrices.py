"""The filter as matrix products, as it is exported to runtimes without an FFT."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ffpose.bench.filter.cases import Kind

LARGEST_SIDE = 256
"""Largest side measured; beyond it the matrices are larger than the data."""


def fits(plane: tuple[int, int, int]) -> bool:
    """Return whether rows and columns are few enough for matrices."""
    return max(plane[:2]) <= LARGEST_SIDE


class MatrixFilter:
    """The filter ``irfft2(rfft2(x) * W)`` as four products with real matrices.

    Nothing is transposed: real and imaginary parts are a dimension of their own,
    ``(H, 2, W//2+1, C)``, which lies before the half spectrum's columns for the transform of the
    rows and after the rows for that of the columns.

    Args:
        kind: ``"grid"``, ``"tokens"`` or ``"sequence"``.
        rows: H, one for a sequence.
        columns: W.
        channels: C, one for tokens.
    """

    def __init__(self, kind: Kind, rows: int, columns: int, channels: int) -> None:
        half = columns // 2 + 1
        self.rows, self.columns, self.channels, self.half = rows, columns, channels, half
        self.kind = kind
        angle = _angles(columns)[:half]
        copies = torch.full((half, 1), 2.0, dtype=torch.float64)
        copies[0] = 1
        if columns % 2 == 0:
            copies[-1] = 1
        self.along = torch.cat([angle.cos(), -angle.sin()]).float()  # (2 half, W)
        back = torch.cat([copies * angle.cos(), -copies * angle.sin()]) / columns
        self.along_back = back.T.float().contiguous()  # (W, 2 half)
        self.across = _complex_matrix(_angles(rows), -1.0)  # (2 H, 2 H)
        self.across_back = _complex_matrix(_angles(rows), 1.0) / rows

    def __call__(self, x: Tensor, weight: Tensor) -> Tensor:
        """Filter ``x (B, *size)`` by ``weight (*half spectrum, 2)``, real and imaginary parts."""
        if self.kind == "tokens":
            spectrum = x @ self.along.T  # (B, H, 2 half)
        else:
            spectrum = self.along @ x.view(-1, self.rows, self.columns, self.channels)
        spectrum = self._across(self.across, spectrum)
        z = spectrum.view(-1, self.rows, 2, self.half * self.channels)
        w = weight.view(self.rows, self.half * self.channels, 2)
        re, im = z.unbind(2)
        product = torch.stack(
            (re * w[..., 0] - im * w[..., 1], re * w[..., 1] + im * w[..., 0]), dim=2
        )
        product = self._across(self.across_back, product)
        if self.kind == "tokens":
            return product.view(-1, self.rows, 2 * self.half) @ self.along_back.T
        y = self.along_back @ product.view(-1, self.rows, 2 * self.half, self.channels)
        return y.view(x.shape)

    def _across(self, matrix: Tensor, spectrum: Tensor) -> Tensor:
        if self.rows == 1:
            return spectrum
        return matrix @ spectrum.view(-1, 2 * self.rows, self.half * self.channels)


def _angles(n: int) -> Tensor:
    """Return the angles ``2 pi j k / n``, with ``j k`` reduced modulo n for accuracy."""
    k = torch.arange(n)
    return 2 * math.pi * (torch.outer(k, k) % n).double() / n


def _complex_matrix(angle: Tensor, sign: float) -> Tensor:
    """Return ``exp(sign i angle)`` as a real matrix ``(2n, 2n)`` for interleaved complex values."""
    cos, sin = angle.cos(), sign * angle.sin()
    blocks = torch.stack([torch.stack([cos, -sin], -1), torch.stack([sin, cos], -1)], 1)
    return blocks.reshape(2 * len(angle), 2 * len(angle)).float()
