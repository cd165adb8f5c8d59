"""The figures of a model card, on answers whose errors are drawn or made by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.evaluation.card.statistics import Answers, folded, refuse, summarize
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.geometry.symmetry import Axis, SymmetryGroup

RNG = np.random.default_rng(0)
TRANSLATION = np.diag([0.04, 0.09, 0.25])
ROTATION = np.array([[4e-4, 1e-4, 0], [1e-4, 9e-4, 0], [0, 0, 1e-4]])


def wxyz(rotation):
    return np.roll(rotation.as_quat(), 1)


def gaussian_answers(count, said=1.0):
    """Answers whose errors have the covariances above, and which say ``said`` times those."""
    truth, found = [], []
    for _ in range(count):
        attitude, t = Rotation.random(rng=RNG), np.array([0.0, 0.0, 20.0]) + RNG.normal(size=3)
        error = RNG.multivariate_normal(np.zeros(3), TRANSLATION)
        turn = Rotation.from_rotvec(RNG.multivariate_normal(np.zeros(3), ROTATION))
        uncertainty = PoseUncertainty(said * TRANSLATION, said * ROTATION, 0.9)
        found.append(Pose(t, wxyz(attitude), uncertainty))
        truth.append(Pose(t + error, wxyz(turn * attitude)))
    return Answers(found, truth)


def test_regions_of_the_right_covariance_hold_their_share():
    figures = summarize(gaussian_answers(1500), None)
    for name in ("translation", "rotation"):
        for level in (0.5, 0.9, 0.99):
            noise = np.sqrt(level * (1 - level) / 1500)
            assert abs(figures[name][f"coverage_{100 * level:.0f}"] - level) < 4 * noise


def test_regions_of_a_covariance_that_is_too_small_do_not():
    figures = summarize(gaussian_answers(500, said=0.25), None)
    assert figures["translation"]["coverage_90"] < 0.6
    assert figures["rotation"]["coverage_90"] < 0.6


def test_regions_are_of_both_modes():
    """Each truth is at the second mode: within the regions that hold more than the first mode."""
    half = Rotation.from_rotvec([0, 0, np.pi])
    attitudes = Rotation.random(10, rng=RNG)
    found, truth = [], []
    for attitude in attitudes:
        modes = {"alternative": wxyz(attitude * half), "probabilities": (0.9, 0.1)}
        said = PoseUncertainty(TRANSLATION, ROTATION, 0.9, **modes)
        found.append(Pose([0, 0, 10.0], wxyz(attitude), said))
        truth.append(Pose([0, 0, 10.0], wxyz(attitude * half)))
    figures = summarize(Answers(found, truth), None)
    assert [figures["rotation"][f"coverage_{n}"] for n in (50, 90, 99)] == [0, 1, 1]
    symmetry = SymmetryGroup((Axis((0, 0, 1), 2),))
    shown = summarize(folded(Answers(found, truth), symmetry), None, symmetry)
    assert [shown["rotation"][f"coverage_{n}"] for n in (50, 90, 99)] == [1, 1, 1]


def test_standard_deviations_are_those_of_the_covariances():
    figures = summarize(gaussian_answers(50), None)
    # The ray is nearly z: a variance of 0.25 along it.
    assert figures["median_sigma_distance_m"] == pytest.approx(0.5, rel=0.02)
    assert figures["median_sigma_rotation_deg"] == pytest.approx(np.degrees(np.sqrt(14e-4)))


def turned(axis, degrees, t=(0.0, 0.0, 10.0), in_view=None):
    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)["xyz".index(axis)])
    uncertainty = None if in_view is None else PoseUncertainty(np.eye(3), np.eye(3), in_view)
    return Pose(t, wxyz(turn), uncertainty)


AHEAD = Pose([0.0, 0.0, 10.0], [1.0, 0, 0, 0])


def test_errors_by_hand():
    """Turns about the viewing ray are in-plane, across it out-of-plane."""
    found = [turned("z", 10), turned("z", 20, (0, 3.0, 14.0)), turned("x", 40), turned("y", 50)]
    figures = summarize(Answers(found, [AHEAD] * 4), 0.5)
    assert figures["images"] == 4
    assert figures["median_rotation_error_deg"] == pytest.approx(30)
    assert figures["mean_rotation_error_deg"] == pytest.approx(30)
    assert figures["percentile_90_rotation_error_deg"] == pytest.approx(47)  # 40 + 0.7 * 10
    assert figures["share_over_30_deg"] == 0.5
    assert figures["median_in_plane_error_deg"] == pytest.approx(5)  # of 0, 0, 10, 20
    assert figures["median_out_of_plane_error_deg"] == pytest.approx(20)  # of 0, 0, 40, 50
    assert figures["mean_translation_error_m"] == pytest.approx(1.25)  # one of 5 m
    assert figures["mean_relative_translation_error"] == pytest.approx(0.125)
    low, high = figures["median_intervals_95"]["median_rotation_error_deg"]
    assert 10 <= low + 1e-9 < 30 < high <= 50 + 1e-9
    assert {"translation", "rotation", "flagged", "median_in_view"}.isdisjoint(figures)


def test_flags_are_counted_below_the_threshold():
    found = [turned("z", 1, in_view=p) for p in (0.1, 0.2, 0.5, 0.9)]
    figures = summarize(Answers(found, [AHEAD] * 4), 0.5)
    assert figures["flagged"] == 0.5
    assert figures["median_in_view"] == pytest.approx(0.35)
    assert "flagged" not in summarize(Answers(found, [AHEAD] * 4), None)


def test_refusals_by_hand():
    shown = [turned("z", 0, in_view=p) for p in (0.3, 0.8, 0.9, 0.95)]
    absent = [turned("z", 0, in_view=p) for p in (0.1, 0.6)]
    row = refuse(shown, absent, 0.5)
    assert row["images"] == 2
    assert row["auroc"] == 7 / 8  # of the eight pairs 0.3 and 0.6 alone stand the wrong way round
    assert row["false_alarm_rate"] == 1 / 4
    assert row["miss_rate"] == 1 / 2
    assert {"false_alarm_rate", "miss_rate"}.isdisjoint(refuse(shown, absent, None))


def test_answers_of_some_rows_stay_paired():
    found = [turned("z", angle) for angle in (1, 2, 3)]
    truth = [turned("x", angle) for angle in (1, 2, 3)]
    part = Answers(found, truth).of(np.array([True, False, True]))
    assert part == ([found[0], found[2]], [truth[0], truth[2]])


def test_no_answers_are_an_error():
    with pytest.raises(ValueError, match="expected at least one with the truth, got none"):
        summarize(Answers([], []), None)
