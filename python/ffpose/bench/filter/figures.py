"""Quantities derived from timings: means, nominal operations, memory traffic."""

from __future__ import annotations

import math
from collections.abc import Iterable

from ffpose.bench.filter.cases import Case

FLOAT = 4


def geometric_mean(values: Iterable[float]) -> float:
    """Return the geometric mean of positive ratios.

    >>> geometric_mean([2.0, 8.0])
    4.0
    """
    logarithms = [math.log2(value) for value in values]
    return math.exp2(sum(logarithms) / len(logarithms))


def operations(case: Case) -> float:
    """Return the nominal operations of a call, by the convention of FFT benchmarks.

    A transform of N real points counts as ``2.5 N log2 N``, regardless of the algorithm, and a
    complex product as 6. A forward is two transforms and one product for each element of the half
    spectrum; a backward is two more transforms (recomputation is not counted), one product for x,
    and one with a sum (8) for the weight.
    """
    rows, columns, channels = case.plane
    images = case.batch * channels
    points, spectrum = rows * columns, rows * (columns // 2 + 1)
    transform = 2.5 * points * math.log2(points) if points > 1 else 0.0
    if case.work == "forward+backward":
        return images * (4 * transform + (6 + 6 + 8) * spectrum)
    return images * (2 * transform + 6 * spectrum)


def traffic(case: Case) -> int:
    """Return the least bytes that a call moves: inputs read once, results written once.

    Forward: x, weight and y. Forward+backward: for the backward also the gradient, x and weight
    again, and both gradients.
    """
    rows, columns, channels = case.plane
    image = FLOAT * case.batch * rows * columns * channels
    weight = FLOAT * 2 * rows * (columns // 2 + 1) * channels
    if case.work == "forward+backward":
        return 5 * image + 3 * weight
    return 2 * image + weight
