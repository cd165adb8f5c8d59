"""The contenders: our filter, and its rivals written as their users would write them.

All contenders of a case get the same data, those of `FIRST` with the channels first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from benchmarks.filter.cases import (
    CHANNELS_FIRST,
    COMPILED,
    COPY,
    HALF,
    MATRICES,
    SCIPY,
    Case,
)
from benchmarks.timing import Contender
from ffpose.bench.filter import DIMS, OURS, Filter, Kind, our_filter, torch_filter

FIRST = (CHANNELS_FIRST, COMPILED)
"""Contenders whose grids and sequences have their channels first."""


@dataclass(frozen=True)
class Inputs:
    """Inputs: ``x (batch, *size)``, ``grad`` of that shape, ``weight (*half spectrum, 2)``."""

    x: Tensor
    grad: Tensor
    weight: Tensor

    @classmethod
    def of(cls, case: Case) -> Inputs:
        """Draw normal random inputs for ``case``, the same for each contender."""
        generator = torch.Generator().manual_seed(0)
        dim = DIMS[case.kind][-1]
        spectrum = list(case.size)
        spectrum[dim] = spectrum[dim] // 2 + 1
        x, grad = (torch.randn(case.batch, *case.size, generator=generator) for _ in range(2))
        return cls(x, grad, torch.randn(*spectrum, 2, generator=generator))


def contenders(case: Case) -> dict[str, Contender]:
    """Return the contenders of ``case``, ready to be called."""
    inputs = Inputs.of(case)
    return {name: _contender(name, case, inputs) for name in case.contenders}


def _contender(name: str, case: Case, inputs: Inputs) -> Contender:
    x, weight, grad = inputs.x, inputs.weight.clone(), inputs.grad
    if _is_first(name, case.kind):
        x, grad = (each.movedim(-1, 1).contiguous() for each in (x, grad))
        weight = weight.movedim(-2, 0).contiguous()
    if name == COPY:
        y = torch.empty_like(x)
        return Contender(lambda: y.copy_(x))
    if name == SCIPY:
        return Contender(_scipy_call(case, x, weight))
    if name == HALF:
        x, grad = x.bfloat16(), grad.bfloat16()
        return _contender_of(partial(our_filter, kind=case.kind), x, weight, grad, case)
    return _contender_of(_filter(name, case), x, weight, grad, case)


def _is_first(name: str, kind: Kind) -> bool:
    return name in FIRST and kind != "tokens"


def in_our_layout(name: str, case: Case, results: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Return a contender's results with the channels last: ``x``-like first, then ``weight``-like.

    Args:
        name: The contender.
        case: Its case.
        results: The filtered images, or the gradients of images and weight.
    """
    if not _is_first(name, case.kind):
        return tuple(results)
    places = ((1, -1), (0, -2))
    return tuple(each.movedim(*place) for each, place in zip(results, places, strict=False))


def _filter(name: str, case: Case) -> Filter:
    if name == OURS:
        return partial(our_filter, kind=case.kind)
    if name == MATRICES:
        return MatrixFilter(case.kind, *case.plane)
    dim = [place + _is_first(name, case.kind) for place in DIMS[case.kind]]

    def plain(x: Tensor, weight: Tensor) -> Tensor:
        return torch_filter(x, weight, dim)

    return torch.compile(plain, dynamic=False) if name == COMPILED else plain


def _contender_of(
    function: Filter, x: Tensor, weight: Tensor, grad: Tensor, case: Case
) -> Contender:
    """Return the contender that runs one call; `measure` sets whether gradients are recorded."""
    if case.work == "forward":
        return Contender(lambda: function(x, weight))
    x.requires_grad_()
    weight.requires_grad_()
    if case.work == "recorded":
        return Contender(lambda: function(x, weight).detach())
    return Contender(
        lambda: torch.autograd.grad(function(x, weight), (x, weight), grad),
        # As an optimizer's step would: a weight prepared for the last call is out of date.
        prepare=lambda: weight.data.neg_(),
    )


def _scipy_call(case: Case, x: Tensor, weight: Tensor) -> Callable[[], Any]:
    from scipy import fft

    dim = DIMS[case.kind]
    array, spectrum = x.detach().numpy(), torch.view_as_complex(weight).numpy()
    size = [array.shape[d] for d in dim]

    def call() -> Any:
        product = fft.rfftn(array, axes=dim, workers=case.threads) * spectrum
        return fft.irfftn(product, s=size, axes=dim, workers=case.threads)

    return call


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
