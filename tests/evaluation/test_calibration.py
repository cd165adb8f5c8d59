"""Calibration against SciPy, pair counts and draws whose distribution is known."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.distance import mahalanobis
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f, mannwhitneyu, multivariate_t

from ffpose.evaluation.calibration import (
    CURVE,
    auroc,
    choose_threshold,
    coverage,
    flag_rates,
    mixture_probability,
    region_probability,
    squared_mahalanobis,
    summarize_flag,
    summarize_regions,
    truth_regions,
)


def drawn(count=20_000, seed=0):
    """Errors drawn from covariances that differ, and these."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, 3, 3)) + 2 * np.eye(3)
    error = (root @ rng.normal(size=(count, 3, 1)))[..., 0]
    return error, root @ root.transpose(0, 2, 1)


def test_mahalanobis_distance_is_scipys():
    error, covariance = drawn(20)
    expected = [
        mahalanobis(e, np.zeros(3), np.linalg.inv(c)) ** 2
        for e, c in zip(error, covariance, strict=True)
    ]
    np.testing.assert_allclose(squared_mahalanobis(error, covariance), expected)


def test_region_probability_is_chi_square_with_three_degrees_of_freedom():
    x = np.array([0, 1e-9, 1e-3, 0.5, 2.366, 3, 6.251, 11.345, 40, 2000])
    np.testing.assert_allclose(region_probability(x), chi2.cdf(x, 3), rtol=1e-9, atol=1e-15)


DISTANCES = np.array([0, 1e-9, 1e-3, 0.5, 2.366, 3, 6.251, 11.345, 40, 2000, 1e8])


@pytest.mark.parametrize("nu", [2.01, 2.5, 3, 4, 7.3, 30, 1000])
def test_region_probability_of_a_t_distribution_is_that_of_f(nu):
    """The covariance is nu / (nu - 2) times the scale matrix, whose distances over 3 are F's."""
    expected = f.cdf(DISTANCES * nu / (nu - 2) / 3, 3, nu)
    np.testing.assert_allclose(region_probability(DISTANCES, nu), expected, rtol=2e-9, atol=1e-15)


@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
def test_a_truth_on_the_quantile_has_its_probability(level):
    quantile = 3 * f.ppf(level, 3, 4) * (4 - 2) / 4
    assert region_probability(quantile, 4.0) == pytest.approx(level, rel=1e-9)


def test_many_degrees_of_freedom_are_gaussian():
    got = region_probability(DISTANCES, 1000)
    np.testing.assert_allclose(got, chi2.cdf(DISTANCES, 3), atol=1e-3)


def test_regions_of_t_distributed_errors_cover_what_they_say():
    """Poses whose errors SciPy draws; covariances are those of the distributions."""
    count, rng, degrees = 20_000, np.random.default_rng(0), (3.5, 6.0)
    scales = np.diag([0.04, 0.09, 0.25]), 1e-4 * np.array([[4, 1, 0], [1, 9, 0], [0, 0, 1]])
    moved, turned = (
        multivariate_t.rvs(np.zeros(3), scale, df=nu, size=count, random_state=rng)
        for scale, nu in zip(scales, degrees, strict=True)
    )
    attitude = Rotation.random(count, rng=rng)
    truth = Rotation.from_rotvec(turned) * attitude
    predicted, true = np.zeros((2, count, 7))
    true[:, :3] = moved
    predicted[:, 3:], true[:, 3:] = (r.as_quat(scalar_first=True) for r in (attitude, truth))
    covariances = (
        np.tile(scale * nu / (nu - 2), (count, 1, 1))
        for scale, nu in zip(scales, degrees, strict=True)
    )
    for probability in truth_regions(predicted, true, *covariances, degrees).values():
        np.testing.assert_allclose(coverage(probability, CURVE), CURVE, atol=0.015)


