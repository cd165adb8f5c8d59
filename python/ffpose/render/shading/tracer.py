"""Ray casting against one spacecraft with Embree, in the object frame.

Rays are transformed into the object frame, rather than the mesh into the camera frame, so that the
bounding volume hierarchy (BVH) is built once for a spacecraft and serves every image of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.render.shading.vectors import Floats
from ffpose.render.spacecraft.mesh import Mesh


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


class Tracer:
    """Embree's BVH of one mesh.

    Args:
        mesh: The surface, in meters.

    Raises:
        MissingExtraError: Embreex is not installed.
    """

    def __init__(self, mesh: Mesh) -> None:
        require("embreex", "render")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.faces)

    def first_hits(self, origin: Floats, directions: Floats) -> Hits:
        """Find the first hits of rays from one point.

        Args:
            origin: (3,) object frame, meters.
            directions: (N, 3) unit vectors, object frame.
        """
        origins = np.broadcast_to(origin, directions.shape).astype(np.float32)
        found = self._scene.run(origins, np.ascontiguousarray(directions), output=1)
        ray = np.flatnonzero(found["primID"] >= 0)
        return Hits(
            ray,
            found["primID"][ray],
            found["tfar"][ray],
            np.stack([found["u"][ray], found["v"][ray]]),
        )

    def blocked(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """Return whether each ray hits anything; (N,) bool.

        Args:
            origins: (N, 3) object frame, meters.
            directions: (N, 3) or (3,) unit vectors, object frame.
        """
        rays = np.ascontiguousarray(np.broadcast_to(directions, origins.shape), dtype=np.float32)
        found = self._scene.run(np.ascontiguousarray(origins), rays, query="OCCLUDED")
        return np.asarray(found >= 0)
