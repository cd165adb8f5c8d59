"""Tracks by a simulated network whose attitudes are modulo a symmetry of the object."""

import copy
import pickle
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.geometry import Pose, PoseUncertainty
from ffpose.geometry.symmetry import IDENTITY, Axis, SymmetryGroup
from ffpose.tracking import Tracker
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


def tracked(network, tracker=None):
    frames = [Frame(Path(f"{step}.png"), step / 2, truth(step)) for step in range(FRAMES)]
    tracker = tracker or Tracker(symmetry=network.metadata.symmetry)
    return list(follow(network, frames, tracker))


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
        Rotation.from_quat([a.step.estimate.q, b.step.estimate.q], scalar_first=True)
        for a, b in pairwise(followed[3:])
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
    tracker = Tracker(symmetry=FOUR)
    both = tracked(Network(FOUR, FOUR, shares=(0.5, 0.5)), tracker)
    one = tracked(Network(FOUR, FOUR))
    for each, other in zip(both, one, strict=True):
        assert (each.step.outcome, each.step.mode) == (other.step.outcome, other.step.mode)
        if each.step.estimate is not None:
            assert each.step.estimate.covariance == pytest.approx(other.step.estimate.covariance)
    assert tracker.alternative is None
    assert errors(both[:60], FOUR)["p99_attitude_deg"] < 3


def test_what_is_confused_beside_a_symmetry_is_followed_as_one_attitude():
    """A prism upside down at first, of whose looks four are equally far from the true one."""
    plain = tracked(Network(IDENTITY, IDENTITY, wrong=range(8)))
    followed = tracked(Network(FOUR, FOUR, wrong=range(8)))
    outcomes = [each.step.outcome for each in followed]
    assert outcomes == [each.step.outcome for each in plain]
    assert outcomes.count("switched") == 1
    assert errors(followed[-40:], FOUR)["p99_attitude_deg"] < 3


def test_a_state_and_a_copy_go_on_modulo_the_symmetry():
    network = Network(FOUR, FOUR)
    tracker = Tracker(symmetry=FOUR)
    tracked_until = [tracker.step(step / 2, network.pose(step)) for step in range(60)]
    assert tracked_until[-1].outcome == "accepted"
    copies = copy.copy(tracker), pickle.loads(pickle.dumps(tracker))
    again = (*copies, Tracker.from_state(tracker.state(), symmetry=FOUR))
    for other in again:
        assert other.symmetry == FOUR
    plain, lost = Tracker.from_state(tracker.state()), []
    for step in range(60, FRAMES):
        expected = tracker.step(step / 2, network.pose(step)).estimate.q.tolist()
        assert all(
            other.step(step / 2, network.pose(step)).estimate.q.tolist() == expected
            for other in again
        )
        lost.append(plain.step(step / 2, network.pose(step)).outcome != "accepted")
    assert any(lost)  # where the label changes


def test_a_tracker_of_another_symmetry_is_refused():
    with pytest.raises(ValueError, match=r"tracker: expected one of symmetry 4-fold about .*none"):
        tracked(Network(FOUR, FOUR), Tracker())
