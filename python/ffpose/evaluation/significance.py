"""Statistical significance: bootstrap intervals of medians, and correlations of angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffpose.geometry import FloatArray

RESAMPLES = 5000
CONSTANT_RAD = 1e-6
"""RMS deviation in radians up to which angles count as constant and have no correlation."""


def median_interval(values: ArrayLike) -> tuple[float, float]:
    """Return a median's 95 % percentile bootstrap interval (Efron and Tibshirani, 1993, ch. 13).

    Resampled medians are drawn directly: the k-th smallest of N draws with replacement is the
    sorted value number ``floor(N u)``, where ``u``, the k-th smallest of N uniform numbers, is
    distributed as Beta(k, N + 1 - k).

    Raises:
        ValueError: ``values`` is not ``(N,)``, is empty or not finite.
    """
    ordered = np.sort(np.asarray(values, np.float64))
    if ordered.ndim != 1 or len(ordered) == 0 or not np.isfinite(ordered).all():
        raise ValueError(f"values: expected finite numbers (N,), N > 0, got shape {ordered.shape}")
    rng, count = np.random.default_rng(0), len(ordered)
    k = (count + 1) // 2
    lower = rng.beta(k, count + 1 - k, RESAMPLES)
    upper = lower
    if count % 2 == 0:  # the least of the other N - k, uniform above the k-th
        upper = lower + (1 - lower) * rng.beta(1, count - k, RESAMPLES)
    places = np.minimum(count * np.stack([lower, upper]), count - 1).astype(np.intp)
    medians = ordered[places].mean(axis=0)
    low, high = np.quantile(medians, [0.025, 0.975])
    return float(low), float(high)


def circular_correlation(a_deg: ArrayLike, b_deg: ArrayLike) -> float | None:
    """Return the correlation, -1 to 1, of angles ``(N,)`` in degrees; None if one is constant.

    ``sum(sin(a - a0) sin(b - b0)) / sqrt(sum(sin²(a - a0)) sum(sin²(b - b0)))`` with the mean
    directions ``a0`` and ``b0`` (Jammalamadaka and SenGupta, 2001, section 8.2). For small angles
    it is Pearson's.
    """
    return _correlation(*(np.sin(_from_mean(np.radians(each))) for each in (a_deg, b_deg)))


def correlation(a_deg: ArrayLike, b_deg: ArrayLike) -> float | None:
    """Return Pearson's correlation of angles that do not wrap; else as `circular_correlation`."""
    return _correlation(*(angle - angle.mean() for angle in map(np.radians, (a_deg, b_deg))))


def _from_mean(angle: FloatArray) -> FloatArray:
    """Return angles minus their mean direction, radians."""
    mean = np.arctan2(np.sin(angle).sum(), np.cos(angle).sum())
    return np.asarray(angle - mean)


def _correlation(a: FloatArray, b: FloatArray) -> float | None:
    spread = [np.sqrt((x * x).mean()) for x in (a, b)]
    if min(spread) < CONSTANT_RAD:
        return None
    return float((a * b).mean() / (spread[0] * spread[1]))
