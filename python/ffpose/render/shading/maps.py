"""Textures of a spacecraft's materials, at the points that rays hit.

A texture is read at the level whose texels are as wide as the distance between rays. A face that is
smaller than that has the mean of the texture over it, so that nothing else of the texture, which
may hold other parts' pictures, bleeds into it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.render.shading.vectors import Floats, dot, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Texture

SLOTS = ("color_map", "roughness_map", "normal_map", "emission_map")

LEAST_AREA = 1e-18
"""Smallest area of a face, in textures and in square meters, for logarithms."""

SMALL_FACE = 2.0
"""Levels below the one where a face covers a texel, from which on its mean takes over."""

SAMPLES = 1 << 18
"""Texture samples for the means of all faces, about; each has `LEAST_SIDE`² to `MOST_SIDE`²."""

LEAST_SIDE, MOST_SIDE = 2, 8


class Points(NamedTuple):
    """Points on faces.

    Attributes:
        face: (N,) faces.
        weights: (3, N) barycentric weights of their corners.
        footprint: (N,) distance between rays on the surface, meters.
    """

    face: NDArray[np.int32]
    weights: Floats
    footprint: Floats

    def some(self, at: NDArray[np.intp]) -> Points:
        """Return the points of numbers ``at``."""
        return Points(self.face[at], self.weights[:, at], self.footprint[at])


class Maps:
    """Lookup of textures."""

    def __init__(self, craft: Craft) -> None:
        mesh = craft.mesh
        self._layers = mesh.layers
        self._corners = mesh.vertices.astype(np.float32), mesh.faces
        self._textures = {
            slot: [getattr(material, slot) for material in craft.materials] for slot in SLOTS
        }
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        self._sizes, self._densities = [], []
        for layer in mesh.layers:
            first, second = layer[:, 1] - layer[:, 0], layer[:, 2] - layer[:, 0]
            covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) + LEAST_AREA
            self._sizes.append((0.5 * np.log2(covered / 2)).astype(np.float32))
            ratio = covered / (area + LEAST_AREA)
            self._densities.append((0.5 * np.log2(ratio)).astype(np.float32))
        self._means = {slot: self._face_means(craft, slot) for slot in SLOTS}

    def of_material(self, slot: str, number: int) -> Texture | None:
        """Return the texture of a material."""
        found: Texture | None = self._textures[slot][number]
        return found

    def values(self, slot: str, number: int, points: Points) -> Floats:
        """Return the values (N, 4) of a material's texture at points of faces that have it."""
        texture = self._textures[slot][number]
        image, layer = texture.image, texture.layer
        texels = np.float32(0.5 * math.log2(image.width * image.height))
        level = np.log2(points.footprint) + self._densities[layer].take(points.face) + texels
        u, v = self._coordinates(texture, points)
        result: Floats = image.sample(u, v, level)
        size = self._sizes[layer].take(points.face) + texels
        share = np.clip(level - size + np.float32(SMALL_FACE), 0, 1)
        small = np.flatnonzero(share > 0)
        if small.size:
            mean = self._means[slot].take(points.face[small], axis=0).astype(np.float32)
            result[small] += (mean - result[small]) * share[small, None]
        return result

    def mean(self, slot: str) -> NDArray[np.float16]:
        """Return the means (F, 4) of the textures of a slot over the faces; 0 where none is."""
        return self._means[slot]

    def bent(self, number: int, points: Points, normal: Floats, values: Floats) -> Floats:
        """Return unit normals (3, N) bent by those of a normal map, (N, 4) in the tangent frame."""
        vertices, faces = self._corners
        corners = vertices.take(faces.take(points.face, axis=0), axis=0)
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        texture = self._textures["normal_map"][number]
        places = self._layers[texture.layer].take(points.face, axis=0)
        (du1, dv1), (du2, dv2) = (places[:, 1] - places[:, 0]).T, (places[:, 2] - places[:, 0]).T
        sign = np.where(du1 * dv2 - du2 * dv1 < 0, -1, 1).astype(np.float32)
        right = (first.T * dv2 - second.T * dv1) * sign
        up = (first.T * du2 - second.T * du1) * sign  # against v, which grows downward
        right = unit(right - normal * dot(normal, right))
        up = unit(up - normal * dot(normal, up))
        x, y, z = values[:, :3].T
        return unit(right * x + up * y + normal * z)

    def _coordinates(self, texture: Texture, points: Points) -> tuple[Floats, Floats]:
        corners = self._layers[texture.layer].take(points.face, axis=0)
        first, second, third = points.weights
        u, v = (
            first * corners[:, 0, k] + second * corners[:, 1, k] + third * corners[:, 2, k]
            for k in range(2)
        )
        return u, v

    def _face_means(self, craft: Craft, slot: str) -> NDArray[np.float16]:
        """Return the mean of the textures of a slot over each face."""
        faces = len(craft.mesh.faces)
        if not any(self._textures[slot]):
            return np.zeros((0, 4), np.float16)
        means = np.zeros((faces, 4), np.float16)
        side = int(np.clip(math.isqrt(SAMPLES // faces), LEAST_SIDE, MOST_SIDE))
        inner = _inner_points(side)
        for number, texture in enumerate(self._textures[slot]):
            at = np.flatnonzero(craft.mesh.material == number).astype(np.int32)
            if texture is None or not at.size:
                continue
            image = texture.image
            texels = 0.5 * math.log2(image.width * image.height)
            level = self._sizes[texture.layer][at] + np.float32(texels - math.log2(side))
            total = np.zeros((len(at), 4), np.float32)
            for weights in inner:
                shares = np.broadcast_to(weights[:, None], (3, len(at)))
                u, v = self._coordinates(texture, Points(at, shares, level))
                total += image.sample(u, v, level)
            means[at] = total / len(inner)
        return means


def _inner_points(side: int) -> Floats:
    """Return the centers (side², 3), barycentric, of a triangle's division into equal ones."""
    second, third = (axis.ravel() for axis in np.mgrid[:side, :side])
    upright = np.stack([second, third])[:, second + third < side] + 1 / 3
    inverted = np.stack([second, third])[:, second + third < side - 1] + 2 / 3
    b, c = np.concatenate([upright, inverted], axis=1) / side
    return np.stack([1 - b - c, b, c], axis=1).astype(np.float32)
