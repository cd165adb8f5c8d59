"""Fractal noise in three dimensions: smooth, seamless on a sphere, the same on every run.

Value noise on a periodic lattice (Perlin's smoothed interpolation), summed over octaves that are
turned against each other so that the lattice does not show.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ffpose.render.vectors import Floats, rotate

LATTICE = 64
"""Period of the noise along each axis, in lattice cells."""

BLOCK = 8192
"""Points computed at once: their temporaries stay in the processor's cache."""

# A rotation about (1, 1, 1) times a lacunarity of a little under two.
_ROTATION = 1.97 * np.array(
    [[0.7887, -0.2113, 0.5774], [0.5774, 0.7887, -0.2113], [-0.2113, 0.5774, 0.7887]]
)


@lru_cache(maxsize=1)
def _lattice() -> NDArray[np.complex64]:
    """The random values, each with the step to the next along z as its imaginary part.

    One look-up fetches both ends of a cell's edge, which halves the cost of the noise.
    """
    values = np.random.default_rng(8633).uniform(-1.0, 1.0, (LATTICE,) * 3)
    return (values + 1j * (np.roll(values, -1, axis=2) - values)).astype(np.complex64).reshape(-1)


def fbm(points: Floats, octaves: int, gain: float = 0.5) -> Floats:
    """Sum of `octaves` of noise, each of about twice the frequency and `gain` times the height.

    Args:
        points: (3, N) float32; one unit is one lattice cell of the first octave.
        octaves: how many, at least 1.
        gain: ratio of successive amplitudes.

    Returns:
        (N,) float32, scaled to lie within −1…1 (most of it within ±0.5).
    """
    count = points.shape[1]
    out = np.empty(count, dtype=np.float32)
    for start in range(0, count, BLOCK):
        out[start : start + BLOCK] = _fbm_block(points[:, start : start + BLOCK], octaves, gain)
    return out


def _fbm_block(points: Floats, octaves: int, gain: float) -> Floats:
    total = value_noise(points)
    amplitude, height = 1.0, 1.0
    for _ in range(1, octaves):
        points = rotate(_ROTATION, points) + np.float32(17.3)
        height *= gain
        amplitude += height
        total += np.float32(height) * value_noise(points)
    total *= np.float32(1 / amplitude)
    return total


def value_noise(points: Floats) -> Floats:
    """One octave: (3, N) float32 points to (N,) values in −1…1."""
    cell = np.floor(points)
    weight = points - cell
    weight *= weight * (3.0 - 2.0 * weight)
    low = cell.astype(np.int32) & (LATTICE - 1)
    high = (low[:2] + 1) & (LATTICE - 1)
    x0, x1 = low[0] * LATTICE**2, high[0] * LATTICE**2
    y0, y1 = low[1] * LATTICE + low[2], high[1] * LATTICE + low[2]
    table = _lattice()
    near, far = table.take(x0 + y0), table.take(x1 + y0)
    near += (table.take(x0 + y1) - near) * weight[1]
    far += (table.take(x1 + y1) - far) * weight[1]
    far -= near
    far *= weight[0]
    near += far
    result: Floats = near.real + near.imag * weight[2]
    return result
