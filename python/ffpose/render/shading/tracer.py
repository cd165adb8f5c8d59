"""Ray casting against one spacecraft with Embree, in the object frame.

Rays are transformed into the object frame, rather than the mesh into the camera frame, so that the
bounding volume hierarchy (BVH) is built once for a spacecraft and serves every image of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.cached import cached_property
from ffpose.errors import require
from ffpose.render.shading.alpha_test import AlphaTest
from ffpose.render.shading.maps import Points
from ffpose.render.shading.vectors import Floats
from ffpose.render.spacecraft.mesh import Mesh

DEPTH = 8
"""Most surfaces that a ray passes through; the next one stops it."""

STEP = 1e-5
"""How far behind a surface a ray goes on, relative to its length; nearer ones are in one place."""

ASIDE = (0.48, 0.6, 0.64)
"""Unit vector whose side tells a face from its opposite one: hardly a face is parallel to it."""


class Hits(NamedTuple):
    """The H of N rays that hit the surface.

    Attributes:
        ray: (H,) indices of the rays.
        face: (H,) index of the face that each hit first.
        distance: (H,) along the ray, meters for unit directions.
        barycentric: (2, H) weights of the face's second and third corners.
    """

    ray: NDArray[np.intp]
    face: NDArray[np.int32]
    distance: Floats
    barycentric: Floats

    @property
    def weights(self) -> Floats:
        """Barycentric weights (3, H) of the face's corners."""
        second, third = self.barycentric
        return np.stack([1 - second - third, second, third])


class Tracer:
    """Embree's BVH of one mesh, with a test of what rays pass through; None is nothing.

    Of faces in one place, back to back, a ray hits the one that it sees from the front.
    """

    def __init__(self, mesh: Mesh, alpha_test: AlphaTest | None = None) -> None:
        require("embreex", "render")

        self._alpha_test = alpha_test if alpha_test is not None and alpha_test.needed else None
        self._mesh = mesh
        self._scene = self._shadows = _scene(mesh.vertices, mesh.faces)
        if self._alpha_test is not None:
            casters = self._alpha_test.shadow_casters
            if not casters.all():
                self._shadows = _scene(mesh.vertices, mesh.faces[casters])

    def first_hits(self, origin: Floats, directions: Floats, spread: float = 0.0) -> Hits:
        """Find the first hits of rays from one point (3,) in unit directions (N, 3), object frame.

        Textures are averaged over ``spread``, the angle between neighboring rays, radians.
        """
        directions = np.ascontiguousarray(directions)
        hits = self._hits(origin, directions, None)
        if self._alpha_test is None:
            return hits
        kept = []
        for depth in range(DEPTH):
            footprint = np.maximum(hits.distance * np.float32(spread), np.float32(1e-9))
            points = Points(hits.face, hits.weights, footprint)
            through = self._alpha_test.passes(hits.ray, directions[hits.ray], points, depth)
            kept.append(_some(hits, ~through))
            hits = _some(hits, through)
            if not hits.ray.size:
                break
            further = self._hits(origin, directions[hits.ray], _behind(hits.distance))
            hits = further._replace(ray=hits.ray[further.ray])
        kept.append(hits)
        together = Hits(*(np.concatenate(each, axis=-1) for each in zip(*kept, strict=True)))
        return _some(together, np.argsort(together.ray, kind="stable"))

    def _hits(self, origin: Floats, directions: Floats, start: Floats | None) -> Hits:
        """Find the first hits of rays that begin at distances (N,) from their origin."""
        hits, backs = _traced(self._scene, origin, directions, start)
        if not backs.size:
            return hits
        aside = self._aside[hits.face[backs]]
        for half, (scene, numbers) in zip((~aside, aside), self._halves, strict=True):
            some = backs[half]
            distance = hits.distance[some]
            before = distance * np.float32(1 - STEP) - np.float32(STEP)
            fronts, _ = _traced(scene, origin, directions[hits.ray[some]], before)
            fronts = _some(fronts, fronts.distance < _behind(distance[fronts.ray]))
            at = some[fronts.ray]
            hits.face[at] = numbers[fronts.face]
            hits.distance[at] = fronts.distance
            hits.barycentric[:, at] = fronts.barycentric
        return hits

    @cached_property
    def _aside(self) -> NDArray[np.bool_]:
        """Whether each face (F,) is on the side of `ASIDE`."""
        return np.asarray(self._mesh.face_normals @ ASIDE > 0)

    @cached_property
    def _halves(self) -> list[tuple[Any, NDArray[np.intp]]]:
        """BVHs of the faces on the side of `ASIDE` and of the others, and the faces' numbers."""
        return [
            (_scene(self._mesh.vertices, self._mesh.faces[some]), np.flatnonzero(some))
            for some in (self._aside, ~self._aside)
        ]

    def blocked(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """Return which rays (N,) from points (N, 3) in directions (N, 3) or (3,) hit anything."""
        rays = np.ascontiguousarray(np.broadcast_to(directions, origins.shape), dtype=np.float32)
        found = self._shadows.run(np.ascontiguousarray(origins), rays, query="OCCLUDED")
        return np.asarray(found >= 0)


def _scene(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Any:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices.astype(np.float32), np.ascontiguousarray(faces))
    return scene


def _traced(
    scene: Any, origin: Floats, directions: Floats, start: Floats | None
) -> tuple[Hits, NDArray[np.intp]]:
    """Return first hits of rays that begin at distances (N,), and which of them are on backs."""
    starts = np.broadcast_to(origin, directions.shape)
    if start is not None:
        starts = starts + directions * start[:, None]
    found = scene.run(np.ascontiguousarray(starts, np.float32), directions, output=1)
    ray = np.flatnonzero(found["primID"] >= 0)
    distance = found["tfar"][ray]
    hits = Hits(
        ray,
        found["primID"][ray],
        distance if start is None else start[ray] + distance,
        np.stack([found["u"][ray], found["v"][ray]]),
    )
    return hits, np.flatnonzero(np.einsum("ij,ij->i", found["Ng"], directions)[ray] > 0)


def _behind(distance: Floats) -> Floats:
    """Return the distances at which rays go on behind surfaces."""
    return np.asarray(distance * np.float32(1 + STEP) + np.float32(STEP))


def _some(hits: Hits, at: NDArray[np.bool_] | NDArray[np.intp]) -> Hits:
    return Hits(hits.ray[at], hits.face[at], hits.distance[at], hits.barycentric[:, at])
