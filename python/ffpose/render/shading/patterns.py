"""Procedural surface patterns: solar cells, foil, quilted cloth, panels.

A pattern changes the points `at` of a `Surface`. Texture coordinates and the footprint of a pixel
are in units of the material's scale, positions in meters. Lines thinner than a pixel are averaged
over it, so that they do not alias.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.arrays import fractal_noise
from ffpose.render.shading.vectors import Floats, column
from ffpose.render.spacecraft.materials import Pattern

Indices = NDArray[np.intp]


class Surface(NamedTuple):
    """Surface attributes of N shaded points; arrays (3, N) or (N,)."""

    color: Floats
    roughness: Floats
    metallic: Floats
    emission: Floats
    normal: Floats
    reflectance: Floats


def fbm(points: Floats, octaves: int, gain: float = 0.5) -> Floats:
    """Sum octaves of noise, each at about twice the frequency and `gain` times the amplitude.

    The first octave has its lattice points 1 apart in points (3, N), float32. The sums (N,),
    float32, lie within −1…1, most of them within ±0.5.
    """
    heights = gain ** np.arange(octaves)
    return fractal_noise(points, (heights / heights.sum()).astype(np.float32))


def _lines(coordinate: Floats, width: float, footprint: Floats) -> Floats:
    """Return the fraction (N,) of a pixel on lines of `width` around the whole numbers."""
    offset = np.abs(coordinate - np.round(coordinate))
    soft = np.maximum(footprint, np.float32(1e-4))
    cover = np.clip((np.float32(width / 2) - offset) / soft + np.float32(0.5), 0, 1)
    # A pixel wider than the spacing covers many lines: the share of the area that they take.
    share = np.float32(width)
    return np.asarray(np.where(footprint > 0.5, share, np.minimum(cover, share / soft + share)))


def _grid(uv: Floats, width: float, footprint: Floats) -> Floats:
    return np.maximum(_lines(uv[0], width, footprint), _lines(uv[1], width, footprint))


def _bump(surface: Surface, at: Indices, points: Floats, height: float, octaves: int) -> None:
    """Perturb the normals by noise over `points` (3, N)."""
    for axis in range(3):
        wave = fbm(points + np.float32(11.7 * axis), octaves)
        surface.normal[axis, at] += np.float32(height) * wave


def _cells(surface: Surface, at: Indices, uv: Floats, place: Floats, footprint: Floats) -> None:
    gap = _grid(uv, 0.07, footprint)
    seed = np.floor(np.stack([uv[0], uv[1], uv[0] + 3 * uv[1]])) * np.float32(7.3)
    tone = 1 + np.float32(0.3) * fbm(seed, 1)
    cell = surface.color[:, at] * tone
    surface.color[:, at] = cell + (column((0.20, 0.19, 0.17)) - cell) * gap
    surface.roughness[at] += np.float32(0.25) * gap


def _foil(surface: Surface, at: Indices, uv: Floats, place: Floats, footprint: Floats) -> None:
    _bump(surface, at, place * np.float32(20), 0.4, 4)


def _blanket(surface: Surface, at: Indices, uv: Floats, place: Floats, footprint: Floats) -> None:
    seam = _grid(uv, 0.035, footprint)
    tone = 1 + np.float32(0.4) * fbm(place * np.float32(3), 3)
    surface.color[:, at] *= tone * (1 - np.float32(0.5) * seam)
    _bump(surface, at, place * np.float32(5), 0.22, 3)


def _panels(surface: Surface, at: Indices, uv: Floats, place: Floats, footprint: Floats) -> None:
    joint = _grid(uv, 0.03, footprint)
    tone = 1 + np.float32(0.12) * fbm(place * np.float32(4), 3)
    surface.color[:, at] *= tone * (1 - np.float32(0.6) * joint)


DRAW: dict[Pattern, Callable[[Surface, Indices, Floats, Floats, Floats], None]] = {
    Pattern.CELLS: _cells,
    Pattern.FOIL: _foil,
    Pattern.BLANKET: _blanket,
    Pattern.PANELS: _panels,
}
"""Function that draws each pattern; a plain surface has no entry."""
