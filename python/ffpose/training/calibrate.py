"""Calibration of a network's distances and of its uncertainty on held-out images.

Translations are scaled by one factor, such that the median error of the logarithm of the distance
is zero. An object that the border of the frame cuts is estimated too far: the logarithm of its
distance is reduced by a multiple of the squared share of its view that is cut off, the one with the
least absolute errors. Looks that are pointed beside the object measure how closely the offset that
they find follows the true one. The errors of translation, and those of rotation, are modeled as
multivariate t distributed (Lange, Little and Taylor, "Robust Statistical Modeling Using the t
Distribution", JASA 1989): most are as small as the network says, and some are much larger. Those of
the rotation are so about either of two modes with given probabilities: the network may not know
which of two sides that look alike it sees. Found by maximum likelihood are the degrees of freedom,
a scale of the covariances, and how the standard deviations grow with the network's own doubt of the
attitude, the probability that its bins give to attitudes far from the most likely one, and with the
squared share that is cut off. This is the analog of temperature scaling for probabilities (Guo et
al., "On Calibration of Modern Neural Networks", ICML 2017). The covariances are then those of the t
distributions, not their scale matrices. Errors of heavily truncated objects are not quite t
distributed: the growth with truncation is found anew, such that their confidence regions have the
nominal coverage (as in conformal prediction).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.nn import functional as F

from ffpose.config import PolarPoseConfig
from ffpose.config.polar_pose import MOST_DEGREES_OF_FREEDOM
from ffpose.datasets import Sample
from ffpose.evaluation.attitude import rotation_error_vector
from ffpose.evaluation.calibration import (
    choose_threshold,
    mixture_probability,
    squared_mahalanobis,
)
from ffpose.geometry import FloatArray
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.models import PolarPose
from ffpose.models.second_look import truncation

LEAST_DEGREES_OF_FREEDOM = 3.0
"""Below, a covariance, which exists above two, is mostly that of errors that were never seen."""

ROOM = MOST_DEGREES_OF_FREEDOM - LEAST_DEGREES_OF_FREEDOM

LEAST_DISTANCE = 1e-30
"""Least median of the squared distances that the fit begins with."""

STEPS = 300
"""Largest number of steps of the fit, which ends when the likelihood no longer changes."""

MOSTLY_CUT = 0.35
"""Truncation, the share of the view that is cut off, of a heavily truncated object: at least."""

LEAST_MOSTLY_CUT = 50
"""Fewest images of such objects whose coverage determines the growth with truncation."""

LEVEL = 0.9
"""Confidence level at which their coverage is nominal."""

MOST_GROWTH = 100.0
"""Largest growth of the standard deviations with the squared truncation."""

LEAST_SLOPE = 0.5
"""A look that follows the true offset by less makes its noise more than twice as large to mend."""

DISPLACED = 1.5
"""Predicted standard deviations by which looks are pointed off to either side."""


MODES = ("orientation", "alternative")
"""Fields of a prediction that are attitudes."""


class Calibration(NamedTuple):
    """Calibration parameters found on held-out images.

    Fields are those of the network's config of the same names, its buffer ``variance_scales``
    ``(2,)``, and the probability of being in view below which images are flagged, None where there
    were no images without the object.
    """

    distance_scale: float
    truncation_distance: float
    variance_scales: Tensor
    doubt_sigma: tuple[float, float]
    truncation_sigma: tuple[float, float]
    degrees_of_freedom: tuple[float, float]
    in_view_threshold: float | None
    look_slope: tuple[float, float]


class Tails(NamedTuple):
    """A multivariate t distribution relative to a predicted covariance.

    ``scale`` makes a covariance that of the distribution, where neither doubt nor truncation is.
    """

    scale: float
    doubt_sigma: float
    truncation_sigma: float
    degrees_of_freedom: float


def calibrate(
    model: PolarPose,
    labeled: Iterable[Sample],
    empty: Iterable[Tensor],
    cut: Iterable[Sample] = (),
    hard: Iterable[Sample] = (),
    symmetry: SymmetryGroup = IDENTITY,
) -> Calibration:
    """Find the distribution of a network's errors, and the threshold that flags images.

    What an earlier calibration found does not count, so the same images give the same numbers. The
    threshold is that of `ffpose.evaluation.calibration.choose_threshold`.

    Args:
        model: The network.
        labeled: Batches of held-out images, as a DataLoader of a `PoseDataset` yields them.
        empty: Standardized batches ``(B, 3, H, W)`` that do not show the object, for the threshold.
        cut: Batches like ``labeled``, whose objects the border cuts, that count for the errors'
            distribution alone: the coverage of those of a large truncation determines its growth.
        hard: Batches of other objects that count for the errors' distribution alone.
        symmetry: Errors are modulo it.

    Raises:
        ValueError: ``labeled`` has no images, or a covariance is not positive definite.
    """
    model = deepcopy(model).eval()
    model.config = with_calibration(model.config, PolarPoseConfig())
    model.variance_scales.fill_(1)
    seen = _see_all(model, labeled, symmetry, pointed_off=True)
    absent = [_see(model, images)["in_view"] for images in empty]
    if not seen:
        raise ValueError("labeled: expected images that show the object, got none")
    slopes = seen.pop("slopes")
    across, along = float(np.median(slopes[:, :2])), float(np.median(slopes[:, 2]))
    others = [_see_all(model, images, symmetry) for images in (cut, hard)]
    sets = [each for each in (seen, *others) if each]
    every = {name: np.concatenate([each[name] for each in sets]) for name in seen}
    factor = distance_factor(seen["translation"], seen["true_translation"])
    found = every["translation"] * factor
    share = _array(truncation(torch.from_numpy(found), model.config))  # that is cut off
    # A few that the border hardly cuts tell nothing of those that it mostly cuts.
    mostly = share >= MOSTLY_CUT
    nearer = 0.0
    if mostly.sum() >= LEAST_MOSTLY_CUT:
        distance, truth = (np.linalg.norm(t, axis=1) for t in (found, every["true_translation"]))
        nearer = truncation_distance(np.log(distance / truth), share)
    translation, rotation = _distances(every, factor * np.exp(-nearer * share**2))
    # in other images the object is whole, and only its sphere is cut
    mostly &= np.concatenate([np.full(len(each["in_view"]), each is others[0]) for each in sets])
    tails, modes = [], every["probabilities"]
    for distances, probabilities in ((translation, np.ones_like(translation)), (rotation, modes)):
        errors = (distances, 1 - modes[:, 0], share, probabilities)
        fitted = fit_tails(*errors)
        if mostly.sum() >= LEAST_MOSTLY_CUT:
            growth = covering_growth(fitted, *(each[mostly] for each in errors))
            fitted = fitted._replace(truncation_sigma=growth)
        tails.append(fitted)
    scales, by_doubt, by_cut, degrees = zip(*tails, strict=True)
    return Calibration(
        factor,
        nearer,
        torch.tensor(scales),
        by_doubt,
        by_cut,
        degrees,
        choose_threshold(seen["in_view"], np.concatenate(absent)).threshold if absent else None,
        (max(across, LEAST_SLOPE), max(along, LEAST_SLOPE)),
    )


def with_calibration(
    config: PolarPoseConfig, found: Calibration | PolarPoseConfig
) -> PolarPoseConfig:
    """Return a config with the fields that a calibration has found, or with another config's."""
    names = {field.name for field in fields(config)} & set(Calibration._fields)
    return replace(config, **{name: getattr(found, name) for name in names})


