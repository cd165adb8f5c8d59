"""Tracks by a network whose attitudes are modulo a symmetry of the object.

Where rotations ``g`` leave the look unchanged (`ffpose.geometry.symmetry`), a network trained
modulo them answers a canonical one of the attitudes ``q g``, and another as soon as the view
crosses the border between two. A motion needs those that follow each other.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ffpose.geometry import FloatArray, Pose
from ffpose.geometry.rotations import conjugate, multiply, rotation_matrix
from ffpose.geometry.symmetry import SymmetryGroup
from ffpose.tracking.tracker import Tracker

if TYPE_CHECKING:
    from ffpose.tracking.follow import Followed

ONE_ATTITUDE = np.cos(np.radians(5.0) / 2)
"""Product of unit quaternions of two modes that are one attitude, as trackers unite theirs."""


class Unfolding:
    """Turns attitudes modulo a symmetry into those that continue a track.

    Of the attitudes of one look, which alone a network trained modulo the symmetry can tell, it
    takes the nearest to those that the tracker expects, and without a track to those of the frame
    before. Two modes that are one attitude then become one.

    Args:
        symmetry: That of the network (`PoseEstimator.metadata`).
    """

    def __init__(self, symmetry: SymmetryGroup) -> None:
        self._symmetry = symmetry
        self._last: list[FloatArray] = []

    def __call__(
        self,
        tracker: Tracker,
        time: float,
        pose: Pose,
        *,
        camera_rate: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Pose:
        """Return a pose for `Tracker.step`, whose arguments and errors these are."""
        said = pose.uncertainty
        if len(self._symmetry) == 1 or said is None or pose.flagged:
            return pose
        near = [*_expected(tracker, time, camera_rate), *self._last]
        q = self._nearest(pose.q, near)
        other, shares = said.alternative, said.probabilities
        if other is not None:
            other = self._nearest(other, [q, *near])
            if abs(other @ q) > ONE_ATTITUDE:
                other, shares = None, (min(1.0, sum(shares)), 0.0)
        self._last = [q] if other is None else [q, other]
        return Pose(pose.t, q, replace(said, alternative=other, probabilities=shares))

    def _nearest(self, q: FloatArray, near: list[FloatArray]) -> FloatArray:
        """Return of the attitudes of a look the nearest to any of some; itself without any."""
        if not near:
            return q
        wanted = np.array(near)
        found = self._symmetry.nearest(wanted, np.tile(q, (len(near), 1)))
        return np.asarray(found[np.abs((found * wanted).sum(axis=1)).argmax()])


def _expected(tracker: Tracker, time: float, camera_rate: ArrayLike) -> list[FloatArray]:
    """Return the attitude that leads and the next best, as they are expected at a time."""
    ahead = copy.copy(tracker)
    leading = ahead.step(time, None, camera_rate=camera_rate).estimate
    return [each.q for each in (leading, ahead.alternative) if each is not None]


class Compared:
    """True attitudes to compare a track with: those of one rotation of the symmetry.

    It is chosen where an attitude begins to lead, as the nearest, and kept while it does; turns
    about an axis of any angle, which no image shows, are those of the track.
    """

    def __init__(self, symmetry: SymmetryGroup) -> None:
        self._symmetry = symmetry
        free = tuple(axis for axis in symmetry.axes if axis.fold == 0)
        self._spins, self._axis = SymmetryGroup(free), free[0].unit if free else np.zeros(3)
        self._chosen: FloatArray | None = None

    def __call__(self, each: Followed, w: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return the true attitude and angular velocity, rad/s along its axes; None without.

        ``w`` is the angular velocity along the axes of the frame's own true attitude.
        """
        one, pose = each.step.estimate, each.frame.pose
        if one is None or each.step.outcome == "switched":
            self._chosen = None
        if one is None or pose is None:
            return None
        if self._chosen is None:
            self._chosen = multiply(conjugate(pose.q), self._nearest(self._symmetry, one.q, pose.q))
        q = self._nearest(self._spins, one.q, multiply(pose.q, self._chosen))
        turned = w @ rotation_matrix(multiply(conjugate(pose.q), q))
        return q, turned + self._axis * (self._axis @ (np.radians(one.w) - turned))

    @staticmethod
    def _nearest(group: SymmetryGroup, q_hat: FloatArray, q: FloatArray) -> FloatArray:
        return np.asarray(group.nearest(q_hat[None], q[None])[0])
