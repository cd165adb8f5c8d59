"""Fractal noise in three dimensions: smooth, seamless on a sphere, the same on every machine."""

from __future__ import annotations

import numpy as np

from ffpose.arrays import fractal_noise
from ffpose.render.vectors import Floats


def fbm(points: Floats, octaves: int, gain: float = 0.5) -> Floats:
    """Sum of `octaves` of noise, each of about twice the frequency and `gain` times the height.

    Args:
        points: (3, N) float32; random values are 1 apart in the first octave.
        octaves: how many, at least 1.
        gain: ratio of successive amplitudes.

    Returns:
        (N,) float32, scaled to lie within −1…1 (most of it within ±0.5).
    """
    heights = gain ** np.arange(octaves)
    return fractal_noise(points, (heights / heights.sum()).astype(np.float32))
