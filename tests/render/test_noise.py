"""The compiled noise against the same formula written in NumPy, and its laws."""

import numpy as np
import pytest

from ffpose.render.noise import LATTICE, fbm, lattice

# What the next octave does to a point: a turn by 60 degrees about (1, 1, 1), made finer by 1.97.
TURN = 1.97 / 3 * np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]])


def value_noise(points):
    """One octave in float64: trilinear interpolation with Perlin's smoothed weights."""
    low = np.floor(points)
    weight = points - low
    weight = weight * weight * (3 - 2 * weight)
    total = np.zeros(points.shape[1])
    for corner in np.ndindex(2, 2, 2):
        step = np.array(corner)[:, None]
        index = tuple((low + step).astype(int) % LATTICE)
        total += lattice()[index] * np.prod(np.where(step, weight, 1 - weight), axis=0)
    return total


def slow_fbm(points, octaves, gain):
    points = points.astype(float)
    total = np.zeros(points.shape[1])
    for octave in range(octaves):
        total += gain**octave * value_noise(points)
        points = TURN @ points + 17.3
    return total / sum(gain**octave for octave in range(octaves))


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(-60, 60, (3, 5000)).astype(np.float32)


@pytest.mark.parametrize(("octaves", "gain"), [(1, 0.5), (3, 0.5), (6, 0.58)])
def test_noise_is_that_of_the_formula(points, octaves, gain):
    # Points double with every octave, and so does the rounding of their float32 coordinates.
    np.testing.assert_allclose(
        fbm(points, octaves, gain), slow_fbm(points, octaves, gain), atol=2e-4 * octaves
    )


def test_noise_is_periodic_continuous_and_bounded(points):
    values = fbm(points, 1)
    assert np.abs(values).max() <= 1
    assert values.std() > 0.2
    np.testing.assert_allclose(fbm(points + LATTICE, 1), values, atol=2e-4)
    np.testing.assert_allclose(fbm(points + np.float32(1e-3), 1), values, atol=1e-2)
    assert np.abs(fbm(points, 6)).max() <= 1


def test_noise_meets_its_lattice():
    whole = np.array([[1, 2, 63, 0], [5, 5, 63, 64], [9, 9, 63, 0]], dtype=np.float32)
    expected = lattice()[tuple(whole.astype(int) % LATTICE)]
    np.testing.assert_array_equal(fbm(whole, 1), expected)
