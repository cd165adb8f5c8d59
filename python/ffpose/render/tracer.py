"""Ray casting against one spacecraft by Embree, in the spacecraft's own frame.

The rays move into the object frame instead of the mesh into the camera's, so that the search tree
is built once for a spacecraft and used for every image of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require
from ffpose.render.mesh import Mesh
from ffpose.render.vectors import Floats


class Hits(NamedTuple):
    """The rays that met the surface, H of N.

    Attributes:
        ray: (H,) which rays.
        face: (H,) which face each met first.
        distance: (H,) along the ray, metres for unit directions.
        barycentric: (2, H) weights of the face's second and third corner.
    """

    ray: NDArray[np.intp]
    face: NDArray[np.int32]
    distance: Floats
    barycentric: Floats


class Tracer:
    """Embree's search tree over one mesh.

    Args:
        mesh: the surface, in metres.

    Raises:
        MissingExtraError: embreex is not installed.
    """

    def __init__(self, mesh: Mesh) -> None:
        require("embreex", "render")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.faces)

    def first_hits(self, origin: Floats, directions: Floats) -> Hits:
        """Where rays from one point first meet the surface.

        Args:
            origin: (3,) object frame, metres.
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
        """Whether anything lies along each ray.

        Args:
            origins: (N, 3) object frame, metres.
            directions: (N, 3) or (3,) unit vectors, object frame.
        """
        rays = np.ascontiguousarray(np.broadcast_to(directions, origins.shape), dtype=np.float32)
        found = self._scene.run(np.ascontiguousarray(origins), rays, query="OCCLUDED")
        return np.asarray(found >= 0)
