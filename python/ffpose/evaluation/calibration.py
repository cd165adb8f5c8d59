"""Calibration metrics: how far a network's predicted uncertainty can be trusted.

A network may predict covariances of translation and rotation, and the probability that the object
is in view. The squared Mahalanobis distance ``d² = eᵀ C⁻¹ e`` of errors with a multivariate t
distribution of ``ν`` degrees of freedom and covariance C has a known distribution, ``d² ν / (3 (ν -
2))`` being F-distributed with 3 and ν degrees of freedom; that of Gaussian errors is chi-square
distributed with three. A network may tell two modes of the attitude with their probabilities: its
regions are of both. So the 90 % confidence region of a calibrated network contains 90 % of the
truths (its coverage; over all levels, its reliability). The probability of being in view is
measured as a detector of images that do not show the object.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffpose.errors import expect
from ffpose.evaluation.attitude import rotation_error_vector
from ffpose.geometry import FloatArray
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup

LEVELS = (0.5, 0.9, 0.99)
"""Confidence levels whose coverage is reported."""

CURVE = np.linspace(0.0, 1.0, 21)
"""Confidence levels of a reliability curve."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)
"""Gauss-Legendre quadrature on -1…1, for up to 1000 degrees of freedom exact to 1e-9."""

ASYMMETRY = 1e-5
"""Tolerated asymmetry of a covariance relative to its largest entry, for float32 rounding."""


def squared_mahalanobis(
    error: ArrayLike, covariance: ArrayLike, name: str = "covariance"
) -> FloatArray:
    """Return the squared Mahalanobis distances ``eᵀ C⁻¹ e`` ``(N,)``.

    Args:
        error: Errors ``(N, 3)``.
        covariance: Covariances ``(N, 3, 3)`` of the errors.
        name: What messages call the covariance.

    Raises:
        ValueError: A shape is wrong, a number is not finite, or a covariance is not symmetric and
            positive definite; its row is named.
    """
    e, c = np.asarray(error, np.float64), np.asarray(covariance, np.float64)
    expect(e.ndim == 2 and e.shape[1] == 3, "error", "shape (N, 3)", e.shape)
    expect(c.shape == (len(e), 3, 3), name, f"shape ({len(e)}, 3, 3)", c.shape)
    for values, of in ((e, "error"), (c, name)):
        if not np.isfinite(values).all():
            raise ValueError(f"{of}: expected finite numbers")
    largest = np.abs(c).max(axis=(1, 2))
    asymmetry = np.abs(c - c.transpose(0, 2, 1)).max(axis=(1, 2))
    bad = np.flatnonzero((asymmetry > ASYMMETRY * largest) | (np.linalg.eigvalsh(c)[:, 0] <= 0))
    if len(bad):
        raise ValueError(
            f"{name}: expected symmetric, positive definite matrices, got {c[bad[0]].tolist()} in"
            f" row {bad[0]}"
        )
    return np.asarray((e * np.linalg.solve(c, e[..., None])[..., 0]).sum(axis=1))


def region_probability(
    squared_distance: ArrayLike, degrees_of_freedom: float | None = None
) -> FloatArray:
    """Return the probability ``(N,)`` of the smallest confidence region that contains each truth.

    For a calibrated network its values are uniform in 0…1. For Gaussian errors it is the chi-square
    distribution function for three degrees of freedom, ``erf(sqrt(x / 2)) - sqrt(2 x / pi) exp(-x /
    2)``. For errors of a t distribution with covariance C and ν degrees of freedom, above 2, it is
    that of F for 3 and ν at ``x ν / (3 (ν - 2))``, ``2 / B(3 / 2, ν / 2)`` times the integral of
    ``sin² a cos^(ν - 1) a`` from zero to ``atan sqrt(x / (ν - 2))``.

    Raises:
        ValueError: A squared Mahalanobis distance is negative or not finite.
    """
    x = np.asarray(squared_distance, np.float64)
    if not (np.isfinite(x) & (x >= 0)).all():
        raise ValueError("squared distance: expected finite numbers of at least 0")
    if degrees_of_freedom is not None:
        return _t_probability(x, degrees_of_freedom)
    erf = np.vectorize(math.erf, [np.float64])
    return np.asarray(erf(np.sqrt(x / 2)) - np.sqrt(2 * x / math.pi) * np.exp(-x / 2))


