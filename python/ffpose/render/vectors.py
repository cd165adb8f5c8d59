"""Small vector algebra on float32 arrays that hold one row for each component.

Sums are written out: BLAS may round differently with another number of threads, and the same
arguments must give the same bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float32]


def column(values: ArrayLike) -> Floats:
    """(K,) numbers as float32 (K, 1), to stand beside (K, N)."""
    result: Floats = np.asarray(values, dtype=np.float32).reshape(-1, 1)
    return result


def dot(first: ArrayLike, second: Floats) -> Floats:
    """Products (N,) of the columns of (3, N), or of one vector (3,), with those of (3, N)."""
    a, b, c = np.asarray(first, dtype=np.float32)
    result: Floats = a * second[0] + b * second[1] + c * second[2]
    return result


def rotate(matrix: NDArray[np.float64], vectors: Floats) -> Floats:
    """(3, 3) matrix times (3, N)."""
    return np.stack([dot(row, vectors) for row in matrix])


def unit(vectors: Floats) -> Floats:
    """(3, N) scaled to length one; zero stays zero."""
    length: Floats = np.sqrt(dot(vectors, vectors))
    length += np.float32(1e-12)
    return np.divide(vectors, length, dtype=np.float32)


def smoothstep(values: Floats, low: float, high: float) -> Floats:
    """0 below `low`, 1 above `high`, smooth between."""
    part = np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)
    result: Floats = part * part * (3 - 2 * part)
    return result
