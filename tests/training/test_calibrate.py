"""Calibration of residuals that are drawn from known t distributions."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize, minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import f, multivariate_t

from ffpose.config import PRESETS, PolarPoseConfig
from ffpose.datasets import Sample
from ffpose.evaluation.calibration import CURVE, coverage, region_probability
from ffpose.models import PolarPose
from ffpose.models.base import UncertainPose
from ffpose.models.second_look import calibrated, truncation
from ffpose.training.calibrate import (
    LEAST_DEGREES_OF_FREEDOM,
    LEAST_MOSTLY_CUT,
    LEAST_SLOPE,
    MOST_GROWTH,
    Tails,
    calibrate,
    covering_growth,
    fit_tails,
    truncation_distance,
)

COUNT = 2000
TRUE_VARIANCES = (0.09, 4e-4)
"""Of translation and rotation; the errors' distributions have the `DEGREES` of freedom."""

DEGREES = (4.0, 6.0)
SAID = (0.03, 16e-4)
"""Predicted variances: a third of the true one for translation, four times for rotation."""


AHEAD = (0.0, 0.0, 40.0)
FAR_WITHIN = (100.0, 100.0, 256.0, 192.0)
"""A camera that sees what is ahead far from the borders of its frame of 512 x 384 pixels."""

ON_THE_BORDER = (100.0, 100.0, 0.0, 192.0)
"""A camera that sees it on the left border of its frame."""


class Drawn(torch.nn.Module):
    """Answers one pose to pictures that hold one number each: their presence."""

    def __init__(
        self,
        distance_scale=1.0,
        doubt_sigma=(0.0, 0.0),
        truncation_sigma=(0.0, 0.0),
        doubt=0.0,
        camera=FAR_WITHIN,
    ):
        super().__init__()
        self.doubt = doubt
        self.config = PolarPoseConfig(
            camera=camera,
            distance_scale=distance_scale,
            doubt_sigma=doubt_sigma,
            truncation_sigma=truncation_sigma,
        )
        self.register_buffer("variance_scales", torch.ones(2))

    def forward(self, images):
        count = len(images)
        unit = torch.eye(3).expand(count, 3, 3)
        shown = images.flatten(1).mean(1)
        doubt = torch.full((count,), self.doubt) if self.doubt is not None else 1 - shown
        q = torch.tensor([1.0, 0, 0, 0]).expand(count, 4)
        covariances = (
            unit * said * scale for said, scale in zip(SAID, self.variance_scales, strict=True)
        )
        pose = UncertainPose(
            torch.tensor(AHEAD).expand(count, 3),
            q,
            *covariances,
            shown,
            q,
            torch.stack([1 - doubt, 0 * doubt], dim=1),
        )
        return calibrated(pose, self.config)

    def predict_near(self, images, points):
        """Find the same wherever the look is pointed."""
        return self(images)


def errors(seed, count=COUNT):
    """Errors of translation and rotation ``(count, 3)`` each, as `TRUE_VARIANCES` says."""
    rng = np.random.default_rng(seed)
    return [
        multivariate_t.rvs(
            np.zeros(3), variance * (nu - 2) / nu * np.eye(3), df=nu, size=count, random_state=rng
        )
        for variance, nu in zip(TRUE_VARIANCES, DEGREES, strict=True)
    ]


def split(seed, count=COUNT, level=0.8, factor=1.0):
    """Batches of a split whose truths lie about the answers as `errors`, times a factor."""
    moved, turned = errors(seed, count)
    t, turn = AHEAD + factor * moved, Rotation.from_rotvec(factor * turned)
    q = np.roll(turn.as_quat(), 1, axis=1)
    shown = torch.full((count, 3, 2, 2), level)
    for rows in np.split(np.arange(count), 4):
        yield Sample(
            shown[rows],
            torch.tensor(t[rows]),
            torch.tensor(q[rows]),
            rows,
            torch.ones(len(rows), 4),
        )


def absent(probability=0.2):
    return [torch.full((5, 3, 2, 2), probability)]


