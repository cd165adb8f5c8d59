"""Statistics of one condition of a model card: errors, and calibration of the uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.evaluation.calibration import coverages, summarize_flag, truth_regions
from ffpose.evaluation.metrics import error_statistics, pose_errors
from ffpose.geometry import FloatArray, Pose, PoseUncertainty, standard_deviations
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup


class Answers(NamedTuple):
    """Poses that a network found in images, and the true ones; none where no object is shown."""

    found: list[Pose]
    truth: list[Pose]

    def of(self, rows: NDArray[np.bool_]) -> Answers:
        """Select the images of a mask ``rows (N,)``."""
        return Answers(*(list(compress(poses, rows)) for poses in self))

    @property
    def uncertainties(self) -> list[PoseUncertainty]:
        """Predicted uncertainties; empty for a network that predicts none."""
        return [pose.uncertainty for pose in self.found if pose.uncertainty is not None]


def folded(answers: Answers, symmetry: SymmetryGroup) -> Answers:
    """Return the answers with the true poses of the same looks nearest to those found."""
    if len(symmetry) == 1 or not answers.truth:
        return answers
    truth = symmetry.folded(_vectors(answers.found), _vectors(answers.truth))
    return answers._replace(truth=[Pose.from_vector(row) for row in truth])


def summarize(
    answers: Answers, threshold: float | None, symmetry: SymmetryGroup = IDENTITY
) -> dict[str, Any]:
    """Return the statistics of images that show the object, answers `folded` by ``symmetry``.

    ``images``; ``median_`` and ``mean_`` of the errors in `ffpose.evaluation.metrics.SUMMARIZED`,
    ``share_over_30_deg``, ``median_intervals_95``; ``percentile_90_rotation_error_deg``. For a
    network that predicts its uncertainty also coverages of ``translation`` and ``rotation``,
    ``median_sigma_distance_m``, ``median_sigma_rotation_deg``, ``median_in_view``, and with a
    threshold ``flagged``, the share of images below it.

    Raises:
        ValueError: There are no answers, or a covariance is invalid.
    """
    if not answers.truth:
        raise ValueError("answers: expected at least one with the truth, got none")
    errors = pose_errors(*map(_vectors, answers))
    return {
        "images": len(answers.truth),
        **{n: value for n, value in error_statistics(errors).items() if not n.endswith("score")},
        "percentile_90_rotation_error_deg": float(np.quantile(errors.rotation_deg.numpy(), 0.9)),
        **(_trust(answers, threshold, symmetry) if answers.uncertainties else {}),
    }


def _trust(answers: Answers, threshold: float | None, symmetry: SymmetryGroup) -> dict[str, Any]:
    found, truth = _vectors(answers.found), _vectors(answers.truth)
    said = answers.uncertainties
    second = [u.alternative for u in said if u.alternative is not None]
    regions = truth_regions(
        found,
        truth,
        np.stack([u.translation_covariance for u in said]),
        np.stack([u.rotation_covariance for u in said]),
        said[0].degrees_of_freedom,
        np.stack(second) if second else None,
        [u.probabilities for u in said],
        symmetry,
    )
    result: dict[str, Any] = {name: coverages(each) for name, each in regions.items()}
    pairs = zip(answers.found, said, strict=True)
    distances, in_plane, out_of_plane = np.transpose(
        [standard_deviations(pose.t, u) for pose, u in pairs]
    )
    result["median_sigma_distance_m"] = float(np.median(distances))
    result["median_sigma_rotation_deg"] = float(np.median(np.hypot(in_plane, out_of_plane)))
    in_view = np.array([u.in_view for u in said])
    result["median_in_view"] = float(np.median(in_view))
    if threshold is not None:
        result["flagged"] = float((in_view < threshold).mean())
    return result


def refuse(
    with_object: Sequence[Pose], without: Sequence[Pose], threshold: float | None
) -> dict[str, Any]:
    """Return how well images ``without`` the object are distinguished from those with it.

    ``images``, their ``median_in_view``, ``auroc``, and, with a threshold, ``false_alarm_rate`` and
    ``miss_rate`` as in `ffpose.evaluation.calibration.FlagRates`.

    Raises:
        ValueError: ``with_object`` or ``without`` is empty or has no uncertainty.
    """
    positive, negative = (
        [pose.uncertainty.in_view for pose in poses if pose.uncertainty is not None]
        for poses in (with_object, without)
    )
    flag = summarize_flag(positive, negative, threshold)
    flag.pop("threshold", None)
    median = float(np.median(negative))
    return {"images": len(negative), "median_in_view": median, **flag}


def _vectors(poses: Sequence[Pose]) -> FloatArray:
    return np.stack([pose.vector for pose in poses])
