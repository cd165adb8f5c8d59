"""The spacecraft that the renderer draws: a mesh, its materials, and named keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.cached import cached_property
from ffpose.render.spacecraft import dragon, soyuz
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import Mesh

SURFACE_POINTS = 400
"""Number of points that stand for a surface."""

DIRECTIONS, STEPS = 200, 4000
"""Directions whose outermost points stand for a mesh, and steps toward its bounding sphere."""


@dataclass(frozen=True, eq=False)
class Craft:
    """A spacecraft in its own frame: x forward (docking axis), y starboard, z down; meters.

    Attributes:
        name: Name of the spacecraft in manifests.
        mesh: Surface of the spacecraft.
        materials: The materials that `Mesh.material` indexes.
        keypoints: Points (3,) in the object frame, meters, by name.
        is_even: Whether vertices are dense everywhere on the surface; those of a file need not be.
    """

    name: str
    mesh: Mesh
    materials: tuple[Material, ...]
    keypoints: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    is_even: bool = True

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Vertices (N, 3), each place once: files repeat one for each normal that it has."""
        # Each vertex as 24 bytes: four times as fast as rows of numbers.
        places = np.ascontiguousarray(self.mesh.vertices).view("V24")
        return np.unique(places).view(np.float64).reshape(-1, 3)

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        """Points (N, 3), some hundreds, that stand for the spacecraft: its surface, and its ends.

        A sample of the vertices, where these are even.
        """
        vertices = self.mesh.vertices
        if self.is_even:
            return vertices[:: max(1, len(vertices) // SURFACE_POINTS)]
        surface = surface_points(vertices[self.mesh.faces])
        return np.concatenate([surface, _outermost(self.corners)])

    @cached_property
    def radius(self) -> float:
        """Radius of the least sphere around the spacecraft, meters."""
        return bounding_sphere(self.corners)[1]

    def scaled(self, factor: float) -> Craft:
        """Return the spacecraft that many times as large."""
        mesh = replace(self.mesh, vertices=self.mesh.vertices * factor)
        points = {
            name: (x * factor, y * factor, z * factor) for name, (x, y, z) in self.keypoints.items()
        }
        return Craft(f"{self.name} x{factor:.6g}", mesh, self.materials, points, self.is_even)


def surface_points(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `SURFACE_POINTS` points (N, 3) of triangles (M, 3, 3), as many on equal areas.

    They are the same at each call: each is of its share of the area, at one of a sequence of even
    places in a triangle (Roberts's R2).
    """
    first, one, two = triangles[:, 0], *np.moveaxis(triangles[:, 1:] - triangles[:, :1], 1, 0)
    areas = np.linalg.norm(np.cross(one, two), axis=1).cumsum()
    number = np.arange(SURFACE_POINTS) + 0.5
    face = np.searchsorted(areas, number / SURFACE_POINTS * areas[-1])
    u, v = (number[:, None] * (0.7548776662466927, 0.5698402909980532) % 1).T
    u, v = np.where(u + v > 1, (1 - u, 1 - v), (u, v))
    return np.asarray(first[face] + u[:, None] * one[face] + v[:, None] * two[face])


def bounding_sphere(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return center (3,) and radius of the least sphere around points (N, 3), within 0.1 %.

    Badoiu and Clarkson 2003: the center steps toward the farthest point, less each time.
    """
    outer = _outermost(points)
    center = (outer.min(axis=0) + outer.max(axis=0)) / 2
    for step in range(1, STEPS + 1):
        offsets = outer - center
        center = center + offsets[(offsets**2).sum(axis=1).argmax()] / (step + 1)
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _outermost(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return those of points (N, 3) that lie farthest in one of `DIRECTIONS`, on a spiral."""
    turns = np.arange(DIRECTIONS) * (np.pi * (3 - np.sqrt(5)))  # a spiral of equal areas
    height = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    wide = np.sqrt(1 - height**2)
    directions = np.stack([wide * np.cos(turns), wide * np.sin(turns), height], axis=1)
    return np.asarray(points[np.unique([(points @ way).argmax() for way in directions])])


SHIPPED = {"soyuz": soyuz, "dragon": dragon}
"""Modules of the spacecraft that ship with ffpose, by name."""


@lru_cache(maxsize=4)
def build_craft(name: str) -> Craft:
    """Build a spacecraft of `SHIPPED`; later calls return the same one."""
    if name not in SHIPPED:
        raise ValueError(f"unknown spacecraft {name!r}; known: {', '.join(sorted(SHIPPED))}")
    module = SHIPPED[name]
    return Craft(name, module.build(), module.MATERIALS, module.KEYPOINTS)