def _t_probability(x: FloatArray, nu: float) -> FloatArray:
    most = np.arctan(np.sqrt(x / (nu - 2)))
    angles = most[..., None] / 2 * (NODES + 1)
    integral = (np.sin(angles) ** 2 * np.cos(angles) ** (nu - 1)) @ WEIGHTS * most / 2
    log_beta = math.lgamma(1.5) + math.lgamma(nu / 2) - math.lgamma(1.5 + nu / 2)
    return np.asarray(np.minimum(2 * integral * math.exp(-log_beta), 1.0))


def mixture_probability(
    squared_distances: ArrayLike, probabilities: ArrayLike, degrees_of_freedom: float | None = None
) -> FloatArray:
    """Return `region_probability` ``(N,)`` for distributions of several modes.

    The smallest region that contains a truth is around each mode where the density is that of the
    truth or more: nearer to the less likely ones. What a mode adds near another one is neglected.

    Args:
        squared_distances: Of the truth from each mode ``(N, K)``, by one covariance.
        probabilities: Of the modes ``(N, K)``, of which the largest is above 0; those of an image
            are divided by their sum.
        degrees_of_freedom: As of `region_probability`.
    """
    d2, p = np.asarray(squared_distances, np.float64), np.asarray(probabilities, np.float64)
    p = p / p.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        log_p = np.log(p)
    nu = degrees_of_freedom
    far = d2 / 2 if nu is None else (nu + 3) / 2 * np.log1p(d2 / (nu - 2))
    below = np.maximum(log_p - (log_p - far).max(axis=1, keepdims=True), 0)  # 0 beyond the region
    reach = 2 * below if nu is None else (nu - 2) * np.expm1(2 * below / (nu + 3))
    return np.asarray(np.minimum((p * region_probability(reach, nu)).sum(axis=1), 1.0))


def truth_regions(
    predicted: FloatArray,
    truth: FloatArray,
    translation_covariance: ArrayLike,
    rotation_covariance: ArrayLike,
    degrees_of_freedom: tuple[float, float] | None = None,
    alternative: FloatArray | None = None,
    probabilities: ArrayLike | None = None,
    symmetry: SymmetryGroup = IDENTITY,
) -> dict[str, FloatArray]:
    """Return the `region_probability` ``(N,)`` of each truth, for translation and for rotation.

    Args:
        predicted: Poses ``(N, 7)``, ``[t, q]``.
        truth: True poses ``(N, 7)``.
        translation_covariance: ``(N, 3, 3)``, m², camera frame.
        rotation_covariance: ``(N, 3, 3)``, rad², camera frame, of ``r`` with ``R_true = exp([r]x)
            R_predicted``.
        degrees_of_freedom: Of the t distributions of both errors; None for Gaussian errors.
        alternative: Second most likely attitudes ``(N, 4)``, whose errors, to the true ones of the
            same look nearest to them, have the same covariance: regions are of both modes
            (`mixture_probability`).
        probabilities: Of the predicted attitude and of ``alternative`` ``(N, 2)``; None without.
        symmetry: What leaves the look as it is.
    """
    of_translation, of_rotation = degrees_of_freedom or (None, None)
    moved, q = truth[:, :3] - predicted[:, :3], truth[:, 3:]
    translation = squared_mahalanobis(moved, translation_covariance, "translation_covariance")
    turned = rotation_error_vector(predicted[:, 3:], q)
    rotation = squared_mahalanobis(turned, rotation_covariance, "rotation_covariance")
    if alternative is None or probabilities is None:
        regions = region_probability(rotation, of_rotation)
    else:
        turned = rotation_error_vector(alternative, symmetry.nearest(alternative, q))
        both = np.stack([rotation, squared_mahalanobis(turned, rotation_covariance)], axis=1)
        regions = mixture_probability(both, probabilities, of_rotation)
    return {"translation": region_probability(translation, of_translation), "rotation": regions}


def coverage(probability: ArrayLike, levels: ArrayLike = LEVELS) -> FloatArray:
    """Return the coverage ``(K,)`` of each level: the share of truths within its confidence region.

    For a calibrated network the coverage equals the level. Those of the levels `CURVE` are a
    reliability curve. ``probability`` is the `region_probability` of each truth ``(N,)``.

    Raises:
        ValueError: There are no truths.
    """
    p = np.asarray(probability, np.float64)
    expect(len(p) > 0, "coverage", "at least one truth", len(p))
    return np.asarray((p[:, None] <= np.asarray(levels)).mean(axis=0))


