"""The spectral filter as products with real matrices, for runtimes without its operator.

``y = irfft2(rfft2(x) * W)`` in five steps, each a matrix product or a product of numbers. Complex
numbers are pairs on an axis of their own; a complex matrix ``A + iB`` becomes the real block matrix
``[[A, -B], [B, A]]``.

1. Columns: the real DFT over Y, half of the spectrum.
2. Rows: the complex DFT over X, in one product or, where that is cheaper, in two (Cooley and Tukey,
   1965): with ``X = N1 N2``, ``n = N2 n1 + n2`` and ``k = k1 + N1 k2``,

       exp(-2πi nk/X) = exp(-2πi n1 k1/N1) · exp(-2πi n2 (k1/X + k2/N2)),

   first over n1, then over n2 by a matrix of its own for each k1, which holds the twiddles.
3. The weight: real and imaginary part by ``[Wr, -Wi]`` for the real and ``[Wi, Wr]`` for the
   imaginary part of the result; their sums are left to the next matrix.
4. Rows back, 5. columns back, real. The sine of frequency zero and of Nyquist is zero on every
   sample, so that their columns act by their Hermitian part, as in irfft2; the norm is in here.

The axes stand such that only step 5 needs a transpose. All matrices are computed in float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

PASS_COST = 64
"""Multiplications that take as long as bringing a number from the cache and back."""


class FilterMatrices(NamedTuple):
    """The constants of a filter; where `split` is ``(1, X)``, the first and last are None.

    Attributes:
        split: ``(N1, N2)``.
        columns: Step 1, ``(2, Y, Y//2+1)``.
        outer: Step 2, ``(2 N1, 2 N1)``: from (re/im, n1) to (k1, re/im).
        inner: Step 2, ``(N1, 2 N2, 2 N2)``: for each k1 from (re/im, n2) to (re/im, k2).
        inner_back: Step 4, ``(N1, 2 N2, 4 N2)``: for each k1 from (re/im of the result, re/im, k2)
            to (re/im, n2).
        outer_back: Step 4, ``(2 N1, 2 N1)``: from (k1, re/im) to (re/im, n1).
        columns_back: Step 5, ``(2 (Y//2+1), Y)``: from (re/im, frequency).
    """

    split: tuple[int, int]
    columns: Array
    outer: Array | None
    inner: Array
    inner_back: Array
    outer_back: Array | None
    columns_back: Array


def filter_matrices(rows: int, columns: int) -> FilterMatrices:
    """Return the matrices for a DFT over ``(rows, columns)``, float64."""
    n1, n2 = split = best_split(rows)
    k1, k2 = np.arange(n1), np.arange(n2)
    inner_phase = k2 * (k1[:, None, None] / rows + k2[:, None] / n2)  # (k1, k2, n2)
    inner = _block(_wave(-inner_phase))
    back = _block(_wave(inner_phase.swapaxes(1, 2)))  # (k1, re/im n2, re/im k2)
    real, imaginary = np.split(back, 2, axis=-1)
    outer_phase = np.outer(k1, k1) / n1
    by_pair = np.arange(2 * n1).reshape(2, n1).T.ravel()  # (k1, re/im) out of (re/im, k1)
    return FilterMatrices(
        split,
        _columns_forward(columns),
        None if n1 == 1 else _block(_wave(-outer_phase))[by_pair],
        inner,
        np.concatenate([real, real, imaginary, imaginary], axis=-1),
        None if n1 == 1 else _block(_wave(outer_phase))[:, by_pair],
        _columns_back(rows, columns),
    )


def filter_factors(weight: Array, split: tuple[int, int]) -> Array:
    """Return step 3's factors ``(N1, 2, 2 N2, ...)`` of a weight ``(X, ..., 2)``.

    The axes: k1, re/im of the result, (re/im, k2), and what the weight has after the rows.
    """
    n1, n2 = split
    w = np.moveaxis(np.asarray(weight), -1, 0)
    by_residue = w.reshape(2, n2, n1, *w.shape[2:]).swapaxes(1, 2)  # (2, k1, k2, ...)
    real, imaginary = by_residue
    return np.stack(
        [np.concatenate([real, -imaginary], 1), np.concatenate([imaginary, real], 1)], axis=1
    )


def best_split(rows: int) -> tuple[int, int]:
    """Return the cheapest ``(N1, N2)`` with product ``rows``; ``(1, rows)`` is a dense DFT.

    It costs multiplications for each row, both ways, and those for the outer matrices and passes.
    """
    splits = ((n, rows // n) for n in range(1, rows + 1) if rows % n == 0)
    return min(splits, key=lambda s: 12 * s[1] + (8 * s[0] + 2 * PASS_COST if s[0] > 1 else 0))


def _wave(turns: Array) -> Array:
    """Return ``exp(2πi turns)``."""
    wave: Array = np.exp(2j * np.pi * turns)
    return wave


def _block(matrix: Array) -> Array:
    """Return ``[[A, -B], [B, A]]`` of complex matrices ``A + iB (..., m, n)``."""
    a, b = matrix.real, matrix.imag
    rows = [np.concatenate([a, -b], -1), np.concatenate([b, a], -1)]
    return np.concatenate(rows, -2)


def _columns_forward(columns: int) -> Array:
    """Return step 1's matrices, ``(2, Y, Y//2+1)``."""
    turns = np.outer(np.arange(columns), np.arange(columns // 2 + 1)) % columns / columns
    wave = _wave(-turns)
    return np.stack([wave.real, wave.imag])


def _columns_back(rows: int, columns: int) -> Array:
    """Return step 5's matrix, ``(2 (Y//2+1), Y)``, with the norm of both axes."""
    half = columns // 2 + 1
    turns = np.outer(np.arange(half), np.arange(columns)) % columns / columns
    wave = _wave(turns)
    lone = (np.arange(half) * 2) % columns == 0  # zero and Nyquist have no conjugate partner
    share = np.where(lone, 1.0, 2.0)[:, None] / (rows * columns)
    return np.concatenate([wave.real * share, np.where(lone[:, None], 0.0, -wave.imag * share)])
