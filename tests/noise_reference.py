"""The noise of `ffpose.render` in plain NumPy: the specification of the compiled one."""

import numpy as np

# What the next octave does to a point: a turn by 60 degrees about (1, 1, 1), made finer by 1.97.
TURN = 1.97 / 3 * np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]])
FACTORS = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D], dtype=np.uint32)
MIX = np.uint32(0x27D4EB2F)


def value_at(place):
    """(N,) the random numbers at whole places (3, N): a hash of 32 bits."""
    x, y, z = (place % 2**32).astype(np.uint32) * FACTORS[:, None]
    bits = x ^ y ^ z
    bits = (bits ^ (bits >> np.uint32(15))) * MIX
    bits = (bits ^ (bits >> np.uint32(13))) * MIX
    return bits.view(np.int32) / 2.0**31


def value_noise(points):
    """One octave in float64: trilinear interpolation with Perlin's smoothed weights."""
    low = np.floor(points)
    weight = points - low
    weight = weight * weight * (3 - 2 * weight)
    total = np.zeros(points.shape[1])
    for corner in np.ndindex(2, 2, 2):
        step = np.array(corner)[:, None]
        share = np.prod(np.where(step, weight, 1 - weight), axis=0)
        total += value_at((low + step).astype(np.int64)) * share
    return total


def slow_fbm(points, octaves, gain=0.5):
    points = points.astype(float)
    total = np.zeros(points.shape[1])
    for octave in range(octaves):
        total += gain**octave * value_noise(points)
        points = TURN @ points + 17.3
    return total / sum(gain**octave for octave in range(octaves))
