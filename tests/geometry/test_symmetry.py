"""Groups of rotations are those of SciPy, and what is modulo them is found by trying all."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffpose.errors import DataError
from ffpose.geometry.symmetry import IDENTITY, STEPS, Axis, SymmetryGroup

X, Y, Z = np.eye(3).tolist()


def group(*axes):
    return SymmetryGroup(tuple(Axis(tuple(direction), fold) for direction, fold in axes))


def quaternions(count, seed=0):
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_quat(scalar_first=True)


def angles(q, other):
    """Degrees from each ``q (N, 4)`` to each ``other (M, 4)``."""
    one, two = (Rotation.from_quat(each, scalar_first=True) for each in (q, other))
    return np.degrees([(one[n].inv() * two).magnitude() for n in range(len(q))])


@pytest.mark.parametrize(
    ("axes", "name"),
    [
        ([(X, 2), (Y, 2)], "D2"),
        ([(Z, 4)], "C4"),
        ([(Z, 6), (X, 2)], "D6"),
        ([(Z, 4), (X, 4)], "O"),
        ([((1, 1, 1), 3), (Z, 2)], "T"),
        ([((0.577, 0.577, 0.577), 3), (Z, 2)], "T"),  # as somebody writes it
        ([(Z, 60), (X, 2)], "D60"),
    ],
)
def test_axes_generate_scipys_group(axes, name):
    expected = Rotation.create_group(name, axis="Z").as_quat(scalar_first=True)
    found = group(*axes).rotations
    assert len(found) == len(expected)
    np.testing.assert_array_equal(found[0], (1, 0, 0, 0))
    assert angles(found, expected).min(axis=1).max() < 0.1
    assert angles(expected, found).min(axis=1).max() < 0.1


def test_an_axis_of_any_angle_is_sampled_finely():
    axis = (0.6, 0.0, 0.8)
    turns = Rotation.from_rotvec(np.linspace(0, 7, 50)[:, None] * np.array(axis))
    found = group((axis, 0), ((0, 1, 0), 2))
    assert len(found) == 2 * STEPS
    assert angles(turns.as_quat(scalar_first=True), found.rotations).min(axis=1).max() < 0.51
    over = turns * Rotation.from_rotvec([0, np.pi, 0])
    assert angles(over.as_quat(scalar_first=True), found.rotations).min(axis=1).max() < 0.51


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ([(Z, 0), (X, 0)], "leave an attitude"),
        ([(Z, 0), (X, 3)], "leave an attitude"),
        ([(Z, 5), (X, 5)], "finite group"),
        ([((0, 0, 0), 2)], "a direction of 3 numbers"),
        ([(Z, 61)], "fold: expected 0 to 60"),
    ],
)
def test_axes_that_go_not_together_are_refused(axes, message):
    with pytest.raises(ValueError, match=message):
        group(*axes)


@pytest.mark.parametrize("axes", [[(X, 2), (Y, 2)], [(Z, 4), (X, 4)]])
def test_the_nearest_attitude_of_one_look_is_found_by_trying_all(axes):
    symmetry, q_hat, q = group(*axes), quaternions(20), quaternions(20, 1)
    found = symmetry.nearest(q_hat, q)
    one = Rotation.from_quat(q, scalar_first=True)
    for n in range(len(q)):
        orbit = one[n] * Rotation.from_quat(symmetry.rotations, scalar_first=True)
        each = angles(q_hat[n : n + 1], orbit.as_quat(scalar_first=True))[0]
        assert angles(q_hat[n : n + 1], found[n : n + 1])[0, 0] == pytest.approx(each.min())
    nearest = symmetry.nearest(q_hat, found)  # it is the nearest of its own look
    assert np.diagonal(angles(nearest, found)).max() < 1e-5


@pytest.mark.parametrize("flip", [[], [((0.8, 0.0, -0.6), 2)]])
def test_errors_modulo_any_angle_are_those_of_a_fine_search(flip):
    """The search has steps of 0.01°; a rotation of the object about the axis counts as no error."""
    axis = np.array([0.6, 0.0, 0.8])
    symmetry, q_hat, q = group((axis.tolist(), 0), *flip), quaternions(12), quaternions(12, 1)
    found = symmetry.nearest(3 * q_hat, q)  # of any norm
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-14)
    error = np.diagonal(angles(q_hat, found))
    turns = Rotation.from_rotvec(np.radians(np.arange(0, 360, 0.01))[:, None] * axis)
    flips = [Rotation.identity(), *(Rotation.from_rotvec(np.pi * np.array(d)) for d, _ in flip)]
    one = Rotation.from_quat(q, scalar_first=True)
    for n in range(len(q)):
        orbit = Rotation.concatenate([one[n] * each * turns for each in flips])
        least = angles(q_hat[n : n + 1], orbit.as_quat(scalar_first=True)).min()
        assert error[n] <= least + 1e-9
        assert error[n] == pytest.approx(least, abs=0.01)
        assert angles(found[n : n + 1], orbit.as_quat(scalar_first=True)).min() < 0.006
        turned = (one[n] * flips[-1] * turns[12_345 + n]).as_quat(scalar_first=True)[None]
        assert angles(turned, symmetry.nearest(turned, q[n : n + 1]))[0, 0] < 1e-6


def test_turns_are_the_groups_own_within_a_degree():
    symmetry = group((Z, 0), (X, 2))
    turns = Rotation.from_rotvec(
        [[0, 0, 0.0123], [0, 0, 3], [np.pi, 0, 0], [0.9 * np.pi / 180, 0, 0]]
    )
    assert symmetry.has(turns.as_quat(scalar_first=True))
    away = Rotation.from_rotvec([[1.1 * np.pi / 180, 0, 0]])
    assert not symmetry.has(away.as_quat(scalar_first=True))


def test_without_symmetry_nothing_changes():
    q = quaternions(5)
    assert IDENTITY.nearest(quaternions(5, 1), q) is q
    assert len(IDENTITY) == 1


@pytest.mark.parametrize("axes", [[(X, 2), (Y, 2)], [(Z, 4), (X, 4)], [(Z, 0), (X, 2)], []])
def test_views_of_one_look_have_one_canonical_direction(axes):
    symmetry = group(*axes)
    turns = Rotation.from_quat(symmetry.rotations, scalar_first=True)
    directions = Rotation.random(40, rng=np.random.default_rng(2)).apply((0, 0, 1))

    def canonical(direction):
        chosen = (symmetry.references @ direction).argmax()
        return turns[chosen].inv().apply(direction)

    for direction in directions:
        first = canonical(direction)
        for other in turns[:: max(1, len(turns) // 24)].apply(direction).reshape(-1, 3):
            # Samples of an axis are a degree apart.
            np.testing.assert_allclose(canonical(other), first, atol=0.02)


def test_a_file_is_read_back_and_notes_are_left_alone(tmp_path):
    symmetry, path = group((Z, 0), (X, 2)), tmp_path / "symmetry.json"
    symmetry.write(path, near=[{"axis": [1, 0, 0]}])
    assert SymmetryGroup.read(path) == symmetry
    document = json.loads(path.read_text())
    assert document["axes"] == [{"axis": Z, "fold": "any"}, {"axis": X, "fold": 2}]
    assert SymmetryGroup.chosen(str(path)) == symmetry
    assert SymmetryGroup.chosen("none") == IDENTITY
    assert SymmetryGroup.chosen("auto") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "expected an object with axes"),
        ('{"axes": 3}', "axes: expected a list, got 3"),
        ('{"axes": [{"axis": [0, 0, 1]}]}', "axes: expected {.*fold"),
        ('{"axes": [{"axis": [0, 1], "fold": 2}]}', "axes: expected"),
        ('{"axes": [{"axis": [0, 0, 1], "fold": 1}]}', "axes: expected"),
        ('{"axes": [{"axis": [0, 0, 1], "fold": 2, "angle": 3}]}', "axes: expected"),
        ('{"axes": [{"axis": [0, 0, 1e999], "fold": 2}]}', "axes: expected"),
        ('{"axes": [{"axis": [0, 0, 0], "fold": 2}]}', "axis: expected a direction"),
    ],
)
def test_files_of_something_else_are_refused(tmp_path, text, message):
    path = tmp_path / "symmetry.json"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"symmetry\.json.*{message}"):
        SymmetryGroup.read(path)
