"""Calibration of a network's distances and of its uncertainty on held-out images.

Translations are scaled by one factor, such that the median error of the logarithm of the distance
is zero. The covariances of translation and of rotation are scaled by one factor each, such that the
90 % confidence regions contain 90 % of the ground truth of the validation split. This is the analog
of temperature scaling for probabilities (Guo et al., "On Calibration of Modern Neural Networks",
ICML 2017). Of an object that the border cuts the network's errors are larger than it knows; there
the standard deviations grow with the share that is outside of the frame, such that the regions
contain 90 % of the ground truth of those that the frame does not show whole. Coverage at other
levels, and under other conditions, is up to the network.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ffpose.config import looks_twice
from ffpose.datasets import Sample
from ffpose.evaluation.attitude import rotation_error_vector
from ffpose.evaluation.calibration import choose_threshold, squared_mahalanobis
from ffpose.models import SecondLookNetwork

FloatArray = NDArray[np.float64]

LEVEL = 0.9
CHI_SQUARE_90 = 6.251388631170325
"""The 90 % quantile of the chi-square distribution with three degrees of freedom."""

ROUNDS = 5
"""Number of times that scale and growth are found in turn; each hardly depends on the other."""

GROWTH_LIMIT = 200.0
"""Growth of a standard deviation per hidden share from which on it tells of no uncertainty."""


class Calibration(NamedTuple):
    """Calibration parameters found on the validation split.

    Attributes:
        distance_scale: For the field of the network's config of that name.
        variance_scales: ``(2,)`` float32, for the network's buffer of that name.
        in_view_threshold: Images with a lower probability of the object being in view are flagged;
            None where there were no images without the object.
        hidden_sigma: For the field of the network's config of that name.
        hidden: Number of images on which ``hidden_sigma`` was found.
    """

    distance_scale: float
    variance_scales: Tensor
    in_view_threshold: float | None
    hidden_sigma: tuple[float, float]
    hidden: int


class Distances(NamedTuple):
    """Squared Mahalanobis distances of the ground truth of a set of images.

    They are those of covariances without the growth by the hidden share.

    Attributes:
        translation: ``(N,)``.
        rotation: ``(N,)``.
        hidden: Shares ``(N,)`` of the objects that the frame does not show.
    """

    translation: FloatArray
    rotation: FloatArray
    hidden: FloatArray


def calibrate(
    model: SecondLookNetwork,
    labeled: Iterable[Sample],
    empty: Iterable[Tensor],
    cut: Iterable[Sample] = (),
) -> Calibration:
    """Find the scales of a network's distances and variances, and the threshold that flags images.

    New scales are the current ones times what was found, that of a variance by `variance_scale`, so
    a network that is already calibrated keeps them. The threshold is that of
    `ffpose.evaluation.calibration.choose_threshold`: the smallest sum of false-alarm and miss
    rates. The network is put in evaluation mode and otherwise left as it is.

    Args:
        model: A network with a second look.
        labeled: Batches of the validation split, as a DataLoader of a `PoseDataset` yields them.
        empty: Standardized batches ``(B, 3, H, W)`` of images that do not show the object, for the
            threshold.
        cut: Batches like ``labeled`` of objects that the border cuts. Those of which the frame
            hides nothing, where the network sees them, are left out; if none remains,
            ``hidden_sigma`` stays as it is.

    Raises:
        ValueError: The network predicts no uncertainty, ``labeled`` has no images, a covariance is
            not positive definite, or a growth reaches `GROWTH_LIMIT`.
    """
    if not looks_twice(model.config):
        raise ValueError("model: expected one with a second look, got one that sees the frame")
    model.eval()
    seen, truths = _see_all(model, labeled)
    absent = [_see(model, images)[4] for images in empty]
    if not seen:
        raise ValueError("labeled: expected images that show the object, got none")
    factor = distance_factor(seen[0], truths[0])
    whole = _distances(model, seen, truths, factor)
    there = _see_all(model, cut)
    partial = _hidden_of(_distances(model, *there, factor)) if there[0] else None
    fits = [
        _fit(d2, whole.hidden, growth, None if partial is None else (partial[axis], partial.hidden))
        for axis, (d2, growth) in enumerate(zip(whole[:2], model.config.hidden_sigma, strict=True))
    ]
    scales, growths = zip(*fits, strict=True)
    return Calibration(
        model.config.distance_scale * factor,
        model.variance_scales.detach().cpu().float() * torch.tensor(scales),
        choose_threshold(seen[4], np.concatenate(absent)).threshold if absent else None,
        growths,
        0 if partial is None else len(partial.hidden),
    )


def _hidden_of(distances: Distances) -> Distances | None:
    """Select the objects that the frame does not show whole; None if there are none."""
    rows = distances.hidden > 0
    return Distances(*(values[rows] for values in distances)) if rows.any() else None


def _fit(
    d2: FloatArray, hidden: FloatArray, growth: float, cut: tuple[FloatArray, FloatArray] | None
) -> tuple[float, float]:
    """Return a variance's scale and its standard deviation's growth, each given the other."""
    for _ in range(ROUNDS):
        scale = variance_scale(d2 / (1 + growth * hidden) ** 2)
        if cut is not None:
            growth = sigma_growth(cut[0] / scale, cut[1])
    return scale, growth


def sigma_growth(squared_distance: ArrayLike, hidden: ArrayLike) -> float:
    """Return the growth of a standard deviation with the hidden share that covers 90 % of truths.

    With ``k``, a truth lies in its 90 % region where ``d² <= 6.2514 (1 + k h)²``, that is from ``k
    = (sqrt(d² / 6.2514) - 1) / h`` on; the result is the 90 % quantile of these, at least zero.

    Args:
        squared_distance: ``eᵀ C⁻¹ e`` of each truth ``(N,)``, N > 0.
        hidden: Share ``(N,)`` of each object that the frame does not show, above zero: where
            nothing is hidden no growth helps.

    Raises:
        ValueError: A share is not above zero, or the result is `GROWTH_LIMIT` or more.
    """
    share = np.asarray(hidden, np.float64)
    if len(share) == 0 or not (share > 0).all():
        raise ValueError(f"hidden: expected shares above 0, got {share}")
    excess = np.sqrt(np.asarray(squared_distance) / CHI_SQUARE_90) - 1
    growth = float(np.quantile(np.maximum(excess, 0) / share, LEVEL))
    if growth >= GROWTH_LIMIT:
        raise ValueError(
            f"hidden_sigma: expected a growth below {GROWTH_LIMIT:g}, got {growth:.4g} for"
            f" {len(share)} cut objects: their predicted covariances are far too small"
        )
    return growth


def distance_factor(predicted: FloatArray, truth: FloatArray) -> float:
    """Return the factor that removes the median error of the log distance.

    Args:
        predicted: Translations ``(N, 3)``, meters, none of them zero.
        truth: True translations ``(N, 3)``, meters.
    """
    ratios = np.linalg.norm(truth, axis=1) / np.linalg.norm(predicted, axis=1)
    return float(np.exp(np.median(np.log(ratios))))


def variance_scale(squared_distance: ArrayLike) -> float:
    """Return the factor on a covariance that makes its 90 % region cover 90 % of the truths.

    Scaling the covariance C by s scales the squared distances by 1 / s, so the 90 % quantile equals
    that of chi-square with three degrees of freedom for ``s = q90(d²) / 6.2514``.

    Args:
        squared_distance: ``eᵀ C⁻¹ e`` of each truth ``(N,)``.

    Raises:
        ValueError: ``squared_distance`` is empty, or a value is negative or not finite.
    """
    d2 = np.asarray(squared_distance, np.float64)
    if d2.ndim != 1 or len(d2) == 0 or not (np.isfinite(d2) & (d2 >= 0)).all():
        raise ValueError(
            f"squared distance: expected finite numbers (N,) of at least 0, N > 0, got {d2}"
        )
    return float(np.quantile(d2, LEVEL) / CHI_SQUARE_90)


def _see_all(
    model: SecondLookNetwork, labeled: Iterable[Sample]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return what the network predicts for all images, and their translations and orientations."""
    seen, truths = [], []
    for batch in labeled:
        seen.append(_see(model, batch.image))
        truths.append((_array(batch.translation), _array(batch.orientation)))
    return _joined(seen), _joined(truths)


def _joined(batches: Sequence[Sequence[FloatArray]]) -> list[FloatArray]:
    return [np.concatenate(parts) for parts in zip(*batches, strict=True)]


def _distances(
    model: SecondLookNetwork, seen: list[FloatArray], truths: list[FloatArray], factor: float
) -> Distances:
    """Return the distances of the truths from the predictions, translations times ``factor``."""
    t, q, translation_covariance, rotation_covariance, _ = seen
    hidden = _array(model.hidden(torch.from_numpy(t).float().to(model.variance_scales.device)))
    growths = [(1 + growth * hidden) ** 2 for growth in model.config.hidden_sigma]
    return Distances(
        squared_mahalanobis(truths[0] - t * factor, translation_covariance) * growths[0],
        squared_mahalanobis(rotation_error_vector(q, truths[1]), rotation_covariance) * growths[1],
        hidden,
    )


def _see(model: SecondLookNetwork, images: Tensor) -> list[FloatArray]:
    """Return the fields of `ffpose.models.network.UncertainPose` for a batch, in float64."""
    with torch.inference_mode():
        return [_array(field) for field in model(images.to(model.variance_scales.device))]


def _array(values: Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
