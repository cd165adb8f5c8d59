"""The compiled Earth against the same formulas in NumPy, in float64 and without blocks."""

import os
import subprocess
import sys

import numpy as np
import pytest

from earth import Earth
from ffpose.arrays import instruction_set
from noise_reference import slow_fbm

DEPTH = np.array([[0.07], [0.13], [0.28]])
OCEAN, FOREST, DESERT, ICE, CITY, AIRGLOW = (
    np.array([row]).T
    for row in (
        (0.010, 0.026, 0.058),
        (0.040, 0.062, 0.026),
        (0.27, 0.22, 0.115),
        (0.70, 0.73, 0.76),
        (0.040, 0.028, 0.013),
        (0.0012, 0.0030, 0.0014),
    )
)


def dot(first, second):
    return (np.reshape(first, (3, -1)) * second).sum(axis=0)


def smoothstep(x, low, high):
    part = np.clip((x - low) / (high - low), 0, 1)
    return part * part * (3 - 2 * part)


def mix(first, second, part):
    return first + (second - first) * part


def sky(earth, rays, sun_height):
    rise = smoothstep(sun_height, -0.12, 0.22)
    path = np.minimum(1 / (rise + 0.07) - 1 / 1.07, 12)
    cosine = dot(earth.sun, rays)
    phase = 0.75 * (1 + cosine**2) + 0.4 * np.maximum(cosine, 0) ** 8
    return 0.36 * rise * phase * np.exp(-DEPTH * path)


def clouds(earth, fixed, weather):
    swirl = 15 * fixed + 1.3 * weather
    cloud = slow_fbm(swirl, earth.octaves, 0.58) + 0.55 * weather
    tops = 0.8 * (0.72 + 0.6 * smoothstep(cloud, 0.1, 1.0))
    cover = smoothstep(cloud, 0.03, 0.36) ** 1.25
    bumps = smoothstep(cover, 0.1, 0.3) * slow_fbm(9 * swirl, 4, 0.7)
    return cover, tops * (1 + 0.45 * bumps)


def ground(earth, fixed, weather):
    relief = slow_fbm(2.6 * fixed + 31, earth.octaves, 0.55)
    land = smoothstep(relief, 0.045, 0.055)
    ice = smoothstep(np.abs(fixed[2]) + 0.25 * relief, 0.90, 0.94)
    soil = mix(FOREST, DESERT, smoothstep(weather + 1.5 * relief, 0, 0.5)) * (0.7 + 2 * relief)
    sea = (1 - land) * (1 - ice)
    rough = 1 + 0.9 * (1 - sea) * slow_fbm(90 * fixed, 4, 0.6)
    return mix(mix(OCEAN, soil, land), ICE, ice) * rough, sea


def glint(earth, rays, place):
    half = earth.sun[:, None] - rays
    half = half / np.linalg.norm(half, axis=0)
    facing = np.maximum(dot(half, place), 0)
    lobe = 0.12**2 / (facing**2 * (0.12**2 - 1) + 1) ** 2
    fresnel = 0.02 + 0.98 * (1 - np.clip(dot(earth.sun, half), 0, 1)) ** 5
    view = np.maximum(-dot(rays, place), 0) + 0.15
    return np.minimum(fresnel * lobe / (4 * view), 4)


def cities(fixed, height):
    street = smoothstep(slow_fbm(260 * fixed, 4, 0.9), 0.05, 0.7)
    region = smoothstep(slow_fbm(30 * fixed, 3, 0.6), 0.05, 0.6)
    land = smoothstep(slow_fbm(2.6 * fixed + 31, 4, 0.55), 0.04, 0.08)
    return CITY * region * street**2 * land * smoothstep(-height, 0.02, 0.15)


def surface(earth, rays, distance, camera):
    place = rays * distance + camera
    place = place / np.linalg.norm(place, axis=0)
    height, fixed = dot(earth.sun, place), earth.ground @ place
    weather = slow_fbm(4 * fixed, 3)
    cover, tops = clouds(earth, fixed, weather)
    albedo, sea = ground(earth, fixed, weather)
    day = mix(albedo, tops, cover)
    day = day + sea * (1 - cover) * glint(earth, rays, place)
    light = np.maximum(height, 0)
    day = day * light * np.exp(-DEPTH * np.minimum(0.5 / (light + 0.03), 15))
    through = np.exp(-DEPTH / (np.maximum(-dot(rays, place), 0) + 1 / 38))
    return (day + cities(fixed, height)) * through + (1 - through) * sky(earth, rays, height)


