"""The turn that errors gather about, against SciPy's rotations."""

import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.evaluation.confusion import most_confused


def attitudes():
    """300 true attitudes, and 300 that have nothing to do with them."""
    rng = np.random.default_rng(0)
    return Rotation.random(300, rng=rng), Rotation.random(300, rng=rng)


def quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def test_the_turn_that_errors_gather_about_is_found_in_the_objects_frame():
    true, elsewhere = attitudes()
    turn = Rotation.from_rotvec([0.0, np.radians(90), 0.0])
    noise = Rotation.from_rotvec(np.random.default_rng(1).normal(0, np.radians(2), (300, 3)))
    right, confused = true[:150] * noise[:150], true[150:240] * turn * noise[150:240]
    predicted = Rotation.concatenate([right, confused, elsewhere[240:]])
    found = most_confused(quaternion(predicted), -quaternion(true))
    np.testing.assert_allclose(found.rotation_vector_deg, [0, 90, 0], atol=1)
    assert found.share == pytest.approx(0.3, abs=0.01)


def test_errors_in_all_directions_gather_about_no_turn():
    true, predicted = attitudes()
    assert most_confused(quaternion(predicted), quaternion(true)).share < 0.03
    assert most_confused(quaternion(true), quaternion(true)).share == 0


def test_many_errors_are_compared_in_little_memory():
    """All pairs of 4000 at once would be 128 MB, and as much again for their absolute values."""
    rng = np.random.default_rng(0)
    gathered = Rotation.from_rotvec([np.radians(90), 0, 0])
    predicted = Rotation.concatenate([Rotation.random(3500, rng=rng), *[gathered] * 500])
    tracemalloc.start()
    found = most_confused(quaternion(predicted), np.tile([1.0, 0, 0, 0], (4000, 1)))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6
    np.testing.assert_allclose(found.rotation_vector_deg, [90, 0, 0], atol=1)