def fit_one(d2, doubt=None, cut=None):
    """Fit errors about one mode."""
    none = np.zeros(len(d2))
    doubt, cut = (none if share is None else share for share in (doubt, cut))
    return fit_tails(d2[:, None], doubt, cut, np.ones((len(d2), 1)))


@pytest.mark.parametrize("factor", [1e-6, 1.0, 3e4])
@pytest.mark.parametrize("nu", [3.5, 5.0, 12.0])
def test_scale_and_degrees_of_freedom_are_those_of_the_samples(nu, factor):
    """Of SciPy's samples of a t distribution, whose covariance is nu / (nu - 2)."""
    samples = multivariate_t.rvs(np.zeros(3), np.eye(3), df=nu, size=20000, random_state=1)
    found = fit_one(factor * (samples**2).sum(1))
    scale_matrix = found.scale * (found.degrees_of_freedom - 2) / found.degrees_of_freedom
    assert scale_matrix == pytest.approx(factor, rel=0.03)
    assert found.degrees_of_freedom == pytest.approx(nu, rel=0.1)
    assert found.doubt_sigma == found.truncation_sigma == 0


def test_the_fit_has_the_largest_likelihood():
    """As SciPy's simplex finds it from SciPy's density of F, which differs by a constant."""
    rng = np.random.default_rng(2)
    doubt, cut = rng.random(500) ** 4, rng.random(500)
    grown = (1 + 5 * doubt) ** 2 * (1 + 2 * cut**2) ** 2
    d2 = 3 * f.rvs(3, 4.5, size=500, random_state=rng) * 1.7 * grown

    def loss(x):
        scales = np.exp(x[0]) * (1 + x[1] ** 2 * doubt) ** 2 * (1 + x[3] ** 2 * cut**2) ** 2
        return -(f.logpdf(d2 / scales / 3, 3, 3 + np.exp(x[2])) - np.log(scales)).sum()

    options = {"xatol": 1e-7, "fatol": 1e-9, "maxiter": 5000}
    best = minimize(loss, [0.0, 1.0, 0.0, 1.0], method="Nelder-Mead", options=options).x
    found, nu = fit_one(d2, doubt, cut), 3 + np.exp(best[2])
    assert found.degrees_of_freedom == pytest.approx(nu, rel=1e-3)
    assert found.scale == pytest.approx(np.exp(best[0]) * nu / (nu - 2), rel=1e-3)
    assert found.doubt_sigma == pytest.approx(best[1] ** 2, rel=1e-3)
    assert found.truncation_sigma == pytest.approx(best[3] ** 2, rel=1e-3)


@pytest.mark.parametrize("growths", [(0.0, 0.0), (7.0, 0.0), (7.0, 2.0)])
def test_the_growths_are_what_doubtful_and_cut_errors_lack(growths):
    rng = np.random.default_rng(3)
    doubt, cut = rng.uniform(0, 1, (2, 20000))
    samples = multivariate_t.rvs(np.zeros(3), np.eye(3), df=5, size=20000, random_state=rng)
    grown = (1 + growths[0] * doubt) ** 2 * (1 + growths[1] * cut**2) ** 2
    found = fit_one((samples**2).sum(1) * grown, doubt, cut)
    assert found[1:3] == pytest.approx(growths, rel=0.05, abs=0.05)


def test_errors_about_either_of_two_modes_have_one_distribution():
    """Three in ten truths are about the second mode; far ones of the first give no scale."""
    rng, count = np.random.default_rng(4), 20000
    near = (
        multivariate_t.rvs(np.zeros(3), np.eye(3), df=5, size=count, random_state=rng) ** 2
    ).sum(1)
    d2, none = np.stack([near, np.full(count, 4000.0)], axis=1), np.zeros(count)
    swapped = rng.uniform(size=count) < 0.3
    d2[swapped] = d2[swapped, ::-1]
    found = fit_tails(d2, none, none, np.tile([0.7, 0.3], (count, 1)))
    assert found.degrees_of_freedom == pytest.approx(5, rel=0.1)
    assert found.scale == pytest.approx(5 / 3, rel=0.03)


