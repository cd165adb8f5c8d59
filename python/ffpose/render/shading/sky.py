"""Background of the spacecraft: stars and the sun's disk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry import Camera
from ffpose.render.shading.vectors import Floats

SUN_RADIUS_RAD = 0.00465
SUN_RADIANCE = 150.0
"""Radiance of the sun's disk: saturated at any exposure, though a thousandth of the true one."""

STARS_TO_MAGNITUDE_ZERO = 5.0
"""Number of stars in the whole sky brighter than magnitude 0; 3.2 times more per magnitude."""
FAINTEST = 6.0
STAR_FLUX = 0.25
"""Radiance of a star of magnitude zero, collected in one pixel at 640 pixels of focal length."""


def draw_stars(
    camera: Camera,
    rng: np.random.Generator,
    side: int = 1,
    turn: NDArray[np.float64] | None = None,
) -> Floats:
    """Draw stars uniformly over the sky with the true count per magnitude: radiance (H, W, 3).

    There are ``side`` pixels of a finer image along each side of one of this, which is its mean;
    ``turn`` (3, 3) rotates the sky in the camera frame since the generator's stars were drawn.
    """
    total = rng.poisson(STARS_TO_MAGNITUDE_ZERO * 10 ** (0.5 * FAINTEST))
    rays = rng.standard_normal((total, 3))
    if turn is not None:
        rays = rays @ turn.T
    # Counts grow as 10^(0.5 m), so a uniform share of them gives a magnitude.
    magnitude = FAINTEST + 2.0 * np.log10(1.0 - rng.random(total))
    warmth = rng.normal(0.0, 0.18, total)
    ahead = rays[:, 2] > 0
    pixel = camera.project(rays[ahead])
    # Rays along the image plane have numbers beyond any pixel's.
    near = ((pixel > -1) & (pixel < (camera.width + 1, camera.height + 1))).all(axis=1)
    pixel = pixel[near]
    flux = STAR_FLUX * 10 ** (-0.4 * magnitude[ahead]) * (camera.fx * side / 640.0) ** 0.5
    flux /= side**2
    tint = np.stack([1 + warmth, np.ones_like(warmth), 1 - warmth], axis=1)[ahead]
    light = (flux[:, None] * np.clip(tint, 0.4, 1.6))[near]
    # A star is splatted on four pixels with bilinear weights.
    base = np.floor(pixel - 0.5).astype(np.int64)
    part = pixel - 0.5 - base
    image = np.zeros((camera.height * camera.width, 3), dtype=np.float32)
    for dy, dx in np.ndindex(2, 2):
        column, row = base[:, 0] + dx, base[:, 1] + dy
        weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
        seen = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        at = row[seen] * camera.width + column[seen]
        np.add.at(image, at, (weight[:, None] * light)[seen])
    return image.reshape(camera.height, camera.width, 3)


def sun_disk(sun: NDArray[np.float64], rays: Floats, pixel_angle: float, side: int = 1) -> Floats:
    """Compute the sun's radiance (N,) along unit rays (3, N), its rim smoothed over a pixel.

    The disk is at least as wide as a pixel, of ``pixel_angle`` radians, and has as much light as in
    a finer image of which there are ``side`` pixels along each side of one of this.
    """
    toward = np.asarray(sun, dtype=np.float32)
    radius = _disk_radius(pixel_angle)
    disk = np.zeros(rays.shape[1], dtype=np.float32)
    # Nearly all rays are far from the sun; the cosine has no digits to tell how far the others are.
    near = np.flatnonzero(toward @ rays > 1 - (radius + pixel_angle) ** 2)
    if near.size:
        offset = np.sqrt(((rays[:, near] - toward[:, None]) ** 2).sum(axis=0))
        inside = np.clip(0.5 - (offset - radius) / pixel_angle, 0, 1)
        light = SUN_RADIANCE * _disk_area(pixel_angle / side) / _disk_area(pixel_angle)
        disk[near] = inside * np.float32(light)
    return disk


def _disk_radius(pixel_angle: float) -> float:
    return max(SUN_RADIUS_RAD, 0.5 * pixel_angle)


def _disk_area(pixel_angle: float) -> float:
    """Integrate the smoothed disk; its rim falls linearly over a pixel."""
    return float(np.pi * (_disk_radius(pixel_angle) ** 2 + pixel_angle**2 / 12))
