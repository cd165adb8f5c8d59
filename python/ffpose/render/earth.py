"""The Earth and its air as seen from a low orbit, evaluated for each ray in three dimensions.

Lengths are in Earth radii. The air is one layer of exponential density with the zenith optical
depths of Rayleigh scattering and a little haze; light is scattered once. Land, clouds and city
lights are fractal noise on the sphere, so nothing has texture pixels, seams or poles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.render.noise import fbm
from ffpose.render.vectors import Floats, column, dot, rotate, smoothstep, unit

OPTICAL_DEPTH = (0.07, 0.13, 0.28)
"""Vertical optical depth of the air for red, green and blue."""

SCALE_HEIGHT = 0.0014
"""Height over which the air thins by e: 9 km, with some of the haze above the true 8."""

HORIZON_AIR_MASS = 38.0
LIMB_HEIGHTS = 9.0
SKY_LIGHT = 0.36
"""Radiance of endless air under the sun."""

OCEAN = (0.010, 0.026, 0.058)
FOREST = (0.040, 0.062, 0.026)
DESERT = (0.27, 0.22, 0.115)
ICE = (0.70, 0.73, 0.76)
CLOUD = 0.80
CITY = (0.040, 0.028, 0.013)
"""Radiance of a bright city by night, raised a hundredfold so that eight bits can show it."""

NIGHT = -0.18
"""Below this sine of the sun's height nothing but cities gives light."""

WAVE_SLOPE = 0.12
"""GGX alpha of wind-roughened water."""


class Earth(NamedTuple):
    """The Earth in the camera frame.

    Attributes:
        nadir: (3,) unit vector to its centre.
        altitude: of the camera, Earth radii.
        sun: (3,) unit vector to the sun.
        ground: (3, 3) rotation from the camera frame to the frame of land and clouds.
        octaves: detail of the clouds; finer images need more.
    """

    nadir: NDArray[np.float64]
    altitude: float
    sun: NDArray[np.float64]
    ground: NDArray[np.float64]
    octaves: int = 6

    @property
    def camera(self) -> Floats:
        """(3, 1) the camera's place seen from the Earth's centre."""
        return column(-self.nadir * (1.0 + self.altitude))


def shade_earth(earth: Earth, rays: Floats, pixel_angle: float) -> tuple[Floats, Floats]:
    """Light that comes along rays from the Earth and its air.

    Args:
        earth: where the Earth is.
        rays: (3, N) unit vectors, camera frame.
        pixel_angle: angle of one pixel in radians, over which the limb is smoothed.

    Returns:
        radiance (3, N), and (N,) the part of what lies behind that still shows.
    """
    radius = 1.0 + earth.altitude
    along = dot(earth.nadir, rays) * np.float32(radius)
    # Squared distance to the horizon, written so that nothing large cancels.
    horizon = earth.altitude * (2.0 + earth.altitude)
    closest: Floats = np.sqrt(np.maximum(np.float32(radius**2) - along * along, 0))
    disc: Floats = np.clip(0.5 - (closest - 1) / np.float32(pixel_angle * horizon**0.5), 0, 1)
    disc[along <= 0] = 0
    radiance = np.zeros_like(rays)
    behind: Floats = 1 - disc
    air = np.flatnonzero((along > 0) & (disc < 1) & (closest < 1 + LIMB_HEIGHTS * SCALE_HEIGHT))
    if air.size:
        glow, through = _limb(earth, rays[:, air], along[air], closest[air])
        radiance[:, air] = glow * behind[air]
        behind[air] *= through
    ground = np.flatnonzero(disc > 0)
    if ground.size:
        chord = np.sqrt(np.maximum(along[ground] ** 2 - np.float32(horizon), 0))
        seen = _surface(earth, rays[:, ground], along[ground] - chord)
        radiance[:, ground] += disc[ground] * seen
    return radiance, behind


def _limb(earth: Earth, rays: Floats, along: Floats, closest: Floats) -> tuple[Floats, Floats]:
    """Air above the limb: its glow (3, N) and its transmittance to starlight (N,)."""
    sun_height = dot(earth.sun, (rays * along + earth.camera) / closest)
    height = np.maximum(closest - 1, 0) / np.float32(SCALE_HEIGHT)
    depth = column(OPTICAL_DEPTH) * np.float32(2 * HORIZON_AIR_MASS) * np.exp(-height)
    through: Floats = np.exp(-depth)
    return (1 - through) * _sky(earth, rays, sun_height), through[1]


