"""Set a network's own word on its errors right, on images that it has not learned from.

A covariance that is too small or too large by one factor is mended by that factor, one for
translation and one for rotation: the regions of 90 % are made to hold 90 % of the truths of the
validation split, as temperature scaling does for probabilities (Guo et al., "On Calibration of
Modern Neural Networks", ICML 2017). Coverage of other levels, and under other conditions, then
follows from the network alone.
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
"""What chi-square with three degrees of freedom exceeds in one case of ten."""


class Calibration(NamedTuple):
    """What was found on the validation split.

    Attributes:
        variance_scales: ``(2,)`` float32, for the network's buffer of that name.
        in_view_threshold: For the header: an image with a lower probability is flagged.
    """

    variance_scales: Tensor
    in_view_threshold: float


def calibrate(
    model: FilterformerPose, labeled: Iterable[Sample], empty: Iterable[Tensor]
) -> Calibration:
    """Find the scales of a network's variances, and the threshold that flags by its presence.

    The scale of a variance is what it has now times `variance_scale`, so that a network which is
    calibrated already keeps it. The threshold is `ffpose.calibration.choose_threshold`: the least
    sum of false alarms and misses. The network is left as it is but for its mode: evaluation.

    Args:
        model: A network with a second look.
        labeled: Batches of the validation split, as a DataLoader of a `PoseDataset` gives them.
        empty: Batches ``(B, 3, H, W)``, standardized, of images that do not show the object.

    Raises:
        ValueError: A network that gives no uncertainty, no images of one kind, or a covariance that
            is not positive definite.
    """
    if model.config.orientation_view != "object":
        raise ValueError("model: expected one with orientation_view 'object', got 'frame'")
    model.eval()
    translation, rotation, shown = [], [], []
    for batch in labeled:
        pose = _see(model, batch.image)
        truth_t, truth_q = _array(batch.translation), _array(batch.orientation)
        translation.append(squared_mahalanobis(truth_t - pose[0], pose[2]))
        rotation.append(squared_mahalanobis(rotation_vector(truth_q, pose[1]), pose[3]))
        shown.append(pose[4])
    absent = [_see(model, images)[4] for images in empty]
    if not shown or not absent:
        raise ValueError("images: expected some that show the object and some that do not")
    scales = [variance_scale(np.concatenate(distances)) for distances in (translation, rotation)]
    return Calibration(
        model.variance_scales.detach().cpu().float() * torch.tensor(scales),
        choose_threshold(np.concatenate(shown), np.concatenate(absent)).threshold,
    )


def variance_scale(squared_distance: ArrayLike) -> float:
    """Return the factor of a variance that makes its region of 90 % hold 90 % of the truths.

    A covariance C times s has the squared distances d² / s, so that the quantile of 90 % comes to
    that of chi-square with three degrees of freedom by ``s = q90(d²) / 6.2514``.

    Args:
        squared_distance: ``eᵀ C⁻¹ e`` of each truth ``(N,)``.

    Raises:
        ValueError: There are none, or one is negative or not finite.
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