def test_gaussian_errors_have_many_degrees_of_freedom():
    samples = np.random.default_rng(0).standard_normal((20000, 3))
    found = fit_one((samples**2).sum(1))
    assert found.degrees_of_freedom > 100
    assert found.scale == pytest.approx(1, rel=0.03)


def test_a_covariance_remains_where_there_is_none():
    """Of a Cauchy distribution."""
    samples = multivariate_t.rvs(np.zeros(3), np.eye(3), df=1, size=2000, random_state=1)
    found = fit_one((samples**2).sum(1))
    assert found.degrees_of_freedom == pytest.approx(LEAST_DEGREES_OF_FREEDOM, rel=1e-6)


def test_other_truths_lie_in_the_regions_of_every_level():
    model = Drawn()
    found = calibrate(model, split(0), absent())
    expected = [true / said for true, said in zip(TRUE_VARIANCES, SAID, strict=True)]
    np.testing.assert_allclose(found.variance_scales, expected, rtol=0.2)
    noise = 2 * np.sqrt(CURVE * (1 - CURVE) / COUNT)  # of the split that chose and that judges
    for axis, error in enumerate(errors(1)):
        d2 = (error**2).sum(1) / (SAID[axis] * float(found.variance_scales[axis]))
        share = coverage(region_probability(d2, found.degrees_of_freedom[axis]), CURVE)
        assert (np.abs(share - CURVE) <= 3 * noise).all()


def test_calibrating_again_changes_nothing():
    model = Drawn(distance_scale=1.1)
    found = calibrate(model, split(0), absent())
    model.variance_scales.copy_(found.variance_scales)
    model.config = replace(
        model.config,
        distance_scale=found.distance_scale,
        doubt_sigma=found.doubt_sigma,
        truncation_sigma=found.truncation_sigma,
        degrees_of_freedom=found.degrees_of_freedom,
    )
    again = calibrate(model, split(0), absent())
    torch.testing.assert_close(again.variance_scales, model.variance_scales)
    assert again.degrees_of_freedom == pytest.approx(found.degrees_of_freedom, rel=1e-4)
    assert again.distance_scale == pytest.approx(found.distance_scale, rel=1e-6)  # in float32


@pytest.mark.parametrize("wrong", [0.9, 1.0, 1.25])
def test_distances_that_are_all_wrong_by_a_factor_come_right(wrong):
    found = calibrate(Drawn(distance_scale=wrong), split(0), absent())
    assert found.distance_scale == pytest.approx(1.0, abs=1e-3)
    right = calibrate(Drawn(), split(0), absent()).variance_scales
    torch.testing.assert_close(found.variance_scales, right, rtol=2e-3, atol=0)


def test_the_correction_of_cut_distances_has_the_least_absolute_errors():
    rng = np.random.default_rng(0)
    shares = np.maximum(rng.uniform(-0.5, 0.5, 999), 0)
    too_far = 0.3 * shares**2 + rng.laplace(scale=0.1, size=999)
    found = truncation_distance(too_far, shares)
    best = minimize_scalar(lambda k: np.abs(too_far - k * shares**2).sum(), (0, 1))
    assert found == pytest.approx(best.x, abs=1e-6)
    assert found == pytest.approx(0.3, abs=0.1)
    assert truncation_distance(too_far, np.zeros(999)) == 0


@pytest.mark.parametrize("power", [2, 4])
@pytest.mark.parametrize("split_modes", [False, True])
def test_regions_of_much_cut_objects_hold_their_share_however_errors_grow(power, split_modes):
    """SciPy's distribution of F judges other draws; the growth found is of the squared share."""
    rng, count, nu = np.random.default_rng(6), 4000, 5.0

    def draw():
        cut, doubt = rng.uniform(0.35, 0.9, count), rng.random(count) ** 2
        scale = (1 + 3 * doubt) ** 2 * (1 + 8 * cut**power) ** 2
        return 3 * f.rvs(3, nu, size=count, random_state=rng) * scale, doubt, cut

    d2, doubt, cut = draw()
    p = np.ones((count, 1))
    if split_modes:  # half of the truths are about the second, farther than any region reaches
        d2, p = np.stack([d2, np.full(count, 1e9)], axis=1), np.full((count, 2), 0.5)
        d2[::2] = d2[::2, ::-1]
    else:
        d2 = d2[:, None]
    found = covering_growth(Tails(nu / (nu - 2), 3.0, 0.0, nu), d2, doubt, cut, p)
    if power == 2:
        assert found == pytest.approx(8, rel=0.1)
    d2, doubt, cut = draw()
    region = f.cdf(d2 / ((1 + 3 * doubt) * (1 + found * cut**2)) ** 2 / 3, 3, nu)
    assert (region <= 0.9).mean() == pytest.approx(0.9, abs=0.015)