def distance_factor(predicted: FloatArray, truth: FloatArray) -> float:
    """Return the factor on translations ``(N, 3)`` that removes the median log distance error."""
    ratios = np.linalg.norm(truth, axis=1) / np.linalg.norm(predicted, axis=1)
    return float(np.exp(np.median(np.log(ratios))))


def truncation_distance(too_far: ArrayLike, truncation: ArrayLike) -> float:
    """Return the number ``k`` with the least sum of ``|too_far - k truncation²|``; 0 without cuts.

    ``too_far`` are logarithms of predicted over true distances ``(N,)``, ``truncation`` the shares
    that are cut off ``(N,)``, 0 to 1.
    """
    shares = np.asarray(truncation, np.float64) ** 2
    cut = shares > 0
    if not cut.any():
        return 0.0
    slopes, weights = np.asarray(too_far, np.float64)[cut] / shares[cut], shares[cut]
    order = np.argsort(slopes)
    middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    return float(slopes[order][middle])


def fit_tails(
    squared_distance: FloatArray,
    doubt: FloatArray,
    truncation: FloatArray,
    probabilities: FloatArray,
) -> Tails:
    """Return the t distribution of the largest likelihood of errors in three dimensions.

    With a doubt ``p`` and a truncation ``s`` ``(N,)``, 0…1, the scale matrix is that without them
    times ``(1 + k p)² (1 + l s²)²``; where all are zero no growth is found. Degrees of freedom are
    `LEAST_DEGREES_OF_FREEDOM` to `ffpose.config.polar_pose.MOST_DEGREES_OF_FREEDOM`.

    Args:
        squared_distance: ``eᵀ C⁻¹ e`` of the errors from each of the modes ``(N, K)``, about each
            of which errors have the same distribution.
        doubt: ``(N,)``.
        truncation: ``(N,)``.
        probabilities: Of the modes ``(N, K)``, that of the first above 0.
    """
    d2, shares = map(torch.from_numpy, (squared_distance, np.stack([doubt, truncation**2])))
    log_p = torch.from_numpy(probabilities / probabilities.sum(axis=1, keepdims=True)).log()
    x = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    search = torch.optim.LBFGS(
        [x],
        max_iter=STEPS,
        tolerance_grad=1e-9,
        tolerance_change=1e-12,
        line_search_fn="strong_wolfe",
    )
    begin = math.log(max(float(np.median(squared_distance.min(axis=1))), LEAST_DISTANCE))
    grows = shares.any(1).double()

    def found() -> tuple[Tensor, Tensor, Tensor]:
        """Return log scale of the scale matrix, growths and degrees of freedom at ``x``."""
        nu = LEAST_DEGREES_OF_FREEDOM + ROOM * (x[3] - 5).sigmoid()
        return begin + x[0], grows * (1 + x[1:3]).square(), nu

    def loss() -> Tensor:
        search.zero_grad()
        value = negative_log_likelihood(d2, log_p, shares, *found())
        torch.autograd.backward(value)
        return value

    search.step(loss)  # type: ignore[no-untyped-call]  # torch annotates no optimizer of its own
    log_scale, growths, degrees = (each.detach() for each in found())
    by_doubt, by_truncation = growths.tolist()
    nu = float(degrees)
    return Tails(math.exp(float(log_scale)) * nu / (nu - 2), by_doubt, by_truncation, nu)