@pytest.mark.parametrize("nu", [None, 3.5])
def test_a_mode_that_is_sure_is_the_only_one(nu):
    both = np.stack([DISTANCES, DISTANCES[::-1]], axis=1)
    sure = np.tile([0.7, 0.0], (len(both), 1))
    np.testing.assert_allclose(
        mixture_probability(both, sure, nu), region_probability(DISTANCES, nu)
    )


@pytest.mark.parametrize("nu", [None, 5.0])
def test_the_smaller_region_about_the_less_likely_mode_ends_at_the_same_density(nu):
    """Of SciPy's densities and distribution functions; the region holds all modes' parts of it."""
    p, d2 = np.array([0.8, 0.2]), np.array([7.0, 1.0])

    def density(x):
        if nu is None:
            return np.exp(-x / 2)
        shape = np.eye(3) * (nu - 2) / nu  # of covariance one
        return multivariate_t.pdf([np.sqrt(x), 0, 0], np.zeros(3), shape, nu)

    def within(x):
        return chi2.cdf(x, 3) if nu is None else f.cdf(x * nu / (3 * (nu - 2)), 3, nu)

    level = max(p[0] * density(d2[0]), p[1] * density(d2[1]))
    ends = [brentq(lambda x, k=k: p[k] * density(x) - level, 0, 100) for k in (0, 1)]
    expected = p[0] * within(ends[0]) + p[1] * within(ends[1])
    assert mixture_probability(d2[None], p[None], nu)[0] == pytest.approx(expected, rel=1e-6)


def test_regions_of_two_modes_cover_what_they_say():
    """Attitudes that SciPy draws; about a third are half a turn off, as probabilities say."""
    count, rng, nu = 20_000, np.random.default_rng(0), 4.0
    scale = 1e-3 * np.array([[4, 1, 0], [1, 9, 0], [0, 0, 1.0]])
    turned = multivariate_t.rvs(np.zeros(3), scale, df=nu, size=count, random_state=rng)
    first = Rotation.random(count, rng=rng)
    second = first * Rotation.from_rotvec([0, 0, np.pi])
    probabilities = np.stack([p := rng.uniform(0.5, 0.9, count), 0.95 - p], axis=1)
    swapped = rng.uniform(0, 0.95, count) > p
    quaternions = [each.as_quat(scalar_first=True) for each in (first, second)]
    about = Rotation.from_quat(np.where(swapped[:, None], *quaternions[::-1]), scalar_first=True)
    true = (Rotation.from_rotvec(turned) * about).as_quat(scalar_first=True)
    predicted, truth = (
        np.concatenate([np.zeros((count, 3)), q], 1) for q in (quaternions[0], true)
    )
    covariances = np.tile(np.eye(3), (count, 1, 1)), np.tile(scale * nu / (nu - 2), (count, 1, 1))
    other = quaternions[1], probabilities
    found = truth_regions(predicted, truth, *covariances, (5.0, nu), *other)["rotation"]
    np.testing.assert_allclose(coverage(found, CURVE), CURVE, atol=0.015)
    alone = truth_regions(predicted, truth, *covariances, (5.0, nu))["rotation"]
    assert coverage(alone, [0.99])[0] < 0.8


def test_regions_of_the_true_covariance_cover_what_they_say():
    probability = region_probability(squared_mahalanobis(*drawn()))
    np.testing.assert_allclose(coverage(probability, CURVE), CURVE, atol=0.015)
    summary = summarize_regions(probability)
    assert summary["coverage_90"] == pytest.approx(0.9, abs=0.01)
    assert summary["reliability"]["nominal"][2] == pytest.approx(0.1)
    assert summary["reliability"]["empirical"][2] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_regions_of_another_size_cover_what_chi_square_says(scale):
    error, covariance = drawn()
    probability = region_probability(squared_mahalanobis(error, scale**2 * covariance))
    for level in (0.5, 0.9, 0.99):
        expected = chi2.cdf(scale**2 * chi2.ppf(level, 3), 3)
        assert coverage(probability, [level])[0] == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.diag([1.0, 1.0, 0.0]), "symmetric, positive definite matrices, .* in row 1"),
        (np.diag([1.0, 1.0, -1.0]), "symmetric, positive definite"),
        (np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "symmetric, positive definite"),
        (np.full((3, 3), np.nan), "covariance: expected finite numbers"),
    ],
)
def test_what_is_no_covariance_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        squared_mahalanobis(np.ones((2, 3)), np.stack([np.eye(3), change]))


