"""The compiled noise against the same formula written in NumPy, and its laws."""

import numpy as np
import pytest

from ffpose.render.shading.patterns import fbm
from noise_reference import slow_fbm


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(-60, 60, (3, 5000)).astype(np.float32)


@pytest.mark.parametrize(("octaves", "gain"), [(1, 0.5), (3, 0.5), (6, 0.58)])
def test_noise_is_that_of_the_formula(points, octaves, gain):
    # Points double with every octave, and so does the rounding of their float32 coordinates.
    np.testing.assert_allclose(
        fbm(points, octaves, gain), slow_fbm(points, octaves, gain), atol=2e-4 * octaves
    )


def test_noise_is_continuous_and_bounded(points):
    values = fbm(points, 1)
    assert np.abs(values).max() <= 1
    assert values.std() > 0.2
    np.testing.assert_allclose(fbm(points + np.float32(1e-3), 1), values, atol=1e-2)
    assert np.abs(fbm(points, 6)).max() <= 1


def test_values_at_whole_numbers_are_uniform_and_independent():
    cube = np.stack(np.meshgrid(*[np.arange(-24, 24)] * 3, indexing="ij")).reshape(3, -1)
    values = fbm(cube.astype(np.float32), 1).astype(float)
    counts, _ = np.histogram(values, bins=32, range=(-1, 1))
    expected = len(values) / 32
    # Chi squared with 31 degrees of freedom: mean 31, standard deviation 8.
    assert ((counts - expected) ** 2 / expected).sum() < 31 + 5 * 8
    grid = values.reshape(48, 48, 48)
    for shift in ((0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1), (1, 1, 1), (2, 0, 0)):
        moved = np.roll(grid, shift, axis=(0, 1, 2))
        assert abs((grid * moved).mean()) < 5 / 3 / np.sqrt(grid.size)