@pytest.mark.parametrize(("size", "expected"), [(1e-3, 0.0), (1e12, MOST_GROWTH)])
def test_the_growth_is_none_at_least_and_bounded(size, expected):
    d2, doubt, cut, p = np.full((60, 1), size), np.zeros(60), np.full(60, 0.5), np.ones((60, 1))
    assert covering_growth(Tails(1.0, 0.0, 1.0, 5.0), d2, doubt, cut, p) == expected


class Beside(Drawn):
    """Finds what dark pictures show on the left border of the frame, and other objects ahead."""

    beside = (-2.56, 0.0, 1.0)

    def forward(self, images):
        dark = images.flatten(1).mean(1)[:, None] < 0.6
        found = (
            super()
            .forward(images)
            ._replace(
                translation=torch.where(dark, 20 * torch.tensor(self.beside), torch.tensor(AHEAD)),
            )
        )
        return calibrated(found, self.config)


def test_objects_that_the_border_cuts_come_nearer():
    """Half of their view is beyond it, and they are found too far by a tenth."""
    model = Beside()
    cut = [
        batch._replace(
            translation=math.exp(-0.1)
            * 20
            * torch.tensor([model.beside]).double().expand(len(batch.image), 3)
        )
        for batch in split(5, level=0.5)
    ]
    found = calibrate(model, split(0, level=0.8), absent(), cut)
    assert found.truncation_distance == pytest.approx(0.4, abs=4e-3)  # as the scale, over a quarter
    assert found.distance_scale == pytest.approx(1.0, abs=1e-3)
    model.config = replace(model.config, truncation_distance=found.truncation_distance)
    nearer = model(cut[0].image).translation
    torch.testing.assert_close(nearer.double(), cut[0].translation, rtol=1e-3, atol=0)


@pytest.mark.parametrize(("images", "kind"), [(400, "cut"), (40, "cut"), (400, "hard")])
def test_cut_objects_whose_errors_have_another_distribution_are_in_their_regions(images, kind):
    """Errors within a ball; too few, or whole objects, leave the growth of largest likelihood."""
    rng, model = np.random.default_rng(8), Beside()
    ways = rng.standard_normal((images, 3))
    moved = 2 * ways * (rng.random(images) ** (1 / 3) / np.linalg.norm(ways, axis=1))[:, None]
    cut = [
        batch._replace(translation=torch.tensor(20 * np.array(model.beside) + part))
        for batch, part in zip(split(5, images, level=0.5), np.split(moved, 4), strict=True)
    ]
    found = calibrate(model, split(0), absent(), **{kind: cut})
    variance = SAID[0] * float(found.variance_scales[0]) * (1 + found.truncation_sigma[0] / 4) ** 2
    regions = region_probability((moved**2).sum(1) / variance, found.degrees_of_freedom[0])
    share = (regions <= 0.9).mean()
    covered = images > LEAST_MOSTLY_CUT and kind == "cut"
    assert share == pytest.approx(0.9, abs=0.01) if covered else share > 0.95


def test_the_threshold_parts_what_can_be_parted():
    threshold = calibrate(Drawn(), split(0), absent(0.2)).in_view_threshold
    assert 0.2 < threshold < 0.8


