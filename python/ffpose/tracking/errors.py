"""Errors of a track where the true poses are known, and of the same frames posed alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ffpose.geometry import FloatArray, Pose
from ffpose.geometry.rotations import conjugate, multiply, rotation_matrix, rotation_vector
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.geometry.trajectory import Trajectory
from ffpose.tracking.tracker import Estimate

if TYPE_CHECKING:
    from ffpose.tracking.follow import Followed

NEES_BOUNDS = (4.40, 23.34)
NIS_BOUNDS = (1.24, 14.45)
"""Between which 95 % lie of χ² with 12 and with 6 degrees of freedom."""

SETTLED_S = 20.0
"""Seconds after acquisition from which on velocities count."""


@dataclass(frozen=True, eq=False)
class TrackErrors:
    """Errors of each frame; NaN where there is no track, no pose or no truth.

    True velocities are differences of true poses, and of one pose alone they are NaN.

    Attributes:
        times: ``(N,)`` seconds.
        errors: ``(N, 12)`` true minus estimated position (m), velocity (m/s), attitude (deg, about
            the object's axes) and angular velocity (deg/s).
        deviations: ``(N, 12)`` standard deviations that the track gives for them.
        nees: ``(N,)`` normalized estimation error squared, of 12 degrees of freedom.
        nis: ``(N,)`` normalized innovation squared, of 6 degrees of freedom.
        alone: ``(N, 2)`` errors of the frame alone: position (m) and attitude (deg).
        q: True attitudes ``(N, 4)`` that the track is compared with.
        turned: ``(N,)`` degrees that the object has turned since acquisition, along its way.
        since: ``(N,)`` seconds since the track was acquired, or acquired again.
    """

    times: FloatArray
    errors: FloatArray
    deviations: FloatArray
    nees: FloatArray
    nis: FloatArray
    alone: FloatArray
    q: FloatArray
    turned: FloatArray
    since: FloatArray

    @property
    def tracked(self) -> FloatArray:
        """Errors of the track ``(N, 2)``: position (m) and attitude (deg)."""
        t, r = self.errors[:, :3], self.errors[:, 6:9]
        return np.stack([np.linalg.norm(t, axis=1), np.linalg.norm(r, axis=1)], axis=1)

    def summary(self) -> dict[str, float]:
        """Return medians and shares by name, over the frames with a track and a truth."""
        there = np.isfinite(self.nees)
        both = there & np.isfinite(self.alone[:, 0])
        settled = there & (self.since >= SETTLED_S)
        tracked, low, high = self.tracked, *NEES_BOUNDS
        inside = (self.nees[there] >= low) & (self.nees[there] <= high)
        return {
            "frames": float(len(self.times)),
            "tracked": float(there.sum()),
            "median_position_m": _median(tracked[both, 0]),
            "median_position_alone_m": _median(self.alone[both, 0]),
            "p99_position_m": _high(tracked[both, 0]),
            "p99_position_alone_m": _high(self.alone[both, 0]),
            "median_attitude_deg": _median(tracked[both, 1]),
            "median_attitude_alone_deg": _median(self.alone[both, 1]),
            "p99_attitude_deg": _high(tracked[both, 1]),
            "p99_attitude_alone_deg": _high(self.alone[both, 1]),
            "largest_attitude_deg": float(tracked[there, 1].max()) if there.any() else np.nan,
            "median_velocity_m_s": _median(np.linalg.norm(self.errors[settled, 3:6], axis=1)),
            "median_rate_deg_s": _median(np.linalg.norm(self.errors[settled, 9:], axis=1)),
            "nees_inside": float(inside.mean()) if there.any() else np.nan,
        }


def track_errors(followed: Sequence[Followed], symmetry: SymmetryGroup = IDENTITY) -> TrackErrors:
    """Compare a track with the frames' poses; frames without one leave gaps.

    Errors of the track are modulo one rotation of ``symmetry``, chosen where an attitude begins to
    lead and kept while it does, those of frames alone modulo any.
    """
    count = len(followed)
    errors, deviations = np.full((2, count, 12), np.nan)
    nees, nis, turned, since = np.full((4, count), np.nan)
    alone, attitudes = np.full((count, 2), np.nan), np.full((count, 4), np.nan)
    compared = _Compared(symmetry)
    truth, places = _truth(followed)
    start, way = np.nan, 0.0
    for row, each in enumerate(followed):
        one, pose = each.step.estimate, each.frame.pose
        if one is None or each.step.outcome == "switched":
            compared.chosen = None
        nis[row] = np.nan if each.step.nis is None else each.step.nis
        if pose is not None and each.alone is not None and not each.alone.flagged:
            nearest = symmetry.nearest(each.alone.q, pose.q)
            turn = rotation_vector(multiply(conjugate(each.alone.q), nearest))
            alone[row] = np.linalg.norm(pose.t - each.alone.t), np.degrees(np.linalg.norm(turn))
        if pose is not None and len(symmetry) == 1:
            attitudes[row] = pose.q
        if one is None:
            start = np.nan
            continue
        deviations[row] = one.standard_deviations
        if np.isnan(start):
            start, way = each.frame.time, 0.0
        since[row] = each.frame.time - start
        if pose is None:
            continue
        place = places[row]
        if place and since[row] > 0:
            passed = min(truth.times[place] - truth.times[place - 1], since[row])
            way += float(np.degrees(np.linalg.norm(truth.w[place]))) * passed
        turned[row] = way
        attitudes[row], w = compared(one, pose, truth.w[place])
        turn = rotation_vector(multiply(conjugate(one.q), attitudes[row]))
        rate = w - np.radians(one.w)
        error = np.concatenate([pose.t - one.t, truth.v[place] - one.v, turn, rate])
        nees[row] = error @ np.linalg.solve(one.covariance, error)
        error[6:] = np.degrees(error[6:])
        errors[row] = error
    times = np.array([each.frame.time for each in followed])
    return TrackErrors(times, errors, deviations, nees, nis, alone, attitudes, turned, since)


class _Compared:
    """True attitudes to compare a track with: those of one rotation of the symmetry.

    It is chosen where an attitude begins to lead, as the nearest, and kept while it does; turns
    about an axis of any angle, which no image shows, are those of the track.
    """

    def __init__(self, symmetry: SymmetryGroup) -> None:
        self._symmetry = symmetry
        free = tuple(axis for axis in symmetry.axes if axis.fold == 0)
        self._spins, self._axis = SymmetryGroup(free), free[0].unit if free else np.zeros(3)
        self.chosen: FloatArray | None = None

    def __call__(self, one: Estimate, pose: Pose, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the true attitude and angular velocity, rad/s along its axes.

        ``w`` is the angular velocity along the axes of the true ``pose``.
        """
        if self.chosen is None:
            self.chosen = multiply(conjugate(pose.q), self._symmetry.nearest(one.q, pose.q))
        q = self._spins.nearest(one.q, multiply(pose.q, self.chosen))
        turned = w @ rotation_matrix(multiply(conjugate(pose.q), q))
        return q, turned + self._axis * (self._axis @ (np.radians(one.w) - turned))


def _truth(followed: Sequence[Followed]) -> tuple[Trajectory, dict[int, int]]:
    """Return the true motion, and for each frame with a true pose its row there."""
    poses = {
        row: each.frame.pose for row, each in enumerate(followed) if each.frame.pose is not None
    }
    times = np.array([followed[row].frame.time for row in poses])
    truth = Trajectory.through(times, [*poses.values()])
    if len(poses) == 1:
        unknown = np.full((1, 3), np.nan)
        truth = replace(truth, v=unknown, w=unknown)
    return truth, {row: place for place, row in enumerate(poses)}


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else np.nan


def _high(values: FloatArray) -> float:
    return float(np.quantile(values, 0.99)) if len(values) else np.nan
