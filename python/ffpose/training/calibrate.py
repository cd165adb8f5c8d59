"""Calibration of a network's distances and of its uncertainty on held-out images.

Translations are scaled by one factor, such that the median error of the logarithm of the distance
is zero. The covariances of translation and of rotation are scaled by one factor each, such that the
90 % confidence regions contain 90 % of the ground truth of the validation split. This is the analog
of temperature scaling for probabilities (Guo et al., "On Calibration of Modern Neural Networks",
ICML 2017). Coverage at other levels, and under other conditions, is up to the network.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ffpose.attitude import rotation_vector
from ffpose.calibration import choose_threshold, squared_mahalanobis
from ffpose.datasets import Sample
from ffpose.models import FilterformerPose

FloatArray = NDArray[np.float64]

LEVEL = 0.9
CHI_SQUARE_90 = 6.251388631170325
"""The 90 % quantile of the chi-square distribution with three degrees of freedom."""


class Calibration(NamedTuple):
    """Calibration parameters found on the validation split.

    Attributes:
        distance_scale: For the field of the network's config of that name.
        variance_scales: ``(2,)`` float32, for the network's buffer of that name.
        in_view_threshold: Images with a lower probability of the object being in view are flagged.
    """

    distance_scale: float
    variance_scales: Tensor
    in_view_threshold: float


def calibrate(
    model: FilterformerPose, labeled: Iterable[Sample], empty: Iterable[Tensor]
) -> Calibration:
    """Find the scales of a network's distances and variances, and the threshold that flags images.

    New scales are the current ones times what was found, that of a variance by `variance_scale`, so
    a network that is already calibrated keeps them. The threshold is that of
    `ffpose.calibration.choose_threshold`: the smallest sum of false-alarm and miss rates. The
    network is put in evaluation mode and otherwise left as it is.

    Args:
        model: A network with a second look.
        labeled: Batches of the validation split, as a DataLoader of a `PoseDataset` yields them.
        empty: Standardized batches ``(B, 3, H, W)`` of images that do not show the object.

    Raises:
        ValueError: The network predicts no uncertainty, ``labeled`` or ``empty`` has no images, or
            a covariance is not positive definite.
    """
    if model.config.orientation_view != "object":
        raise ValueError("model: expected one with orientation_view 'object', got 'frame'")
    model.eval()
    seen, truths = [], []
    for batch in labeled:
        seen.append(_see(model, batch.image))
        truths.append((_array(batch.translation), _array(batch.orientation)))
    absent = [_see(model, images)[4] for images in empty]
    if not seen or not absent:
        raise ValueError("images: expected some that show the object and some that do not")
    t, q, translation_covariance, rotation_covariance, shown = map(
        np.concatenate, zip(*seen, strict=False)
    )
    true_t, true_q = map(np.concatenate, zip(*truths, strict=False))
    factor = distance_factor(t, true_t)
    scales = [
        variance_scale(squared_mahalanobis(true_t - t * factor, translation_covariance)),
        variance_scale(squared_mahalanobis(rotation_vector(true_q, q), rotation_covariance)),
    ]
    return Calibration(
        model.config.distance_scale * factor,
        model.variance_scales.detach().cpu().float() * torch.tensor(scales),
        choose_threshold(shown, np.concatenate(absent)).threshold,
    )


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


def _see(model: FilterformerPose, images: Tensor) -> list[FloatArray]:
    """Return the fields of `ffpose.models.UncertainPose` for a batch, in float64."""
    with torch.inference_mode():
        return [_array(field) for field in model(images.to(model.variance_scales.device))]


def _array(values: Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