@pytest.mark.parametrize("before", [(0.0, 0.0), (2.0, 5.0)])
def test_hard_images_of_which_the_network_doubts_have_regions_that_grow(before):
    """Their errors are three times those of the others, and their doubt is 0.5 more."""
    model = Drawn(doubt_sigma=before, doubt=None)  # which doubts as much as pictures lack of one
    hard = list(split(5, level=0.5, factor=3.0))
    found = calibrate(model, split(0, level=1.0), absent(), hard=hard)
    assert found.doubt_sigma == pytest.approx((4, 4), rel=0.1)
    assert found.distance_scale == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("before", [(0.0, 0.0), (3.0, 1.0)])
def test_growth_with_a_truncation_that_all_images_have_is_as_good_as_their_scale(before):
    """Half of each view is beyond the border, as its middle is on it."""
    cut = Drawn(truncation_sigma=before, camera=ON_THE_BORDER)
    found, plain = (calibrate(each, split(0), absent()) for each in (cut, Drawn()))
    grown = (1 + 0.25 * np.array(found.truncation_sigma)) ** 2
    scales = found.variance_scales.numpy() * grown
    np.testing.assert_allclose(scales, plain.variance_scales, rtol=1e-3)
    assert found.degrees_of_freedom == pytest.approx(plain.degrees_of_freedom, rel=1e-2)


def test_hard_images_do_not_count_for_distance_and_threshold():
    easy = calibrate(Drawn(), split(0), absent())
    both = calibrate(Drawn(), split(0), absent(), hard=split(5, level=0.1, factor=9.0))
    assert both.distance_scale == easy.distance_scale
    assert both.in_view_threshold == easy.in_view_threshold
    assert (both.variance_scales > easy.variance_scales).all()


class Leaning(PolarPose):
    """Finds what is ahead, and with a look at a point something nearer to the point.

    The offset that it measures is a share of the true one, other along the viewing ray than across.
    """

    measured = (0.9, 0.7)

    def forward(self, images):
        return Drawn().forward(images)

    def predict_near(self, images, points):
        found = self(images)
        truth = found.translation  # near which those of `split` lie
        ray = truth / truth.norm(dim=1, keepdim=True)
        off = truth - points
        along = (off * ray).sum(1, keepdim=True) * ray
        across, beside = (np.divide(self.measured, self.config.look_slope)).tolist()
        return found._replace(translation=points + across * (off - along) + beside * along)


@pytest.mark.parametrize("before", [(1.0, 1.0), (0.9, 0.7), (1.2, 0.6)])
def test_the_slopes_of_looks_are_found_whatever_they_were_divided_by(before):
    config = PRESETS["polar"].with_fields({"camera": FAR_WITHIN, "look_slope": before})
    model = Leaning.build(config, "none")
    found = calibrate(model, split(0), absent())
    assert found.look_slope == pytest.approx(Leaning.measured, rel=1e-3)


def test_looks_that_do_not_follow_are_not_mended():
    """Dividing by a slope of nearly nothing would make noise of what they find."""
    model = Leaning.build(PRESETS["polar"].with_fields({"camera": FAR_WITHIN}), "none")
    model.measured = (0.01, -0.3)
    assert calibrate(model, split(0), absent()).look_slope == (LEAST_SLOPE, LEAST_SLOPE)


def test_images_with_the_object_are_needed():
    with pytest.raises(ValueError, match="labeled: expected images that show the object, got none"):
        calibrate(Drawn(), [], absent())


def test_without_empty_images_scales_are_found_and_no_threshold():
    found = calibrate(Drawn(), split(0), [])
    assert found.in_view_threshold is None
    torch.testing.assert_close(
        found.variance_scales, calibrate(Drawn(), split(0), absent()).variance_scales
    )


def test_images_that_the_border_hardly_cuts_tell_nothing_of_much_cut_ones():
    """A tenth of the view of each is cut off, and errors along the ray are as they are without."""
    model = Drawn(camera=(100.0, 100.0, 13.25, 192.0))
    assert truncation(torch.tensor([AHEAD]), model.config).item() == pytest.approx(0.1, abs=0.01)
    found = calibrate(model, split(0, factor=3.0), absent())
    assert found.truncation_distance == 0
