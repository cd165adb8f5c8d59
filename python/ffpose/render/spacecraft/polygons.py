"""Triangles of polygons.

A fan from the first corner fills a convex polygon. That of a concave one also covers what is
outside of it, and folds back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Triangle = tuple[int, int, int]

FLAT = 1e-6
"""Area, relative to the polygon's, below which a triangle has none."""


def triangulated(points: Floats) -> NDArray[np.intp]:
    """Return the triangles (P, N - 2, 3) of polygons (P, N, 3), numbers of their corners."""
    fan = [(0, k, k + 1) for k in range(1, points.shape[1] - 1)]
    corners = np.tile(np.array(fan, np.intp), (len(points), 1, 1))
    if points.shape[1] == 3:
        return corners
    for k in np.flatnonzero(_folded(points)):
        corners[k] = _clipped(points[k])
    return corners


def _folded(points: Floats) -> NDArray[np.bool_]:
    """Return of which polygons (P, N, 3) the fan from the first corner folds back, (P,)."""
    fans = _fans(points)
    total = fans.sum(axis=1)
    along = np.einsum("pnk,pk->pn", fans, total)
    least = -FLAT * np.einsum("pk,pk->p", total, total)
    return np.asarray((along < least[:, None]).any(axis=1))


def _clipped(points: Floats) -> list[Triangle]:
    """Return the triangles of a polygon (N, 3), numbers of its corners, by clipping ears.

    An ear is a triangle of neighbors that holds no other corner (Meisters 1975, "Polygons have
    ears"). Where there is none, as the polygon crosses itself, a fan of what is left follows.
    """
    flat, area = _unfolded(points)
    left, found, ear = list(range(len(points))), list[Triangle](), 0
    while len(left) > 3:
        # From the last ear on, where the next is likely to be.
        turn = [*range(ear, len(left)), *range(ear)]
        ear = next((k for k in turn if _is_ear(flat, left, k, FLAT * area)), -1)
        if ear < 0:
            break
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return found + [(left[0], left[k], left[k + 1]) for k in range(1, len(left) - 1)]


def _fans(points: Floats) -> Floats:
    """Return the normals (P, N - 2, 3) of fans, as long as twice the areas of their triangles."""
    edges = points[:, 1:] - points[:, :1]
    return np.asarray(np.cross(edges[:, :-1], edges[:, 1:]))


def _unfolded(points: Floats) -> tuple[Floats, float]:
    """Return a polygon (N, 2) counter-clockwise in its plane, and twice its area."""
    normal = _fans(points[None])[0].sum(axis=0)
    k = int(np.argmax(np.abs(normal)))
    flat = points[:, [(k + 1) % 3, (k + 2) % 3]]
    return (flat if normal[k] >= 0 else flat[:, ::-1]), float(np.abs(normal[k]))


def _is_ear(flat: Floats, left: list[int], k: int, least: float) -> bool:
    """Return whether a corner of those that are left and its neighbors are an ear."""
    corners = flat[[left[k - 1], left[k], left[(k + 1) % len(left)]]]
    if _sides(corners, corners[2:])[0, 0] <= least:
        return False
    others = flat[left]
    # Corners repeat where a cut leads to a hole: these do not stand in the way.
    others = others[(others[:, None] != corners).any(axis=2).all(axis=1)]
    return not (_sides(corners, others) >= 0).all(axis=1).any()


def _sides(corners: Floats, points: Floats) -> Floats:
    """Return of points (N, 2) twice the areas (N, 3) beside each side of a triangle (3, 2)."""
    along = np.roll(corners, -1, axis=0) - corners
    beside = points[:, None] - corners
    return np.asarray(along[:, 0] * beside[..., 1] - along[:, 1] * beside[..., 0])
