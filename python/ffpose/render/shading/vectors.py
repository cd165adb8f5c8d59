"""Vector algebra on float32 arrays with one row per component.

Sums are written out, because BLAS may round differently with another number of threads and the same
arguments must give the same bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float32]


def column(values: ArrayLike) -> Floats:
    """Return K values as a float32 column (K, 1), which broadcasts with (K, N)."""
    return np.asarray(values, dtype=np.float32).reshape(-1, 1)


def dot(first: ArrayLike, second: Floats) -> Floats:
    """Return the dot products (N,) of the columns of (3, N), or of one (3,), with (3, N)."""
    a, b, c = np.asarray(first, dtype=np.float32)
    return np.asarray(a * second[0] + b * second[1] + c * second[2])


def rotate(matrix: NDArray[np.float64], vectors: Floats) -> Floats:
    """Multiply vectors (3, N) by a matrix (3, 3)."""
    return np.stack([dot(row, vectors) for row in matrix])


def unit(vectors: Floats) -> Floats:
    """Scale vectors (3, N) to length one; zero stays zero."""
    length: Floats = np.sqrt(dot(vectors, vectors))
    length += np.float32(1e-12)
    return np.divide(vectors, length, dtype=np.float32)
