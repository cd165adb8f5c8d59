"""Tracks by a simulated network whose attitudes are modulo a symmetry of the object."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.geometry import Pose, PoseUncertainty
from ffpose.geometry.symmetry import IDENTITY, Axis, SymmetryGroup
from ffpose.tracking import Tracker, Unfolding
from ffpose.tracking.errors import track_errors
from ffpose.tracking.follow import follow
from ffpose.tracking.frames import Frame
from ffpose.tracking.report import write_report

FRAMES, NOISE_DEG = 120, 1.0
TWO, FOUR, ANY = (SymmetryGroup((Axis((0, 0, 1), fold),)) for fold in (2, 4, 0))
BOX = SymmetryGroup((Axis((0, 0, 1), 2), Axis((1, 0, 0), 2)))
FLIP = Rotation.from_rotvec([np.pi, 0, 0])


def truth(step):
    """A tumble of 1.5 degrees a second, 90 degrees in all."""
    turn = Rotation.from_rotvec(np.radians(1.5) * np.array([0.3, 0.9, 0.3]) * step / 2)
    q = Rotation.from_quat([0.5, 0.5, -0.5, 0.5], scalar_first=True) * turn
    return Pose([0.3, 0.1, 12.0], q.as_quat(scalar_first=True))


class Network:
    """A network that learned the labels that are canonical modulo a group."""

    near = camera = white = None

    def __init__(self, symmetry, told, wrong=(), shares=(1.0, 0.0)):
        self._symmetry, self._wrong, self._shares = symmetry, wrong, shares
        fields = {"locates": "object", "symmetry": told, "config": None}
        self.metadata = type("metadata", (), fields)
        rng = np.random.default_rng(0)
        self._noise = rng.normal(size=(FRAMES, 6)) * ([0.03] * 3 + [np.radians(NOISE_DEG)] * 3)

    def preprocess(self, path):
        return np.full((3, 1, 1), int(path.stem), np.float32)

    def estimate(self, inputs, points=None):
        return [self.pose(int(one[0, 0, 0])) for one in inputs]

    def pose(self, step):
        true, noise = truth(step), self._noise[step]
        q = Rotation.from_quat(true.q, scalar_first=True)
        q = q * FLIP if step in self._wrong else q
        q = q * Rotation.from_rotvec(noise[3:])
        seen = -q.inv().apply(true.t / np.linalg.norm(true.t))
        order = np.argsort(-(self._symmetry.references @ seen))
        one, other = (
            (q * Rotation.from_quat(self._symmetry.rotations[order[place]], scalar_first=True))
            for place in (0, min(1, len(order) - 1))
        )
        said = PoseUncertainty(
            1e-2 * np.eye(3),
            np.radians(2) ** 2 * np.eye(3),
            1.0,
            0.5,
            alternative=other.as_quat(scalar_first=True) if self._shares[1] else None,
            probabilities=self._shares,
        )
        return Pose(true.t + noise[:3], one.as_quat(scalar_first=True), said)


def tracked(network):
    frames = [Frame(Path(f"{step}.png"), step / 2, truth(step)) for step in range(FRAMES)]
    return list(follow(network, frames, Tracker()))


def errors(followed, symmetry):
    return track_errors(followed, symmetry).summary()


@pytest.mark.parametrize("symmetry", [TWO, FOUR, BOX, ANY], ids=str)
def test_errors_are_as_without_symmetry(symmetry, tmp_path):
    plain = errors(tracked(Network(IDENTITY, IDENTITY)), IDENTITY)
    followed = tracked(Network(symmetry, symmetry))
    assert [each.reason for each in followed] == ["acquiring"] * 3 + ["accepted"] * (FRAMES - 3)
    found = errors(followed, symmetry)
    names = [name for name in found if "attitude" in name or "rate" in name]
    if symmetry == ANY:  # the spin about the axis is not seen, and what is seen of the rest bends
        assert all(found[name] < plain[name] + 0.15 for name in names)
    else:
        np.testing.assert_allclose(*[[each[name] for name in names] for each in (found, plain)])
    turns = [
        Rotation.from_quat([a.alone.q, b.alone.q], scalar_first=True) for a, b in pairwise(followed)
    ]
    assert max((pair[0].inv() * pair[1]).magnitude() for pair in turns) < np.radians(8)
    if symmetry == FOUR:
        write_report(followed, tmp_path / "report.html", "folded", symmetry)


def test_without_it_a_folded_network_is_no_track():
    """The simulation is none where nothing must be done."""
    followed = tracked(Network(FOUR, IDENTITY))
    assert errors(followed, FOUR)["p99_attitude_deg"] > 45 or any(
        each.step.outcome in ("gated", "switched", "lost") for each in followed
    )


def test_two_labels_of_one_attitude_are_one_mode():
    """At the border between canonical labels a network tells both."""
    followed = tracked(Network(FOUR, FOUR, shares=(0.5, 0.5)))[:60]
    assert all(each.alone.uncertainty.alternative is None for each in followed)
    assert all(each.alone.uncertainty.probabilities == (1.0, 0.0) for each in followed)
    assert errors(followed, FOUR)["p99_attitude_deg"] < 3


def test_what_is_confused_beside_a_symmetry_is_followed_as_one_attitude():
    """A prism upside down at first, of whose looks four are equally far from the true one."""
    plain = tracked(Network(IDENTITY, IDENTITY, wrong=range(8)))
    followed = tracked(Network(FOUR, FOUR, wrong=range(8)))
    outcomes = [each.step.outcome for each in followed]
    assert outcomes == [each.step.outcome for each in plain]
    assert outcomes.count("switched") == 1
    assert errors(followed[-40:], FOUR)["p99_attitude_deg"] < 3


def test_what_has_nothing_to_unfold_is_the_same_pose():
    tracker = Tracker()
    pose = Network(FOUR, FOUR).pose(0)
    assert Unfolding(IDENTITY)(tracker, 0.0, pose) is pose
    empty = Pose(pose.t, pose.q, PoseUncertainty(np.eye(3), np.eye(3), 0.0, 0.5))
    assert Unfolding(FOUR)(tracker, 0.0, empty) is empty
    assert Unfolding(FOUR)(tracker, 0.0, truth(0)) == truth(0)
