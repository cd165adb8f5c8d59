"""A spacecraft as the renderer sees it: one mesh, its materials, and points known by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ffpose.render import dragon, soyuz
from ffpose.render.materials import Material
from ffpose.render.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Craft:
    """A spacecraft in its own frame: x forward (docking axis), y starboard, z down; metres.

    Attributes:
        name: what it is called in manifests.
        mesh: its surface.
        materials: what the mesh's material numbers stand for.
        keypoints: named points (3,) of the object frame.
    """

    name: str
    mesh: Mesh
    materials: tuple[Material, ...]
    keypoints: dict[str, tuple[float, float, float]] = field(default_factory=dict)

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        """(N, 3) vertices, at most a few hundred, that stand for the whole extent."""
        vertices = self.mesh.vertices
        return vertices[:: max(1, len(vertices) // 400)]


def _soyuz() -> Craft:
    return Craft("soyuz", soyuz.build(), soyuz.MATERIALS, soyuz.KEYPOINTS)


def _dragon() -> Craft:
    return Craft("dragon", dragon.build(), dragon.MATERIALS, dragon.KEYPOINTS)


BUILDERS: dict[str, Callable[[], Craft]] = {"soyuz": _soyuz, "dragon": _dragon}
"""The spacecraft that come with ffpose."""


@lru_cache(maxsize=4)
def build_craft(name: str) -> Craft:
    """Build (once) a spacecraft of `BUILDERS`.

    Raises:
        ValueError: the name is not known; the message lists the known ones.
    """
    if name not in BUILDERS:
        raise ValueError(f"unknown spacecraft {name!r}; known: {', '.join(sorted(BUILDERS))}")
    return BUILDERS[name]()
