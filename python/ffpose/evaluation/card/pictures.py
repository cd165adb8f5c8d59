"""Out-of-distribution images: charts, noise, and clutter with the statistics of photographs.

They test whether a network detects that the object is not in view. Each is a pure function of a
generator and a size, drawn with NumPy and Pillow alone. Except for noise they differ in kind from
the negatives of training (`ffpose.training.clutter`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw

from ffpose.geometry import FloatArray

Color = tuple[int, int, int]

LEAVES = 400
LEAST_RADIUS = 0.01
"""Radius of the smallest leaf relative to the image's width; the largest is a third of it."""

WORDS = ("distance", "error", "epoch", "latency", "median", "throughput", "yaw", "loss")


def chart(rng: np.random.Generator, size: tuple[int, int]) -> Image.Image:
    """Draw a chart: axes, a grid, bars or lines of random heights, and words."""
    width, height = size
    paper = (30, 30, 34) if rng.random() < 0.2 else (255, 255, 255)
    ink = (255 - paper[0], 255 - paper[1], 255 - paper[2])
    picture = Image.new("RGB", size, paper)
    draw = ImageDraw.Draw(picture)
    left, right = 0.12 * width, 0.95 * width
    top, bottom = 0.12 * height, 0.88 * height
    for y in np.linspace(top, bottom, int(rng.integers(4, 9))):
        draw.line((left, y, right, y), fill=(160, 160, 160))
        draw.text((0.02 * width, y - 5), f"{bottom - y:.0f}", fill=ink)
    heights = bottom - rng.uniform(0.05, 1.0, (int(rng.integers(1, 4)), 12)) * (bottom - top)
    places = np.linspace(left, right, heights.shape[1] + 1)
    bars = rng.random() < 0.5
    for series in heights[:1] if bars else heights:
        color = _color(rng)
        if bars:
            for x, y in zip(places, series, strict=False):
                draw.rectangle((x, y, x + 0.7 * (places[1] - left), bottom), fill=color)
        else:
            points = [(float(x), float(y)) for x, y in zip(places, series, strict=False)]
            draw.line(points, fill=color, width=max(1, width // 200))
    draw.line((left, top, left, bottom, right, bottom), fill=ink, width=max(1, width // 320))
    for place, word in zip((0.3, 0.6), rng.choice(WORDS, 2), strict=True):
        draw.text((place * width, 0.92 * height), str(word), fill=ink)
    return picture


def noise(rng: np.random.Generator, size: tuple[int, int]) -> Image.Image:
    """Draw white noise of a random strength about a random color."""
    width, height = size
    spread = rng.uniform(5, 80)
    return _image(rng.uniform(0, 255, 3) + spread * rng.standard_normal((height, width, 3)))


def clutter(rng: np.random.Generator, size: tuple[int, int]) -> Image.Image:
    """Draw clutter with the statistics of photographs: dead leaves with a texture of all scales.

    Disks that occlude each other, with radii r distributed as r^-3, have the edges and the power
    spectrum of natural images (Lee, Mumford and Huang, "Occlusion Models for Natural Images", IJCV
    2001); clouds whose amplitude falls with the frequency add texture.
    """
    width, height = size
    picture = Image.new("RGB", size, _color(rng))
    draw = ImageDraw.Draw(picture)
    # For r^-3 between a and b, 1 / r^2 is uniform between 1 / b^2 and 1 / a^2.
    radii = rng.uniform(3.0**2, LEAST_RADIUS**-2, LEAVES) ** -0.5 * width
    middles = rng.uniform(0, 1, (LEAVES, 2)) * (width, height)
    for (x, y), r in zip(middles.tolist(), radii.tolist(), strict=True):
        draw.ellipse((x - r, y - r, x + r, y + r), fill=_color(rng))
    light = np.exp(0.4 * _clouds(rng, size))[..., None]
    return _image(np.asarray(picture) * light)


PICTURES: dict[str, tuple[str, Callable[[np.random.Generator, tuple[int, int]], Image.Image]]] = {
    "charts": ("bars and lines with axes and words", chart),
    "noise": ("without grain, any color and strength", noise),
    "clutter": ("dead leaves with clouds, as photographs in their statistics", clutter),
}
"""Description and drawing function of each kind."""


def draw_picture(kind: str, seed: int, index: int, size: tuple[int, int]) -> Image.Image:
    """Return image ``index`` of a kind, ``size`` ``(width, height)``; always the same pixels."""
    rng = np.random.default_rng([seed, index, list(PICTURES).index(kind)])
    return PICTURES[kind][1](rng, size)


def _color(rng: np.random.Generator) -> Color:
    red, green, blue = rng.integers(0, 256, 3).tolist()
    return red, green, blue


def _clouds(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Return 1 / f noise ``(height, width)`` with mean 0 and variance 1."""
    width, height = size
    f = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    f[0, 0] = np.inf
    waves = np.fft.rfft2(rng.standard_normal((height, width))) / f
    clouds = np.fft.irfft2(waves, (height, width))
    return np.asarray(clouds / clouds.std())


def _image(values: FloatArray) -> Image.Image:
    """Round values ``(height, width, 3)`` to pixels, saturating at 0 and 255."""
    return Image.fromarray(np.clip(np.round(values), 0, 255).astype(np.uint8))
