"""Calibration of residuals that are drawn from known Gaussians."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ffpose.config import FilterformerPoseConfig
from ffpose.datasets import Sample
from ffpose.evaluation.calibration import coverage, region_probability, squared_mahalanobis
from ffpose.training.calibrate import (
    CHI_SQUARE_90,
    GROWTH_LIMIT,
    calibrate,
    sigma_growth,
    variance_scale,
)

COUNT = 2000
TRUE_VARIANCES = (0.09, 4e-4)
SAID = (0.03, 16e-4)
"""Predicted variances: a third of the true one for translation, four times for rotation."""


AHEAD = (0.0, 0.0, 40.0)


class Drawn(torch.nn.Module):
    """Answers one pose to pictures that hold one number each: their presence."""

    def __init__(self, view="object", distance_scale=1.0, hidden_sigma=(0.0, 0.0), hidden=0.0):
        super().__init__()
        self.share = hidden
        self.config = FilterformerPoseConfig(
            camera=(1.0, 1.0, 0.0, 0.0),
            orientation_view=view,
            distance_scale=distance_scale,
            hidden_sigma=hidden_sigma,
        )
        self.register_buffer("variance_scales", torch.ones(2))

    def forward(self, images):
        count = len(images)
        unit = torch.eye(3).expand(count, 3, 3)
        return (
            torch.tensor(AHEAD).expand(count, 3) * self.config.distance_scale,
            torch.tensor([1.0, 0, 0, 0]).expand(count, 4),
            unit * SAID[0] * self.variance_scales[0] * self.growth(0),
            unit * SAID[1] * self.variance_scales[1] * self.growth(1),
            images.flatten(1).mean(1),
        )

    def growth(self, axis):
        return (1 + self.config.hidden_sigma[axis] * self.share) ** 2

    def hidden(self, points):
        return torch.full((len(points),), self.share)


def split(seed, count=COUNT):
    """Batches of a split whose truths lie about the answers as `TRUE_VARIANCES` says."""
    rng = np.random.default_rng(seed)
    t = AHEAD + np.sqrt(TRUE_VARIANCES[0]) * rng.standard_normal((count, 3))
    turn = Rotation.from_rotvec(np.sqrt(TRUE_VARIANCES[1]) * rng.standard_normal((count, 3)))
    q = np.roll(turn.as_quat(), 1, axis=1)
    shown = torch.full((count, 3, 2, 2), 0.8)
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


def test_the_quantile_is_that_of_chi_square():
    assert pytest.approx(chi2.ppf(0.9, df=3), rel=1e-12) == CHI_SQUARE_90


@pytest.mark.parametrize("factor", [0.1, 1.0, 30.0])
def test_a_variance_is_scaled_by_what_it_lacks(factor):
    distances = factor * chi2.rvs(3, size=20000, random_state=1)
    assert variance_scale(distances) == pytest.approx(factor, rel=0.04)


def test_ninety_percent_of_other_truths_lie_in_the_region_of_ninety_percent():
    model = Drawn()
    scales = calibrate(model, split(0), absent()).variance_scales
    expected = [true / said for true, said in zip(TRUE_VARIANCES, SAID, strict=True)]
    np.testing.assert_allclose(scales, expected, rtol=0.1)
    noise = 2 * np.sqrt(0.9 * 0.1 / COUNT)  # of the split that chose and of that which judges
    for batches, axis in ((split(1), 0), (split(2), 1)):
        d2 = []
        for batch in batches:
            error = (
                batch.translation.numpy() - AHEAD
                if axis == 0
                else Rotation.from_quat(np.roll(batch.orientation, -1, axis=1)).as_rotvec()
            )
            said = np.tile(SAID[axis] * float(scales[axis]) * np.eye(3), (len(error), 1, 1))
            d2.append(squared_mahalanobis(error, said))
        share = coverage(region_probability(np.concatenate(d2)), [0.9])[0]
        assert abs(share - 0.9) < 3 * noise


def test_calibrating_again_changes_nothing():
    model = Drawn(distance_scale=1.1)
    found = calibrate(model, split(0), absent())
    model.variance_scales.copy_(found.variance_scales)
    model.config = replace(model.config, distance_scale=found.distance_scale)
    again = calibrate(model, split(0), absent())
    torch.testing.assert_close(again.variance_scales, model.variance_scales)
    assert again.distance_scale == pytest.approx(found.distance_scale, rel=1e-6)  # in float32


@pytest.mark.parametrize("wrong", [0.9, 1.0, 1.25])
def test_distances_that_are_all_wrong_by_a_factor_come_right(wrong):
    found = calibrate(Drawn(distance_scale=wrong), split(0), absent())
    assert found.distance_scale == pytest.approx(1.0, abs=1e-3)
    right = calibrate(Drawn(), split(0), absent()).variance_scales
    torch.testing.assert_close(found.variance_scales, right, rtol=2e-3, atol=0)


def test_the_threshold_parts_what_can_be_parted():
    threshold = calibrate(Drawn(), split(0), absent(0.2)).in_view_threshold
    assert 0.2 < threshold < 0.8


def test_the_growth_is_what_the_cut_objects_lack():
    """Covariances of σ² lack the growth k where the noise has σ (1 + k h)."""
    rng = np.random.default_rng(3)
    hidden = rng.uniform(0.2, 0.8, 20000)
    errors = (1 + 7 * hidden)[:, None] * rng.standard_normal((20000, 3))
    assert sigma_growth((errors**2).sum(1), hidden) == pytest.approx(7, rel=0.05)


def test_there_is_no_growth_where_none_is_needed():
    small = chi2.rvs(3, size=1000, random_state=1)
    assert sigma_growth(small / 4, np.full(1000, 0.5)) == 0.0


def test_a_growth_that_runs_into_its_limit_is_an_error():
    small = chi2.rvs(3, size=1000, random_state=1)
    with pytest.raises(ValueError, match=f"expected a growth below {GROWTH_LIMIT:g}, got 2084"):
        sigma_growth(small * 1e6, np.full(1000, 0.5))


@pytest.mark.parametrize("hidden", [[], [0.5, 0.0]])
def test_no_growth_is_found_where_nothing_is_hidden(hidden):
    with pytest.raises(ValueError, match="hidden: expected shares above 0, got"):
        sigma_growth(np.ones(len(hidden)), hidden)


def test_objects_of_which_nothing_is_hidden_are_no_part_of_the_fit():
    """Half of the cut objects are whole where the network sees them, and their errors are wild."""

    def cut(*shares):
        for share in shares:
            model.share = share
            for batch in split(5):
                wild = 50 if share == 0 else 3
                t = np.asarray(AHEAD) + wild * (batch.translation.numpy() - AHEAD)
                yield batch._replace(translation=torch.tensor(t))

    model = Drawn()
    model.hidden = lambda points: (
        torch.zeros(COUNT)
        if len(points) == COUNT
        else torch.cat([torch.zeros(COUNT), torch.full((COUNT,), 0.5)])
    )
    found = calibrate(model, split(0), absent(), cut(0.0, 0.5))
    assert found.hidden_sigma[0] == pytest.approx(4, rel=0.1)
    assert found.hidden == COUNT
    model.hidden = lambda points: torch.zeros(len(points))
    found = calibrate(model, split(0), absent(), cut(0.0))
    assert (found.hidden_sigma, found.hidden) == ((0.0, 0.0), 0)


@pytest.mark.parametrize("before", [(0.0, 0.0), (2.0, 5.0)])
def test_ninety_percent_of_cut_objects_lie_in_the_region_of_ninety_percent(before):
    """Errors as of whole objects times 1 + 4 / 2, and no growth wanted in rotation."""
    model = Drawn(hidden_sigma=before)

    def cut():
        model.share = 0.5
        for batch in split(5):
            t = np.asarray(AHEAD) + 3 * (batch.translation.numpy() - AHEAD)
            yield batch._replace(translation=torch.tensor(t))

    found = calibrate(model, split(0), absent(), cut())
    assert found.hidden_sigma[0] == pytest.approx(4, rel=0.1)
    assert found.hidden_sigma[1] < 0.2


def test_without_cut_objects_the_growth_stays():
    model = Drawn(hidden_sigma=(2.0, 5.0))
    assert calibrate(model, split(0), absent()).hidden_sigma == (2.0, 5.0)


def test_a_network_that_gives_no_uncertainty_is_refused():
    with pytest.raises(ValueError, match="expected one with a second look"):
        calibrate(Drawn("frame"), split(0), absent())


def test_images_with_the_object_are_needed():
    with pytest.raises(ValueError, match="labeled: expected images that show the object, got none"):
        calibrate(Drawn(), [], absent())


def test_without_empty_images_scales_are_found_and_no_threshold():
    found = calibrate(Drawn(), split(0), [])
    assert found.in_view_threshold is None
    torch.testing.assert_close(
        found.variance_scales, calibrate(Drawn(), split(0), absent()).variance_scales
    )


@pytest.mark.parametrize("bad", [[], [1.0, -1.0], [np.nan]])
def test_bad_distances_are_refused(bad):
    with pytest.raises(ValueError, match="expected finite numbers"):
        variance_scale(bad)
