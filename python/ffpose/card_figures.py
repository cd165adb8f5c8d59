"""The figures of one condition: errors, and how far the network's word on them can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ffpose.attitude import rotation_vector
from ffpose.calibration import (
    LEVELS,
    auroc,
    coverage,
    flag_rates,
    region_probability,
    squared_mahalanobis,
)
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.metrics import SUMMARIZED, PoseErrors, pose_error
from ffpose.prediction import standard_deviations
from ffpose.significance import median_interval

FloatArray = NDArray[np.float64]

LARGE_DEG = 30.0
"""A rotation error above it is a failure, such as an object turned the wrong way round."""


class Answers(NamedTuple):
    """What a network says of the pictures of one condition.

    Attributes:
        truth: True poses; none where the pictures do not show the object.
        found: Predicted poses.
    """

    truth: list[Pose]
    found: list[Pose]

    def of(self, rows: NDArray[np.bool_]) -> Answers:
        """Return the answers of the pictures ``rows (N,)``."""
        places = np.flatnonzero(rows).tolist()
        return Answers([self.truth[i] for i in places], [self.found[i] for i in places])

    @property
    def uncertainties(self) -> list[PoseUncertainty]:
        """What the network says of its errors; none of a network that does not."""
        return [pose.uncertainty for pose in self.found if pose.uncertainty is not None]


def summarize(answers: Answers, threshold: float | None) -> dict[str, Any]:
    """Return the figures of pictures that show the object.

    Args:
        answers: At least one, with the truth.
        threshold: An image with a lower probability of the object being in view is flagged; None
            where the weights hold none.

    Returns:
        ``images``; ``median_`` and ``mean_`` of the errors that `ffpose.metrics.SUMMARIZED` names,
        and their ``median_intervals_95``; ``percentile_90_rotation_error_deg``;
        ``share_over_30_deg``. Of a network that gives its uncertainty also ``translation`` and
        ``rotation``: coverage of the regions of 50, 90 and 99 %; the medians of
        `ffpose.prediction.standard_deviations`, of the distance as ``median_sigma_distance_m`` and
        of the rotation as ``median_sigma_rotation_deg``; ``median_in_view``; and ``flagged``, the
        share below the threshold.

    Raises:
        ValueError: There are no answers, or a covariance that is none.
    """
    errors = _errors(answers)
    rotation = errors.rotation_deg.numpy()
    named = {name: getattr(errors, field).numpy() for name, field in SUMMARIZED.items()}
    return {
        "images": len(rotation),
        **{f"median_{name}": float(np.median(values)) for name, values in named.items()},
        **{f"mean_{name}": float(values.mean()) for name, values in named.items()},
        "median_intervals_95": {
            f"median_{name}": list(median_interval(values)) for name, values in named.items()
        },
        "percentile_90_rotation_error_deg": float(np.quantile(rotation, 0.9)),
        f"share_over_{LARGE_DEG:.0f}_deg": float((rotation > LARGE_DEG).mean()),
        **(_trust(answers, threshold) if answers.uncertainties else {}),
    }


def _trust(answers: Answers, threshold: float | None) -> dict[str, Any]:
    """Return what there is to say of the uncertainties."""
    truth, found = _vectors(answers.truth), _vectors(answers.found)
    said = answers.uncertainties
    residuals = {
        "translation": truth[:, :3] - found[:, :3],
        "rotation": rotation_vector(truth[:, 3:], found[:, 3:]),
    }
    result: dict[str, Any] = {}
    for name, residual in residuals.items():
        covariance = np.stack([getattr(u, f"{name}_covariance") for u in said])
        probability = region_probability(squared_mahalanobis(residual, covariance))
        shares = zip(LEVELS, coverage(probability).tolist(), strict=True)
        result[name] = {f"coverage_{100 * level:.0f}": share for level, share in shares}
    pairs = zip(answers.found, said, strict=True)
    sigmas = np.median([standard_deviations(pose.t, u) for pose, u in pairs], axis=0)
    in_view = np.array([u.in_view for u in said])
    result["median_sigma_distance_m"], result["median_sigma_rotation_deg"] = sigmas.tolist()
    result["median_in_view"] = float(np.median(in_view))
    if threshold is not None:
        result["flagged"] = float((in_view < threshold).mean())
    return result


def refuse(
    with_object: Sequence[Pose], without: Sequence[Pose], threshold: float | None
) -> dict[str, Any]:
    """Return how well pictures without the object are told from pictures with it.

    Args:
        with_object: What the network says of pictures that show it, with its uncertainty.
        without: The same of pictures that do not.
        threshold: As in `summarize`.

    Returns:
        ``images`` without the object, ``median_in_view`` of them, ``auroc``, and, with a threshold,
        ``false_alarm_rate`` and ``miss_rate`` as in `ffpose.calibration.FlagRates`.

    Raises:
        ValueError: One of the two is empty, or without uncertainty.
    """
    positive, negative = (
        [pose.uncertainty.in_view for pose in poses if pose.uncertainty is not None]
        for poses in (with_object, without)
    )
    result = {
        "images": len(negative),
        "median_in_view": float(np.median(negative)),
        "auroc": auroc(positive, negative),
    }
    if threshold is not None:
        rates = flag_rates(positive, negative, threshold)
        result["false_alarm_rate"], result["miss_rate"] = rates.false_alarm_rate, rates.miss_rate
    return result


def _errors(answers: Answers) -> PoseErrors:
    if not answers.truth:
        raise ValueError("answers: expected at least one with the truth, got none")
    truth, found = (torch.from_numpy(_vectors(poses)) for poses in answers)
    return pose_error(found[:, :3], found[:, 3:], truth[:, :3], truth[:, 3:])


def _vectors(poses: Sequence[Pose]) -> FloatArray:
    return np.stack([pose.vector for pose in poses])