def _surface(earth: Earth, rays: Floats, distance: Floats) -> Floats:
    """Ground, sea, clouds and the air before them: radiance (3, N)."""
    place = unit(rays * distance + earth.camera)
    sun_height = dot(earth.sun, place)
    view_height = np.maximum(-dot(rays, place), 0)
    fixed = rotate(earth.ground, place)
    out = np.zeros_like(rays)
    day = np.flatnonzero(sun_height > NIGHT)
    if day.size:
        out[:, day] = _by_day(earth, rays[:, day], place[:, day], fixed[:, day], sun_height[day])
    dark = np.flatnonzero(sun_height < 0)
    if dark.size:
        out[:, dark] += _cities(fixed[:, dark]) * smoothstep(-sun_height[dark], 0.02, 0.15)
    air = np.reciprocal(view_height + np.float32(1 / HORIZON_AIR_MASS))
    through = np.exp(-column(OPTICAL_DEPTH) * air)
    out *= through
    out += (1 - through) * _sky(earth, rays, sun_height)
    return out


def _by_day(earth: Earth, rays: Floats, place: Floats, fixed: Floats, height: Floats) -> Floats:
    """Sunlight off ground, sea and clouds, without the air before them: radiance (3, N)."""
    albedo, sea = _cover(fixed, earth.octaves)
    light: Floats = np.maximum(height, 0)
    # Half of the air: much of what is bright are clouds, and they lie high.
    path = np.minimum(np.float32(0.5) / (light + np.float32(0.03)), 15)
    out = albedo + sea * _glint(earth, rays, place)
    out *= light
    out *= np.exp(column(OPTICAL_DEPTH) * -path)
    return out


def _sky(earth: Earth, rays: Floats, sun_height: Floats) -> Floats:
    """(3, N) light that endless air would scatter: white by day, red when the sun is low."""
    rise = smoothstep(sun_height, -0.12, 0.22)
    path = np.minimum(1 / (rise + np.float32(0.07)) - np.float32(1 / 1.07), 12)
    cosine = dot(earth.sun, rays)
    # Rayleigh's phase function and some forward scattering by haze.
    phase = np.float32(0.75) * (1 + cosine * cosine) + np.float32(0.4) * np.maximum(cosine, 0) ** 8
    sky: Floats = np.exp(column(OPTICAL_DEPTH) * -path)
    sky *= rise * phase * np.float32(SKY_LIGHT)
    return sky


def _glint(earth: Earth, rays: Floats, place: Floats) -> Floats:
    """(N,) mirror of the sun on the sea, as a factor of the light that falls in."""
    half = unit(column(earth.sun) - rays)
    facing = np.maximum(dot(half, place), 0)
    slope = np.float32(WAVE_SLOPE**2)
    spread = slope / (facing * facing * (slope - 1) + 1) ** 2
    fresnel = np.float32(0.02) + np.float32(0.98) * (1 - np.clip(dot(earth.sun, half), 0, 1)) ** 5
    view = np.maximum(-dot(rays, place), 0) + np.float32(0.15)
    result: Floats = np.minimum(fresnel * spread / (4 * view), 4)
    return result


def _cover(fixed: Floats, octaves: int) -> tuple[Floats, Floats]:
    """Albedo (3, N) of what covers the ground, and how much of it (N,) is open sea."""
    weather = fbm(fixed * np.float32(4), 3)
    swirl = fixed * np.float32(15) + weather * np.float32(1.3)
    cloud = fbm(swirl, octaves, 0.58) + np.float32(0.55) * weather
    cover = smoothstep(cloud, 0.03, 0.36) ** np.float32(1.3)
    tops = np.float32(CLOUD) * (np.float32(0.72) + np.float32(0.6) * smoothstep(cloud, 0.1, 1.0))
    relief = fbm(fixed * np.float32(2.6) + np.float32(31), octaves, 0.55)
    thick = np.flatnonzero(cover > 0.2)
    tops[thick] *= 1 + np.float32(0.45) * fbm(swirl[:, thick] * np.float32(9), 4, 0.7)
    land = smoothstep(relief, 0.045, 0.055)
    dry = smoothstep(weather + np.float32(1.5) * relief, 0.0, 0.5)
    ice = smoothstep(np.abs(fixed[2]) + np.float32(0.25) * relief, 0.90, 0.94)
    ground = column(FOREST) + (column(DESERT) - column(FOREST)) * dry
    ground *= np.float32(0.7) + np.float32(2) * relief
    ground = column(OCEAN) + (ground - column(OCEAN)) * land
    ground += (column(ICE) - ground) * ice
    bare = np.flatnonzero(((land > 0) | (ice > 0)) & (cover < 0.9))
    ground[:, bare] *= 1 + np.float32(0.9) * fbm(fixed[:, bare] * np.float32(90), 4, 0.6)
    albedo: Floats = ground + (tops - ground) * cover
    return albedo, (1 - land) * (1 - ice) * (1 - cover)


def _cities(fixed: Floats) -> Floats:
    """Lights on the night side: radiance (3, N)."""
    land = fbm(fixed * np.float32(2.6) + np.float32(31), 4, 0.55)
    region = smoothstep(fbm(fixed * np.float32(30), 3, 0.6), 0.05, 0.6)
    street = smoothstep(fbm(fixed * np.float32(260), 4, 0.9), 0.05, 0.7)
    bright = region * street * street * smoothstep(land, 0.04, 0.08)
    return column(CITY) * bright
