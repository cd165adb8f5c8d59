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
    """

    name: str
    mesh: Mesh
    materials: tuple[Material, ...]
    keypoints: dict[str, tuple[float, float, float]] = field(default_factory=dict)

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Vertices (N, 3), each place once: files repeat one for each normal that it has."""
        # Each vertex as 24 bytes: four times as fast as rows of numbers.
        places = np.ascontiguousarray(self.mesh.vertices).view("V24")
        return np.unique(places).view(np.float64).reshape(-1, 3)

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        """Vertices (N, 3), some hundreds at most, a sample of all: no booms end among them."""
        vertices = self.mesh.vertices
        return vertices[:: max(1, len(vertices) // 400)]

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
        return Craft(f"{self.name} x{factor:.6g}", mesh, self.materials, points)


def bounding_sphere(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return center (3,) and radius of the least sphere around points (N, 3), within 0.1 %.

    Badoiu and Clarkson 2003: the center steps toward the farthest point, less each time.
    """
    turns = np.arange(DIRECTIONS) * (np.pi * (3 - np.sqrt(5)))  # a spiral of equal areas
    height = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    wide = np.sqrt(1 - height**2)
    directions = np.stack([wide * np.cos(turns), wide * np.sin(turns), height], axis=1)
    outer = points[np.unique([(points @ direction).argmax() for direction in directions])]
    center = (outer.min(axis=0) + outer.max(axis=0)) / 2
    for step in range(1, STEPS + 1):
        offsets = outer - center
        center = center + offsets[(offsets**2).sum(axis=1).argmax()] / (step + 1)
    return center, float(np.linalg.norm(points - center, axis=1).max())


SHIPPED = {"soyuz": soyuz, "dragon": dragon}
"""Modules of the spacecraft that ship with ffpose, by name."""


@lru_cache(maxsize=4)
def build_craft(name: str) -> Craft:
    """Build a spacecraft of `SHIPPED`; later calls return the same one."""
    if name not in SHIPPED:
        raise ValueError(f"unknown spacecraft {name!r}; known: {', '.join(sorted(SHIPPED))}")
    module = SHIPPED[name]
    return Craft(name, module.build(), module.MATERIALS, module.KEYPOINTS)
