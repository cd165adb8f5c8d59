"""Sampling of textures, against NumPy in double precision."""

import numpy as np
import pytest

from ffpose.arrays import sample_texture


def neighbors(coordinate, count, wrap):
    place = coordinate * count - 0.5
    first = np.floor(place).astype(int)
    indices = np.arange(-3 * count, 4 * count)
    there = {
        0: np.pad(np.arange(count), 3 * count, "wrap"),
        1: np.pad(np.arange(count), 3 * count, "symmetric"),
        2: np.pad(np.arange(count), 3 * count, "edge"),
    }[wrap]
    table = dict(zip(indices.tolist(), there.tolist(), strict=True))
    return table[int(first)], table[int(first) + 1], place - first


def bilinear(level, u, v, wrap):
    left, right, across = neighbors(u, level.shape[1], wrap[0])
    top, bottom, down = neighbors(v, level.shape[0], wrap[1])
    upper = level[top, left] * (1 - across) + level[top, right] * across
    lower = level[bottom, left] * (1 - across) + level[bottom, right] * across
    return upper * (1 - down) + lower * down


@pytest.mark.parametrize("wrap", [(0, 0), (1, 2), (2, 1), (0, 1)])
@pytest.mark.parametrize("sides", [(16, 8), (4, 32), (1, 2)])
def test_values_are_those_of_double_precision(wrap, sides):
    rng = np.random.default_rng(3)
    levels = [rng.normal(size=(sides[1], sides[0], 4)).astype(np.float16)]
    while levels[-1].size > 4:
        height, width = (max(1, side // 2) for side in levels[-1].shape[:2])
        levels.append(rng.normal(size=(height, width, 4)).astype(np.float16))
    corners = rng.uniform(-1, 2, (5, 3, 2)).astype(np.float32)
    means = rng.normal(size=(5, 4)).astype(np.float16)
    face = rng.integers(0, 5, 77).astype(np.int32)
    weights = rng.dirichlet((1, 1, 1), 77).T.astype(np.float32, order="C")
    wanted = rng.uniform(-1, 7, 77).astype(np.float32)
    shares = rng.uniform(0, 1, 77).astype(np.float32)
    texels = np.concatenate([level.reshape(-1, 4) for level in levels])
    found = sample_texture(texels, sides, wrap, corners, means, face, weights, wanted, shares)
    assert found.dtype == np.float32
    for n in range(77):
        u, v = weights[:, n].astype(float) @ corners[face[n]].astype(float)
        level = levels[int(np.clip(np.rint(wanted[n]), 0, len(levels) - 1))].astype(float)
        value = bilinear(level, u, v, wrap)
        value += (means[face[n]] - value) * float(shares[n])
        # Coordinates of float32 are exact to 1e-7 of up to 64 texels.
        np.testing.assert_allclose(found[:, n], value, atol=5e-5)