def covering_growth(
    tails: Tails,
    squared_distance: FloatArray,
    doubt: FloatArray,
    truncation: FloatArray,
    probabilities: FloatArray,
) -> float:
    """Return the least growth with truncation at which regions of `LEVEL` contain that share.

    It is at most `MOST_GROWTH`. Arguments are those of `fit_tails`, truncations above 0.
    """
    scale = tails.scale * (1 + tails.doubt_sigma * doubt) ** 2

    def contained(growth: float) -> float:
        d2 = squared_distance / (scale * (1 + growth * truncation**2) ** 2)[:, None]
        regions = mixture_probability(d2, probabilities, tails.degrees_of_freedom)
        return float((regions <= LEVEL).mean())

    low, high = 0.0, MOST_GROWTH
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if contained(middle) >= LEVEL else (middle, high)
    return high if low else 0.0


def negative_log_likelihood(
    d2: Tensor, log_p: Tensor, shares: Tensor, log_scale: Tensor, growths: Tensor, nu: Tensor
) -> Tensor:
    """Return the mean of a mixture of multivariate t distributions', up to a constant.

    ``d2`` and ``log_p`` are of the modes ``(N, K)``; ``growths (2,)`` belong to ``shares (2, N)``,
    doubt and squared truncation.
    """
    log_scales = log_scale + 2 * torch.log1p(growths[:, None] * shares).sum(0)
    normalization = torch.lgamma((nu + 3) / 2) - torch.lgamma(nu / 2) - 1.5 * nu.log()
    far = (nu + 3) / 2 * torch.log1p(d2 * torch.exp(-log_scales)[:, None] / nu)
    return (1.5 * log_scales - torch.logsumexp(log_p - far, dim=1)).mean() - normalization


