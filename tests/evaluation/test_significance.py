"""Intervals and correlations against SciPy and NumPy, by hand and by their laws."""

import numpy as np
import pytest
from scipy.stats import bootstrap

from ffpose.evaluation.significance import circular_correlation, correlation, median_interval


@pytest.mark.parametrize("count", [5, 40, 41, 500])
def test_the_interval_is_scipys(count):
    values = np.random.default_rng(count).exponential(3.0, count)
    theirs = bootstrap(
        (values,), np.median, method="percentile", n_resamples=20_000, rng=1, vectorized=True
    ).confidence_interval
    spread = theirs.high - theirs.low
    np.testing.assert_allclose(median_interval(values), theirs, atol=0.1 * spread)


def test_the_interval_holds_the_true_median_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(300):
        low, high = median_interval(rng.normal(7, 2, 101))
        hits += low <= 7 <= high
    assert hits / 300 == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 300))


def test_the_order_does_not_matter():
    values = np.random.default_rng(0).normal(size=30)
    assert median_interval(values) == median_interval(values[::-1])
    assert median_interval([2.5]) == (2.5, 2.5)
    assert median_interval([1.0, 3.0]) == (1.0, 3.0)  # a quarter of the medians is each of them


@pytest.mark.parametrize("wrong", [[], [[1.0]], [1.0, np.nan]])
def test_what_has_no_median_is_refused(wrong):
    with pytest.raises(ValueError, match="values: expected finite numbers"):
        median_interval(wrong)


def test_circular_correlation_by_hand():
    """Mean directions 0 and 0; the sines are 1, -1, 0 and 0.5, -0.5, 0: they agree wholly.

    With b = 30, 0, -30 the products of the sines are 0.5, 0, 0: 0.5 / sqrt(2 * 0.5).
    """
    assert circular_correlation([90, -90, 0], [30, -30, 0]) == pytest.approx(1)
    assert circular_correlation([90, -90, 0], [30, 0, -30]) == pytest.approx(0.5)


def test_circular_correlation_of_small_angles_is_pearsons():
    rng = np.random.default_rng(1)
    a = rng.normal(0, 0.5, 400)
    b = 0.6 * a + rng.normal(0, 0.3, 400)
    expected = np.corrcoef(a, b)[0, 1]
    assert circular_correlation(a, b) == pytest.approx(expected, abs=1e-3)
    assert correlation(a, b) == pytest.approx(expected)


def test_circular_correlation_does_not_see_the_seam():
    rng = np.random.default_rng(2)
    a = rng.normal(170, 40, 300)
    b = a + rng.normal(0, 10, 300)
    wrapped = (b + 180) % 360 - 180
    assert circular_correlation(a, wrapped) == pytest.approx(circular_correlation(a, b))
    assert circular_correlation(a + 77, b - 123) == pytest.approx(circular_correlation(a, b))
    assert circular_correlation(a, -b) == pytest.approx(-circular_correlation(a, b))
    assert circular_correlation(a, b) > 0.9
    assert circular_correlation(a, a) == pytest.approx(1)


def test_independent_angles_do_not_correlate():
    a, b = np.random.default_rng(3).uniform(-180, 180, (2, 4000))
    assert abs(circular_correlation(a, b)) < 0.06
    assert abs(correlation(a, b)) < 0.06


def test_a_constant_correlates_with_nothing():
    a, b = np.linspace(-60, 60, 9), np.full(9, 12.3)
    for measure in (correlation, circular_correlation):
        assert measure(a, b) is None
        assert measure(b + 1e-9 * a, a) is None