def limb(earth, rays, along, closest, camera):
    height = np.maximum(closest - 1, 0)
    sun_height = dot(earth.sun, (rays * along + camera) / closest)
    through = np.exp(-DEPTH * 2 * 38 * np.exp(-height / 0.0014))
    above = (height - 0.0141) / 0.0012
    layer = np.exp(-(np.maximum(above, 0) ** 2)) / np.sqrt(1 - 2 * np.minimum(above, 0))
    night = smoothstep(-sun_height, 0.1, 0.25) * layer
    return (1 - through) * sky(earth, rays, sun_height) + AIRGLOW * night, through[1]


def slow_shade(earth, rays, pixel_angle):
    """Radiance (3, N), and how much of what lies behind still shows (N,)."""
    rays, radius = rays.astype(float), 1 + earth.altitude
    camera = -earth.nadir[:, None] * radius
    horizon = earth.altitude * (2 + earth.altitude)
    along = dot(earth.nadir, rays) * radius
    closest = np.sqrt(np.maximum(radius**2 - along**2, 0))
    disk = np.clip(0.5 - (closest - 1) / (pixel_angle * np.sqrt(horizon)), 0, 1) * (along > 0)
    air = (along > 0) & (closest < 1.018)
    glow, through = limb(earth, rays, along, closest, camera)
    distance = along - np.sqrt(np.maximum(along**2 - horizon, 0))
    seen = surface(earth, rays, distance, camera)
    behind = 1 - disk
    return np.where(air, glow, 0) * behind + disk * seen, behind * np.where(air, through, 1)


def random_unit(rng, shape=()):
    vector = rng.standard_normal((3, *shape))
    return vector / np.linalg.norm(vector, axis=0)


@pytest.mark.parametrize("seed", range(6))
def test_light_is_that_of_the_formulas(seed):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    earth = Earth(random_unit(rng), 0.0628, random_unit(rng), turn, octaves=5)
    rays = random_unit(rng, (4001,)) + 0.9 * earth.nadir[:, None]
    rays = (rays / np.linalg.norm(rays, axis=0)).astype(np.float32)
    radiance, behind = earth.shade(rays, 1e-2)
    expected, shows = slow_shade(earth, rays, 1e-2)
    assert 0.2 < (behind == 0).mean() < 0.9
    assert ((behind > 0) & (behind < 1)).sum() > 20
    np.testing.assert_allclose(behind, shows, atol=2e-3)
    # Fine noise turns the rounding of float32 places into a little light.
    wrong = np.abs(radiance - expected).max(axis=0)
    assert np.quantile(wrong, 0.99) < 2e-3
    assert wrong.max() < 0.05


def test_number_of_rays_does_not_change_a_bit():
    rng = np.random.default_rng(3)
    earth = Earth(random_unit(rng), 0.06, random_unit(rng), np.eye(3))
    rays = random_unit(rng, (640,)).astype(np.float32)
    whole, shows = earth.shade(rays, 1e-3)
    assert whole.shape == (3, 640)
    assert shows.shape == (640,)
    half, _ = earth.shade(rays[:, 320:], 1e-3)
    np.testing.assert_array_equal(whole[:, 320:], half)


SHADE = """
import hashlib, numpy as np
from ffpose.arrays import shade_earth
rays = np.random.default_rng(0).normal((0, 0, 2), 1, (5000, 3)).T
rays = (rays / np.linalg.norm(rays, axis=0)).astype(np.float32)
light, behind = shade_earth(rays, (0, 0, 1), 0.06, (1, 0, -0.1), np.eye(3).tolist(), 6, 1e-3)
print(hashlib.sha256(light.tobytes() + behind.tobytes()).hexdigest())
"""


def test_instruction_set_does_not_change_a_bit():
    printed = {
        subprocess.run(
            [sys.executable, "-c", SHADE],
            env=os.environ | {"FFPOSE_ISA": isa},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for isa in ("scalar", instruction_set())
    }
    assert len(printed) == 1


@pytest.mark.parametrize("shape", [(3,), (4, 5), (5, 3)])
def test_rays_of_another_shape_are_refused(shape):
    earth = Earth(np.array([0.0, 0.0, 1.0]), 0.06, np.array([1.0, 0.0, 0.0]), np.eye(3))
    with pytest.raises(ValueError, match=r"rays must have shape \(3, N\)"):
        earth.shade(np.zeros(shape, dtype=np.float32), 1e-3)
