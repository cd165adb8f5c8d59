"""Fractal noise in three dimensions: smooth, seamless on a sphere, the same on every run."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ffpose.arrays import fractal_noise
from ffpose.render.vectors import Floats

LATTICE = 64
"""Period of the noise along each axis, in lattice cells."""


@lru_cache(maxsize=1)
def lattice() -> Floats:
    """The random values, (LATTICE, LATTICE, LATTICE) float32 in −1…1."""
    values = np.random.default_rng(8633).uniform(-1.0, 1.0, (LATTICE,) * 3)
    return values.astype(np.float32)


def fbm(points: Floats, octaves: int, gain: float = 0.5) -> Floats:
    """Sum of `octaves` of noise, each of about twice the frequency and `gain` times the height.

    Args:
        points: (3, N) float32; one unit is one lattice cell of the first octave.
        octaves: how many, at least 1.
        gain: ratio of successive amplitudes.

    Returns:
        (N,) float32, scaled to lie within −1…1 (most of it within ±0.5).
    """
    heights = gain ** np.arange(octaves)
    return fractal_noise(points, lattice(), (heights / heights.sum()).astype(np.float32))
