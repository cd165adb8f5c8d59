"""Angles of correlation are found again in errors that were made with them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.correlation import correlation_angles
from ffpose.geometry import Pose, PoseUncertainty

SAID = PoseUncertainty(0.01 * np.eye(3), 1e-3 * np.eye(3), in_view=1)


def turning(rng, angles, step_deg=2.0, frames=120):
    """True and found poses of a steady turn, whose errors are Gauss-Markov in the angle turned."""
    kept = np.exp(-step_deg / np.array(angles))[:, None]
    axis, bias, pairs = rng.normal(size=3), rng.normal(size=(2, 3)), []
    axis /= np.linalg.norm(axis)
    for frame in range(frames):
        true = Rotation.from_rotvec(np.radians(step_deg * frame) * axis)
        seen = true * Rotation.from_rotvec(bias[1] * 1e-3**0.5)
        t = np.array([0, 0, 20.0])
        truth = Pose(t, true.as_quat(scalar_first=True))
        pairs.append((truth, Pose(t + 0.1 * bias[0], seen.as_quat(scalar_first=True), SAID)))
        bias = kept * bias + np.sqrt(1 - kept**2) * rng.normal(size=(2, 3))
    return pairs


def test_they_are_found_again():
    rng = np.random.default_rng(0)
    found = correlation_angles([turning(rng, (40, 25)) for _ in range(30)])
    assert found == {
        "position_angle": pytest.approx(40, rel=0.2),
        "attitude_angle": pytest.approx(25, rel=0.2),
    }


def test_an_object_that_rests_tells_nothing():
    with pytest.raises(ValueError, match="expected frames that turn by 1 to 60 degrees"):
        correlation_angles([turning(np.random.default_rng(0), (40, 25), step_deg=0.0)])