def _see_all(
    model: PolarPose,
    labeled: Iterable[Sample],
    symmetry: SymmetryGroup,
    *,
    pointed_off: bool = False,
) -> dict[str, FloatArray]:
    """Return what the network predicts for all images, and the nearest truth of the same look.

    With ``pointed_off`` the ``slopes`` of its looks too. Empty without images.
    """
    seen = []
    for batch in labeled:
        found = _see(model, batch.image, batch.translation if pointed_off else None)
        found["true_translation"], truth = _array(batch.translation), _array(batch.orientation)
        for name in MODES:
            found[f"true_{name}"] = symmetry.nearest(found[name], truth)
        seen.append(found)
    return {name: np.concatenate([each[name] for each in seen]) for name in seen[0]} if seen else {}


def _distances(seen: Mapping[str, FloatArray], factor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the squared distances of translation ``(N, 1)`` and of rotation from each mode.

    Predicted translations are multiplied by ``factor (N,)``; the second are ``(N, 2)``.
    """
    moved = seen["true_translation"] - seen["translation"] * factor[:, None]
    turned = [
        squared_mahalanobis(
            rotation_error_vector(seen[name], seen[f"true_{name}"]), seen["rotation_covariance"]
        )
        for name in MODES
    ]
    translation = squared_mahalanobis(moved, seen["translation_covariance"])
    return translation[:, None], np.stack(turned, axis=1)


def _see(model: PolarPose, images: Tensor, about: Tensor | None = None) -> dict[str, FloatArray]:
    """Return the fields of `ffpose.models.base.UncertainPose` for a batch, in float64.

    With the true translations ``about (B, 3)`` the `slopes` of looks about them too.
    """
    with torch.inference_mode():
        images = images.to(model.variance_scales.device)
        found = model(images)
        told = found._asdict()
        if about is not None:
            truth = about.to(found.translation)
            told["slopes"] = slopes(model, images, truth, found.translation_covariance)
    return {name: _array(values) for name, values in told.items()}


def slopes(model: PolarPose, images: Tensor, truth: Tensor, covariance: Tensor) -> Tensor:
    """Return how looks follow the true offset ``(B, 3)``: twice across the ray, then along it.

    Looks are pointed off the truth ``(B, 3)``, meters, by `DISPLACED` standard deviations of what
    is found to either side; where what they find moves by a share of that, the slope is one less
    this share.
    """
    along = F.normalize(truth, dim=1)
    aside = torch.linalg.cross(along, torch.eye(3).to(along)[along.abs().argmin(1)])
    aside = F.normalize(aside, dim=1)
    measured = []
    for axis in (aside, torch.linalg.cross(along, aside), along):
        variance = (axis[:, None] @ covariance @ axis[:, :, None])[:, 0]
        moved = DISPLACED * variance.sqrt() * axis
        back, forth = (
            model.predict_near(images, truth + side * moved).translation for side in (-1, 1)
        )
        leaning = ((forth - back) * axis).sum(1) / (2 * moved.norm(dim=1))
        measured.append(1 - leaning)
    return torch.stack(measured, dim=1)


def _array(values: Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
