"""What rays pass through: transparent parts of surfaces, and the backs of those of one side.

A ray passes through a surface of alpha a with probability 1 − a, by a pattern in place of chance
that spreads the rays of a pixel evenly: their mean is the surface blended with what is behind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffpose.render.shading.maps import Maps, Points
from ffpose.render.shading.vectors import Floats
from ffpose.render.spacecraft.craft import Craft

GOLDEN = 0.6180339887498949
STRIDE = 0.7548776662466927
"""Multiples of it, modulo one, are spread evenly (Roberts 2018, the R2 sequence)."""

OPAQUE = 0.999
"""Alpha from which a surface is opaque, as 16 bits hold it."""


class AlphaTest:
    """Which hits of rays are with an opaque part of a surface, by the spacecraft's textures."""

    def __init__(self, craft: Craft, maps: Maps) -> None:
        mesh, materials = craft.mesh, craft.materials
        self._maps = maps
        self._material = mesh.material
        self._colors = mesh.colors
        self._alpha = np.array([material.alpha for material in materials], np.float32)
        self._mapped = [
            number
            for number, material in enumerate(materials)
            if material.color_map and material.color_map.image.level(0)[..., 3].min() < OPAQUE
        ]
        clear = (self._alpha < OPAQUE)[mesh.material] | np.isin(mesh.material, self._mapped)
        if mesh.colors is not None:
            clear |= mesh.colors[..., 3].min(axis=1) < OPAQUE
        self._clear = clear
        one_sided = np.array([not material.two_sided for material in materials])
        self._one_sided = one_sided[mesh.material]
        self._normals = mesh.face_normals.astype(np.float32)

    @property
    def needed(self) -> bool:
        """Whether a ray may pass through any surface."""
        return bool(self._clear.any() or self._one_sided.any())

    @property
    def shadow_casters(self) -> NDArray[np.bool_]:
        """The faces (F,) that cast a shadow: those of which more than half is there."""
        alpha = self._alpha[self._material]
        if self._mapped:
            mapped = np.isin(self._material, self._mapped)
            alpha = np.where(mapped, alpha * self._maps.means["color_map"][:, 3], alpha)
        if self._colors is not None:
            alpha = alpha * self._colors[..., 3].mean(axis=1)
        return np.asarray(~self._clear | (alpha > 0.5))

    def passes(
        self, ray: NDArray[np.intp], directions: Floats, points: Points, depth: int
    ) -> NDArray[np.bool_]:
        """Return which rays (N,) of directions (N, 3) pass through the surface that they hit.

        By their numbers ``ray`` (N,) those of a pixel differ; they have passed ``depth`` surfaces
        before.
        """
        face = points.face
        through = self._one_sided.take(face)
        if through.any():
            at = np.flatnonzero(through)
            normals = self._normals.take(face[at], axis=0)
            through[at] = np.einsum("ij,ij->i", normals, directions[at]) > 0
        clear = np.flatnonzero(self._clear.take(face))
        if clear.size:
            alpha = self._alphas(points.some(clear))
            dither = (ray[clear] * STRIDE + depth * GOLDEN + 0.5) % 1
            through[clear] |= dither >= alpha
        return np.asarray(through)

    def _alphas(self, points: Points) -> Floats:
        number = self._material.take(points.face)
        alpha: Floats = self._alpha.take(number)
        for mapped in self._mapped:
            at = np.flatnonzero(number == mapped)
            if at.size:
                values = self._maps.values(mapped, points.some(at), ("color_map",))
                alpha[at] *= values["color_map"][3]
        if self._colors is not None:
            corners = self._colors[..., 3].take(points.face, axis=0)
            alpha *= (corners.T * points.weights).sum(axis=0)
        return alpha
