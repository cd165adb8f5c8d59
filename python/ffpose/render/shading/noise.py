"""Three-dimensional fractal noise, with the same values on every machine."""

from __future__ import annotations

import numpy as np

from ffpose.arrays import fractal_noise
from ffpose.render.shading.vectors import Floats


def fbm(points: Floats, octaves: int, gain: float = 0.5) -> Floats:
    """Sum octaves of noise, each at about twice the frequency and `gain` times the amplitude.

    Args:
        points: (3, N) float32; the first octave has its lattice points 1 apart.
        octaves: Number of octaves, at least 1.
        gain: Ratio of successive amplitudes.

    Returns:
        (N,) float32, scaled to lie within −1…1 (most of it within ±0.5).
    """
    heights = gain ** np.arange(octaves)
    return fractal_noise(points, (heights / heights.sum()).astype(np.float32))
