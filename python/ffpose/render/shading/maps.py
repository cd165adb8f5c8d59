"""Textures of a spacecraft's materials, at the points that rays hit.

A texture is read at the level whose texels are as wide as the distance between rays. A face that is
smaller than that has the mean of the texture over it, so that nothing else of the texture, which
may hold other parts' pictures, bleeds into it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.arrays import sample_texture
from ffpose.render.shading.vectors import Floats, dot, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import SLOTS
from ffpose.render.spacecraft.mesh import Mesh
from ffpose.render.spacecraft.textures import Texture

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
    """Lookup of textures.

    Attributes:
        means: Means (F, 4) of the textures of each slot over the faces; 0 where none is.
    """

    def __init__(self, craft: Craft) -> None:
        mesh = craft.mesh
        self._layers = mesh.layers
        self._textures = {
            slot: [getattr(material, slot) for material in craft.materials] for slot in SLOTS
        }
        area = np.linalg.norm(mesh.face_normals, axis=1)
        self._sizes, self._densities = [], []
        for layer in mesh.layers:
            first, second = layer[:, 1] - layer[:, 0], layer[:, 2] - layer[:, 0]
            covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) + LEAST_AREA
            self._sizes.append((0.5 * np.log2(covered / 2)).astype(np.float32))
            ratio = covered / (area + LEAST_AREA)
            self._densities.append((0.5 * np.log2(ratio)).astype(np.float32))
        bent = {texture.layer for texture in self._textures["normal_map"] if texture}
        self._tangents = {layer: _tangents(mesh, mesh.layers[layer]) for layer in bent}
        self.means = {slot: self._face_means(craft, slot) for slot in SLOTS}

    def values(
        self, number: int, points: Points, slots: Sequence[str] = SLOTS
    ) -> dict[str, Floats]:
        """Return by slot the values (4, N) of a material's textures at points that have it."""
        found, levels = {}, dict[int, tuple[Floats, Floats]]()
        for slot in slots:
            texture = self._textures[slot][number]
            if texture is None:
                continue
            if texture.layer not in levels:
                levels[texture.layer] = self._levels(texture.layer, points)
            level, shares = levels[texture.layer]
            found[slot] = self._sampled(
                texture, points, level + _level(texture), shares, self.means[slot]
            )
        return found

    def bent(self, number: int, points: Points, normal: Floats, values: Floats) -> Floats:
        """Return unit normals (3, N) bent by those of a normal map, (4, N) in the tangent frame."""
        texture = self._textures["normal_map"][number]
        right, up = self._tangents[texture.layer].take(points.face, axis=1).reshape(2, 3, -1)
        right = unit(right - normal * dot(normal, right))
        up = unit(up - normal * dot(normal, up))
        x, y, z = values[:3]
        return unit(right * x + up * y + normal * z)

    def _levels(self, layer: int, points: Points) -> tuple[Floats, Floats]:
        """Return the levels (N,) to read in a texture of one texel, and the shares of means."""
        level = np.log2(points.footprint) + self._densities[layer].take(points.face)
        size = self._sizes[layer].take(points.face)
        return level, np.clip(level - size + np.float32(SMALL_FACE), 0, 1)

    def _sampled(
        self,
        texture: Texture,
        points: Points,
        levels: Floats,
        shares: Floats,
        means: NDArray[np.float16],
    ) -> Floats:
        image = texture.image
        sides = image.width, image.height
        corners = self._layers[texture.layer]
        return sample_texture(
            image.texels, sides, image.wrap, corners, means, *points[:2], levels, shares
        )

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
            level = self._sizes[texture.layer][at] + _level(texture) - np.float32(math.log2(side))
            total, none = np.zeros((4, len(at)), np.float32), np.zeros(len(at), np.float32)
            for weights in inner:
                shares = np.broadcast_to(weights[:, None], (3, len(at)))
                total += self._sampled(texture, Points(at, shares, none), level, none, means)
            means[at] = total.T / len(inner)
        return means


def _level(texture: Texture) -> np.float32:
    """Return the level at which a texture is one texel, if it is square."""
    return np.float32(0.5 * math.log2(texture.image.width * texture.image.height))


def _tangents(mesh: Mesh, layer: Floats) -> Floats:
    """Return the unit vectors (6, F) to the right and upward of a texture on each face."""
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 2, 0)
    places = layer.transpose(1, 2, 0)
    (du1, dv1), (du2, dv2) = places[1] - places[0], places[2] - places[0]
    sign = np.where(du1 * dv2 - du2 * dv1 < 0, -1, 1)
    right = ((b - a) * dv2 - (c - a) * dv1) * sign
    up = ((b - a) * du2 - (c - a) * du1) * sign  # against v, which grows downward
    return np.concatenate([unit(right), unit(up)])


def _inner_points(side: int) -> Floats:
    """Return the centers (side², 3), barycentric, of a triangle's division into equal ones."""
    second, third = (axis.ravel() for axis in np.mgrid[:side, :side])
    upright = np.stack([second, third])[:, second + third < side] + 1 / 3
    inverted = np.stack([second, third])[:, second + third < side - 1] + 2 / 3
    b, c = np.concatenate([upright, inverted], axis=1) / side
    return np.stack([1 - b - c, b, c], axis=1).astype(np.float32)
