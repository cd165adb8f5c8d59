"""Poses, against SciPy and numbers worked out by hand."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ffpose.geometry import (
    URSO_CAMERA,
    Pose,
    PoseUncertainty,
    poses,
    standard_deviations,
)

ROW = {"x": 2.0, "y": 1.0, "z": 10.0, "q1": 0.0, "q2": 0.0, "q3": 0.0, "q4": 1.0}


def rotations(count, seed=0):
    return Rotation.random(count, rng=np.random.default_rng(seed))


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


def test_pose_takes_points_of_the_object_into_the_camera_frame():
    rotation = rotations(1)[0]
    points = np.random.default_rng(1).normal(size=(5, 2, 3))
    pose = Pose([1.0, -2.0, 30.0], wxyz(rotation))
    turned = rotation.apply(points.reshape(-1, 3)).reshape(points.shape)
    expected = turned + np.array([1.0, -2.0, 30.0])
    np.testing.assert_allclose(pose.transform(points), expected, atol=1e-14)


def test_both_signs_of_a_quaternion_are_one_pose():
    q = wxyz(rotations(1)[0])
    one, other = Pose([0, 0, 1], q), Pose([0, 0, 1], -q)
    np.testing.assert_array_equal(one.vector, other.vector)
    assert one.q[0] >= 0


@pytest.mark.parametrize(
    "q", [(0, 0, 0, 1), (0, 0, 1, 0), (0, 1, 0, 0), (0, 0, 0.6, -0.8), (0, -0.6, 0, 0.8)]
)
def test_half_a_turn_either_way_is_one_pose(q):
    one, other = Pose([1, 2, 3], q), Pose([1, 2, 3], np.negative(q))
    assert one == other
    assert hash(one) == hash(other)
    assert next(value for value in one.q if value != 0) > 0
    np.testing.assert_array_equal(one.rotation, other.rotation)


def uncertainty(scale=1.0, in_view=0.5):
    return PoseUncertainty(scale * np.eye(3), np.eye(3), in_view)


def test_poses_are_equal_by_value():
    pose = Pose([1, 2, 3], [0.6, 0.8, 0, 0])
    assert pose == Pose.from_vector(pose.vector)
    assert pose == pickle.loads(pickle.dumps(pose))
    assert Pose([0.0, 2, 3], [1, 0, 0, 0]) == Pose([-0.0, 2, 3], [1, -0.0, 0, 0])
    assert len({Pose([0.0, 2, 3], [1, 0, 0, 0]), Pose([-0.0, 2, 3], [1, -0.0, 0, 0])}) == 1
    others = [
        Pose([1, 2, 3.1], pose.q),
        Pose(pose.t, [0.8, 0.6, 0, 0]),
        Pose(pose.t, pose.q, uncertainty()),
        Pose(pose.t, pose.q, uncertainty(2.0)),
        Pose(pose.t, pose.q, uncertainty(in_view=0.6)),
    ]
    assert len({pose, *others}) == 6
    assert pose not in others
    assert Pose(pose.t, pose.q, uncertainty()) == others[2]
    assert pose != pose.vector.tolist()


def test_vector_is_translation_then_quaternion_scalar_first():
    pose = Pose.from_vector([1, 2, 3, 0.5, 0.5, -0.5, 0.5])
    assert pose.t.tolist() == [1, 2, 3]
    assert pose.q.tolist() == [0.5, 0.5, -0.5, 0.5]
    np.testing.assert_array_equal(pose.vector, [1, 2, 3, 0.5, 0.5, -0.5, 0.5])


def test_a_rounded_quaternion_is_normalized():
    pose = Pose([0, 0, 1], [0.7071, 0.0, 0.7071, 0.0])
    np.testing.assert_allclose(np.linalg.norm(pose.q), 1, atol=1e-15)


def test_a_pose_cannot_be_changed_and_survives_pickling():
    pose = Pose([0, 0, 1], [1, 0, 0, 0])
    with pytest.raises(ValueError, match="read-only"):
        pose.q[0] = 2
    with pytest.raises(AttributeError):
        pose.t = np.zeros(3)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(pose)).vector, pose.vector)


@pytest.mark.parametrize(
    ("t", "q", "error", "words"),
    [
        ([0, 0, 1], [0, 0, 0, 0], ValueError, "expected norm 1 within 0.001, got 0"),
        ([0, 0, 1], [1.01, 0, 0, 0], ValueError, "got 1.01"),
        ([0, 0, 1], [1, 0, 0, np.nan], ValueError, "expected finite"),
        ([0, 0, np.inf], [1, 0, 0, 0], ValueError, "expected finite"),
        ([0, 0], [1, 0, 0, 0], ValueError, r"expected shape \(..., 3\), got \(2,\)"),
        ([0, 0, 1], [1, 0, 0], ValueError, r"expected shape \(..., 4\), got \(3,\)"),
        ([[0, 0, 1]], [1, 0, 0, 0], ValueError, r"got \(1, 3\) and \(4,\)"),
        (1.0, [1, 0, 0, 0], ValueError, r"got \(\)"),
        (["a", "b", "c"], [1, 0, 0, 0], TypeError, "expected real numbers"),
        ([0, 0, 1j], [1, 0, 0, 0], TypeError, "expected real numbers, got dtype complex128"),
    ],
)
def test_a_bad_pose_is_refused(t, q, error, words):
    with pytest.raises(error, match=words):
        Pose(t, q)


def test_urso_check_value():
    # u = 640 + 640 * 2 / 10; URSO's y is up, so v = 480 - 640.463 * 1 / 10.
    u, v = Pose.from_urso(**ROW).project([0, 0, 0], URSO_CAMERA)
    assert u == pytest.approx(768, abs=1e-9)
    assert v == pytest.approx(415.9537, abs=1e-9)


def test_urso_conversion_is_the_mirror_of_jpls_matrix():
    # SciPy reads (q1, q2, q3, q4) as Hamilton's, scalar last; JPL's matrix is its transpose.
    quaternions = rotations(50, seed=2).as_quat()
    mirror = np.diag([1.0, -1.0, 1.0])
    for q in quaternions:
        row = ROW | dict(zip(("q1", "q2", "q3", "q4"), q, strict=True))
        expected = mirror @ Rotation.from_quat(q).as_matrix().T @ mirror
        np.testing.assert_allclose(Pose.from_urso(**row).rotation, expected, atol=1e-14)


def test_urso_conversion_shows_a_point_where_ursos_own_frame_does():
    # In URSO's frame: p = C q-rotated object point + t, u = cx + fx x / z, v = cy - fy y / z.
    q = rotations(1, seed=3)[0].as_quat()
    row = ROW | dict(zip(("q1", "q2", "q3", "q4"), q, strict=True))
    point = np.array([0.3, -0.8, 0.5])
    x, y, z = Rotation.from_quat(q).as_matrix().T @ point + [2.0, 1.0, 10.0]
    expected = [640 + 640 * x / z, 480 - 640.463 * y / z]
    mirrored = point * [1, -1, 1]
    np.testing.assert_allclose(Pose.from_urso(**row).project(mirrored, URSO_CAMERA), expected)


@given(st.integers(0, 2**32 - 1))
def test_urso_labels_survive_the_way_there_and_back(seed):
    rng = np.random.default_rng(seed)
    pose = Pose(rng.normal(size=3), wxyz(Rotation.random(rng=rng)))
    np.testing.assert_allclose(Pose.from_urso(**pose.to_urso()).vector, pose.vector, atol=1e-15)


def test_standard_deviations_against_samples():
    generator = np.random.default_rng(0)
    half = generator.standard_normal((2, 3, 3)) * np.array([0.3, 0.01])[:, None, None]
    translation, rotation = half @ half.transpose(0, 2, 1)
    t = np.array([1.0, -2.0, 9.0])
    uncertainty = PoseUncertainty(translation, rotation, 1.0)
    distance, in_plane, out_of_plane = standard_deviations(t, uncertainty)
    moved = t + 1e-3 * generator.multivariate_normal(np.zeros(3), translation, 200_000)
    lengths = np.linalg.norm(moved, axis=1)  # a small step, for which length is linear
    assert distance == pytest.approx(lengths.std() / 1e-3, rel=0.01)
    vectors = generator.multivariate_normal(np.zeros(3), rotation, 200_000)
    turns = np.degrees(Rotation.from_rotvec(vectors).as_rotvec())
    along = turns @ (t / np.linalg.norm(t))
    assert in_plane == pytest.approx(np.sqrt((along**2).mean()), rel=0.01)
    across = (turns**2).sum(axis=1) - along**2
    assert out_of_plane == pytest.approx(np.sqrt(across.mean()), rel=0.01)


def test_a_pose_is_flagged_below_the_networks_threshold():
    def flagged(in_view, threshold):
        said = PoseUncertainty(np.eye(3), np.eye(3), in_view, threshold)
        return Pose([0, 0, 10], [1, 0, 0, 0], said).flagged

    assert flagged(0.25, 0.3) is True
    assert flagged(0.3, 0.3) is False  # below it, not at it
    assert flagged(0.25, None) is None
    assert Pose([0, 0, 10], [1, 0, 0, 0]).flagged is None
    (pose,) = poses(
        *([[0, 0, 10]], [[1, 0, 0, 0]], np.eye(3)[None], np.eye(3)[None], [0.1]),
        in_view_threshold=0.2,
    )
    assert pose.flagged is True
    with pytest.raises(ValueError, match=r"in_view_threshold: expected a probability, got 1\.5"):
        flagged(0.25, 1.5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"degrees_of_freedom": (4.0, 2.0)}, r"degrees_of_freedom: expected above 2 each, got \(4"),
        ({"alternative": [1.0, 1.0, 0.0, 0.0]}, "expected norm 1"),
        ({"alternative": np.eye(4)}, r"alternative: expected shape \(4,\), got \(4, 4\)"),
        ({"probabilities": (0.5, 1.5)}, r"probabilities: expected in 0…1, got \(0\.5, 1\.5\)"),
    ],
)
def test_tails_and_modes_that_are_none_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        PoseUncertainty(np.eye(3), np.eye(3), 0.5, **wrong)


def test_uncertainties_with_other_modes_differ():
    fields = {"alternative": [0.0, 1.0, 0.0, 0.0], "probabilities": (0.5, 0.25)}
    one, same = (PoseUncertainty(np.eye(3), np.eye(3), 0.5, **fields) for _ in range(2))
    assert one == same
    assert hash(one) == hash(same)
    for change in ({"alternative": [0.0, 0.0, 1.0, 0.0]}, {"probabilities": (0.5, 0.5)}):
        assert one != PoseUncertainty(np.eye(3), np.eye(3), 0.5, **(fields | change))
    assert one != PoseUncertainty(np.eye(3), np.eye(3), 0.5, None, (5.0, 5.0), **fields)


def test_a_batch_has_a_second_mode_each():
    covariances = np.tile(np.eye(3), (2, 1, 1))
    second = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]]
    found = poses(
        *(np.tile([0, 0, 10], (2, 1)), np.tile([1, 0, 0, 0], (2, 1)), covariances, covariances),
        *([0.5, 0.75], second, [[0.75, 0.25], [0.5, 0.125]]),
        degrees_of_freedom=(5.0, 3.0),
    )
    said = [pose.uncertainty for pose in found]
    assert [each.alternative.tolist() for each in said] == [second[0], [0.0, 0.0, 0.0, 1.0]]
    assert [each.probabilities for each in said] == [(0.75, 0.25), (0.5, 0.125)]
    assert [each.degrees_of_freedom for each in said] == [(5.0, 3.0)] * 2
