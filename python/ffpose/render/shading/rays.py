"""Camera rays, and the rectangle of pixels that a spacecraft may cover."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry import Camera, Pose
from ffpose.render.shading.tracer import Hits, Tracer
from ffpose.render.shading.vectors import Floats, rotate

NEAR_M = 0.05
LEAST_ROWS = 8
"""Least height of a band, so that smoothing over neighboring pixels has some."""


class Window(NamedTuple):
    """A rectangle of pixels: columns left … right − 1, rows top … bottom − 1."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of (rows, columns)."""
        return self.bottom - self.top, self.right - self.left

    def bands(self, pixels: int) -> Iterator[Window]:
        """Cut into bands of whole rows, about `pixels` each and at least `LEAST_ROWS` high."""
        rows, columns = self.shape
        count = max(1, rows // max(LEAST_ROWS, pixels // columns))
        edges = [self.top + rows * n // count for n in range(count + 1)]
        return (self._replace(top=top, bottom=bottom) for top, bottom in pairwise(edges))


class View(NamedTuple):
    """Hits of the rays through a window, in the object frame.

    Attributes:
        eye: (3,) position of the camera.
        rays: (3, H) unit vectors of the rays that hit the spacecraft.
        hits: Where they hit; `hits.ray` indexes the samples row by row.
    """

    eye: Floats
    rays: Floats
    hits: Hits

    @property
    def place(self) -> Floats:
        """Hit points (3, H), meters."""
        return np.asarray(self.eye[:, None] + self.rays * self.hits.distance)


@lru_cache(maxsize=4)
def pixel_rays(camera: Camera) -> Floats:
    """Return unit vectors (3, H·W) through the pixels' centers, row by row, camera frame."""
    return _unit_rays(camera, Window(0, 0, camera.width, camera.height), 1)


def find_window(vertices: NDArray[np.float64], pose: Pose, camera: Camera) -> Window | None:
    """Return the pixels that a mesh of vertices (V, 3) may cover, None if out of frame."""
    points = pose.transform(vertices)
    if points[:, 2].min() < NEAR_M:
        return Window(0, 0, camera.width, camera.height)
    u, v = camera.project(points).T
    left, right = max(0, math.floor(u.min())), min(camera.width, math.ceil(u.max()))
    top, bottom = max(0, math.floor(v.min())), min(camera.height, math.ceil(v.max()))
    return Window(left, top, right, bottom) if left < right and top < bottom else None


def cast_rays(tracer: Tracer, window: Window, camera: Camera, pose: Pose, samples: int) -> View:
    """Cast `samples` × `samples` rays through each pixel of a window."""
    back = pose.rotation.T
    rays = rotate(back, _unit_rays(camera, window, samples))
    eye = (-back @ pose.t).astype(np.float32)
    hits = tracer.first_hits(eye, rays.T, 1 / (camera.fx * samples))
    return View(eye, rays.take(hits.ray, axis=1), hits)


def smoothed(
    values: Floats,
    known: NDArray[np.intp],
    ray: NDArray[np.intp],
    window: Window,
    samples: int,
) -> Floats:
    """Average a noisy quantity over the 5 x 5 pixels around each sample.

    ``values`` (K,) are those of the samples of indices ``known`` (K,); the means (H,) of all
    samples ``ray`` (H,), as in `View`, are 1 where no value is near.
    """
    rows, columns = window.shape
    cells = rows * columns
    at = _pixel(known, columns, samples)
    sums = [np.bincount(at, values, cells), np.bincount(at, minlength=cells)]
    grids = np.stack(sums, dtype=np.float64).reshape(2, rows, columns)
    total, count = _box(_box(grids)).reshape(2, -1)
    mean = np.divide(total, count, out=np.ones(cells), where=count > 0).astype(np.float32)
    return mean.take(_pixel(ray, columns, samples))


def _pixel(ray: NDArray[np.intp], columns: int, samples: int) -> NDArray[np.intp]:
    """Return the indices of the pixels that samples lie in."""
    row, column = np.divmod(ray, columns * samples)
    return np.asarray(row // samples * columns + column // samples)


def _box(grids: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum (2, rows, columns) over 3 x 3 cells, with zeros outside."""
    across = grids.copy()
    across[..., 1:] += grids[..., :-1]
    across[..., :-1] += grids[..., 1:]
    total = across.copy()
    total[:, 1:] += across[:, :-1]
    total[:, :-1] += across[:, 1:]
    return total


def _unit_rays(camera: Camera, window: Window, samples: int) -> Floats:
    """Return unit vectors (3, N) through `samples` × `samples` places of each pixel, by rows."""
    u = (np.arange(window.left * samples, window.right * samples) + 0.5) / samples
    v = (np.arange(window.top * samples, window.bottom * samples) + 0.5) / samples
    x = ((u - camera.cx) / camera.fx).astype(np.float32)
    y = ((v - camera.cy) / camera.fy).astype(np.float32)
    columns, rows = np.meshgrid(x, y)
    length = np.sqrt(columns * columns + rows * rows + 1)
    return np.stack([columns / length, rows / length, 1 / length]).reshape(3, -1)