def test_shapes_are_not_broadcast():
    with pytest.raises(ValueError, match=r"expected shape \(2, 3, 3\), got \(3, 3\)"):
        squared_mahalanobis(np.ones((2, 3)), np.eye(3))
    with pytest.raises(ValueError, match=r"error: expected shape \(N, 3\), got \(2, 2\)"):
        squared_mahalanobis(np.ones((2, 2)), np.ones((2, 3, 3)))
    with pytest.raises(ValueError, match="at least one truth"):
        coverage([])


def pair_count(positive, negative):
    wins = [(p > n) + 0.5 * (p == n) for p in positive for n in negative]
    return sum(wins) / len(wins)


@pytest.mark.parametrize("levels", [3, 10, 10**9])
def test_auroc_counts_pairs_and_half_of_the_ties(levels):
    rng = np.random.default_rng(levels)
    positive = rng.integers(levels // 4, levels, 40) / levels
    negative = rng.integers(0, levels - levels // 4, 30) / levels
    found = auroc(positive, negative)
    assert found == pytest.approx(pair_count(positive, negative))
    assert found == pytest.approx(mannwhitneyu(positive, negative).statistic / (40 * 30))
    assert auroc(negative, positive) == pytest.approx(1 - found)


def test_auroc_of_what_is_wholly_apart_and_of_what_is_alike():
    assert auroc([0.8, 0.9], [0.1, 0.7]) == 1
    assert auroc([0.5, 0.5], [0.5]) == 0.5


def test_rates_of_a_threshold_by_hand():
    rates = flag_rates([0.2, 0.5, 0.9, 1.0], [0.1, 0.5], threshold=0.5)
    assert rates == (0.5, 0.25, 0.5)


def test_the_chosen_threshold_is_the_best_of_all():
    rng = np.random.default_rng(7)
    positive, negative = rng.beta(5, 2, 200).round(2), rng.beta(2, 5, 100).round(2)
    chosen = choose_threshold(positive, negative)
    assert chosen == flag_rates(positive, negative, chosen.threshold)
    for threshold in np.linspace(0, 1.01, 305):
        rates = flag_rates(positive, negative, threshold)
        cost = rates.false_alarm_rate + rates.miss_rate
        assert chosen.false_alarm_rate + chosen.miss_rate <= cost + 1e-12


def test_the_chosen_threshold_lies_amid_the_gap():
    assert choose_threshold([0.8, 0.9], [0.1, 0.4]) == (pytest.approx(0.6), 0, 0)
    nearly = math.nextafter(0.5, 1)
    assert choose_threshold([nearly], [0.5]) == (nearly, 0, 0)


def test_scores_that_tell_nothing_flag_nothing():
    assert choose_threshold([0.1, 0.2], [0.8]) == (0.1, 0, 1)


def test_the_summary_without_empty_images_has_no_miss_rate():
    assert summarize_flag([0.2, 0.9], None, 0.5) == {"threshold": 0.5, "false_alarm_rate": 0.5}
    whole = summarize_flag([0.2, 0.9], [0.1, 0.2], 0.5)
    assert whole == {"threshold": 0.5, "false_alarm_rate": 0.5, "miss_rate": 0, "auroc": 0.875}


@pytest.mark.parametrize(("one", "other"), [([], [0.5]), ([0.5], []), ([np.nan], [0.5])])
def test_scores_that_are_none_are_refused(one, other):
    with pytest.raises(ValueError, match="object: expected finite numbers"):
        auroc(one, other)
