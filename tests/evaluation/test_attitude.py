"""The parts of a rotation error against SciPy, by hand, and by the laws of swing and twist."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.evaluation.attitude import (
    rotation_error_vector,
    rotation_parts,
)


def random_case(count=200, seed=0):
    """Translations, true and predicted rotations."""
    rng = np.random.default_rng(seed)
    t = rng.normal([0, 0, 5], 2, (count, 3))
    return t, Rotation.random(count, rng=rng), Rotation.random(count, rng=rng)


def quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def rays(t):
    return t / np.linalg.norm(t, axis=1, keepdims=True)


def across(t):
    """Unit vectors perpendicular to the viewing rays."""
    return rays(np.cross(t, [0.3, -0.8, 0.1]))


def parts(t, true, predicted):
    return rotation_parts(quaternion(predicted), t, quaternion(true))


def angle_between(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=1), -1, 1)))


def test_out_of_plane_is_the_angle_of_the_viewing_directions_in_the_objects_frame():
    t, true, predicted = random_case()
    seen = angle_between(true.inv().apply(rays(t)), predicted.inv().apply(rays(t)))
    np.testing.assert_allclose(parts(t, true, predicted).out_of_plane_deg, seen, atol=1e-6)


def test_in_plane_is_what_the_smallest_turn_of_the_ray_leaves():
    t, true, predicted = random_case()
    error = predicted * true.inv()
    ray, turned = rays(t), error.apply(rays(t))
    axis = rays(np.cross(ray, turned))
    swing = Rotation.from_rotvec(axis * np.radians(angle_between(ray, turned))[:, None])
    twist = (swing.inv() * error).magnitude()
    np.testing.assert_allclose(parts(t, true, predicted).in_plane_deg, np.degrees(twist), atol=1e-6)


@pytest.mark.parametrize("degrees", [1e-10, 1e-5, 0.3, 60, 179.9999, 180])
def test_a_turn_about_the_ray_is_all_in_plane(degrees):
    t, true, _ = random_case()
    turn = Rotation.from_rotvec(rays(t) * np.radians(degrees))
    found = parts(t, true, turn * true)
    np.testing.assert_allclose(found.in_plane_deg, degrees, rtol=1e-9, atol=5e-14)
    np.testing.assert_allclose(found.out_of_plane_deg, 0, atol=1e-12)


@pytest.mark.parametrize("degrees", [1e-10, 1e-5, 0.3, 60, 179.9999])
def test_a_turn_across_the_ray_is_all_out_of_plane(degrees):
    t, true, _ = random_case()
    turn = Rotation.from_rotvec(across(t) * np.radians(degrees))
    found = parts(t, true, turn * true)
    np.testing.assert_allclose(found.out_of_plane_deg, degrees, rtol=1e-9, atol=5e-14)
    np.testing.assert_allclose(found.in_plane_deg, 0, atol=1e-7)


def test_seen_from_behind_there_is_no_twist():
    """By hand: half a turn about y is across the ray along z."""
    found = rotation_parts([[0.0, 0, 1, 0]], [[0.0, 0, 9]], [[1.0, 0, 0, 0]])
    assert found.out_of_plane_deg[0] == pytest.approx(180)
    assert found.in_plane_deg[0] == 0


def test_parts_make_up_the_whole_and_do_not_exceed_it():
    t, true, predicted = random_case()
    found = np.radians(parts(t, true, predicted))
    whole = (predicted * true.inv()).magnitude()
    assert (found <= whole + 1e-12).all()
    np.testing.assert_allclose(np.cos(found / 2).prod(axis=0), np.cos(whole / 2), atol=1e-12)


def test_a_turn_of_the_camera_changes_neither_part():
    t, true, predicted = random_case()
    camera = Rotation.random(rng=np.random.default_rng(5))
    turned = parts(camera.apply(t), camera * true, camera * predicted)
    np.testing.assert_allclose(turned, parts(t, true, predicted), atol=1e-9)


def test_signs_and_lengths_of_the_arguments_do_not_matter():
    t, true, predicted = random_case()
    q, q_hat = quaternion(true), quaternion(predicted)
    other = rotation_parts(2 * q_hat, 3 * t, -q)
    np.testing.assert_allclose(other, rotation_parts(q_hat, t, q), atol=1e-9)


@pytest.mark.parametrize("degrees", [0, 1e-9, 1e-3, 90, 179.9])
def test_the_rotation_vector_takes_the_prediction_to_the_truth(degrees):
    t, _, predicted = random_case()
    vector = rays(t) * np.radians(degrees)
    true = Rotation.from_rotvec(vector) * predicted
    for sign in (1, -1):
        found = rotation_error_vector(sign * quaternion(predicted), quaternion(true))
        np.testing.assert_allclose(found, vector, rtol=1e-5, atol=1e-14)


@pytest.mark.parametrize(
    ("place", "wrong", "error", "message"),
    [
        (1, np.zeros((3, 3)), ValueError, "t: expected finite numbers, not all zero, .* in row 0"),
        (2, np.full((3, 4), np.nan), ValueError, "q: expected finite"),
        (0, np.zeros((3, 4)), ValueError, "q_hat: expected finite"),
        (2, np.ones((2, 4)), ValueError, r"q: expected shape \(3, 4\), got \(2, 4\)"),
        (1, np.ones((3, 3), int), TypeError, "t: expected a floating dtype, got int64"),
    ],
)
def test_what_has_no_angle_is_refused(place, wrong, error, message):
    arguments = [np.ones((3, 4)), np.ones((3, 3)), np.ones((3, 4))]
    arguments[place] = wrong
    with pytest.raises(error, match=message):
        rotation_parts(*arguments)