def coverages(probability: ArrayLike) -> dict[str, float]:
    """Return ``coverage_50``, ``_90`` and ``_99``, as `coverage`."""
    shares = zip(LEVELS, coverage(probability).tolist(), strict=True)
    return {f"coverage_{100 * level:.0f}": share for level, share in shares}


def summarize_regions(probability: ArrayLike) -> dict[str, Any]:
    """Return `coverages`, and the curve as ``reliability``."""
    return {
        **coverages(probability),
        "reliability": {
            "nominal": CURVE.tolist(),
            "empirical": coverage(probability, CURVE).tolist(),
        },
    }


class FlagRates(NamedTuple):
    """Error rates of flagging images as not showing the object.

    Images whose probability of being in view is below the threshold are flagged: false alarms are
    those that show the object, misses those that do not and are not flagged.
    """

    threshold: float
    false_alarm_rate: float
    miss_rate: float


def auroc(with_object: ArrayLike, without: ArrayLike) -> float:
    """Return the area under the ROC curve of a score that detects images with the object.

    It is the probability that an image with the object ``(N,)`` scores higher than one without
    ``(M,)``, ties counting half: the Mann-Whitney U statistic (1947) divided by the number of
    pairs.

    Raises:
        ValueError: A score is not finite, or ``with_object`` or ``without`` is empty.
    """
    positive, negative = _scores(with_object, without)
    ordered = np.sort(negative)
    below = np.searchsorted(ordered, positive, "left")
    not_above = np.searchsorted(ordered, positive, "right")
    return float((below + not_above).mean() / (2 * len(ordered)))


def flag_rates(with_object: ArrayLike, without: ArrayLike, threshold: float) -> FlagRates:
    """Return false-alarm and miss rates of a threshold; else as `auroc`."""
    positive, negative = _scores(with_object, without)
    return FlagRates(
        threshold, float((positive < threshold).mean()), float((negative >= threshold).mean())
    )


def choose_threshold(with_object: ArrayLike, without: ArrayLike) -> FlagRates:
    """Return the threshold with the smallest sum of false-alarm and miss rates (Youden, 1950).

    Choose it on other images than those it is evaluated on; else as `auroc`. It is the middle of
    the gap between the scores that it separates; of several equally good ones the lowest is
    returned.
    """
    positive, negative = _scores(with_object, without)
    edges = np.unique(np.concatenate([positive, negative]))
    alarms = np.searchsorted(np.sort(positive), edges, "left") / len(positive)
    misses = 1 - np.searchsorted(np.sort(negative), edges, "left") / len(negative)
    best = int(np.argmin(alarms + misses))
    middle = edges[max(best - 1, 0)] / 2 + edges[best] / 2
    above = middle > edges[best - 1] if best else False  # False if no float lies between
    return flag_rates(positive, negative, float(middle if above else edges[best]))


def summarize_flag(
    with_object: ArrayLike, without: ArrayLike | None, threshold: float | None
) -> dict[str, float]:
    """Return `FlagRates` and ``auroc``; without empty images the false-alarm rate alone.

    Images of a lower probability than the threshold are flagged; where there is none, there are no
    rates. Else as `auroc`.
    """
    if threshold is None:
        return {} if without is None else {"auroc": auroc(with_object, without)}
    rates = flag_rates(with_object, with_object if without is None else without, threshold)
    if without is None:
        return {"threshold": threshold, "false_alarm_rate": rates.false_alarm_rate}
    return {**rates._asdict(), "auroc": auroc(with_object, without)}


def check_probability(name: str, values: FloatArray, count: int | None = None) -> None:
    """Check that values are probabilities ``(count,)``, or ``(M,)`` for any M above zero."""
    if values.ndim != 1 or len(values) == 0 or len(values) != (count or len(values)):
        raise ValueError(f"{name}: expected shape ({count or 'M'},), got {values.shape}")
    outside = values[~((values >= 0) & (values <= 1))]
    if len(outside):
        raise ValueError(f"{name}: expected probabilities, got {outside[0]}")


def _scores(with_object: ArrayLike, without: ArrayLike) -> tuple[FloatArray, FloatArray]:
    positive, negative = (np.asarray(s, np.float64) for s in (with_object, without))
    for name, scores in (("with the object", positive), ("without the object", negative)):
        if scores.ndim != 1 or len(scores) == 0 or not np.isfinite(scores).all():
            raise ValueError(
                f"scores {name}: expected finite numbers (N,), N > 0, got shape {scores.shape}"
            )
    return positive, negative
