"""Triangle meshes with texture coordinates and materials, and the solids to build them from.

Coordinates are in the object frame, in meters. Each face has a material number, and each of its
three corners a texture coordinate in meters, so that a pattern has the same scale on every part.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose._internal.cached import cached_property

Floats = NDArray[np.float64]

MAX_CORNERS = 256
"""Largest number of corners that may share a vertex with smooth shading; beyond it shading is
flat, as the pairs of corners would fill the memory."""

CREASE_DEG = 38.0
"""Crease angle: faces that meet at a smaller angle are shaded as one smooth surface."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) meters.
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside.
        uv: (F, 3, 2) texture coordinates of each corner, meters along the surface.
        material: (F,) material numbers.
        normals: (F, 3, 3) unit normals of the corners, NaN where they follow from the shape; None
            where all do.
        colors: (F, 3, 4) linear colors and alpha of the corners; None is white.
        layers: (F, 3, 2) coordinates of the corners in textures, which begin at the upper left.
    """

    vertices: Floats
    faces: NDArray[np.int32]
    uv: Floats
    material: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None
    layers: tuple[NDArray[np.float32], ...] = ()

    @property
    def face_normals(self) -> Floats:
        """Normals (F, 3) of the faces, as long as twice their areas."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def corner_normals(self) -> NDArray[np.float32]:
        """Unit normals (F, 3, 3) of the corners; edges beyond `CREASE_DEG` stay sharp."""
        if self.normals is not None and np.isfinite(self.normals).all():
            return self.normals
        shape = _corner_normals(self).astype(np.float32)
        return (
            shape if self.normals is None else np.where(np.isnan(self.normals), shape, self.normals)
        )

    def moved(self, rotation: ArrayLike | None = None, shift: ArrayLike = (0, 0, 0)) -> Mesh:
        """Return the mesh transformed by `rotation` (3, 3), then shifted by `shift` (3,)."""
        turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        vertices = self.vertices @ turn.T + np.asarray(shift, dtype=np.float64)
        normals = None if self.normals is None else self.normals @ turn.T.astype(np.float32)
        return replace(self, vertices=vertices, normals=normals)


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join `meshes` without textures into one."""
    parts = list(meshes)
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(
            [part.faces + offset for part, offset in zip(parts, offsets, strict=True)]
        ).astype(np.int32),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.material for part in parts]),
    )


def turn(axis: str, degrees: float) -> Floats:
    """Return the right-handed rotation (3, 3) by `degrees` about the axis "x", "y" or "z"."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def lathe(
    profile: Sequence[tuple[float, float]],
    material: int,
    segments: int = 64,
    arc_deg: tuple[float, float] = (0.0, 360.0),
) -> Mesh:
    """Build a surface of revolution about the x axis, of flat strips from +y toward +z.

    The points (x, radius) of the profile, meters, stand in the order of growing x for an outer
    surface; the reverse order gives an inner one.
    """
    outline = np.asarray(profile, dtype=np.float64)
    angle = np.radians(np.linspace(*arc_deg, segments + 1))
    radius = outline[:, 1, None]
    x = np.broadcast_to(outline[:, 0, None], (len(outline), segments + 1))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(outline, axis=0).T))])
    around = angle * outline[:, 1].max()
    uv = np.stack(np.broadcast_arrays(around[None, :], along[:, None]), axis=-1)
    points = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return _grid(points, uv, material)


def ellipse_arc(
    center: float, half_length: float, radius: float, start_deg: float, stop_deg: float, steps: int
) -> list[tuple[float, float]]:
    """Return profile points of an ellipse about (center, 0); 180° is aft, 0° forward."""
    angles = np.radians(np.linspace(start_deg, stop_deg, steps))
    return [(center + half_length * np.cos(a), radius * np.sin(a)) for a in angles]


def tube(
    start: ArrayLike, stop: ArrayLike, radius: float, material: int, segments: int = 12
) -> Mesh:
    """Build a closed cylinder from `start` (3,) to `stop` (3,)."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(stop, dtype=np.float64)
    length = float(np.linalg.norm(last - first))
    shape = lathe([(0, 0), (0, radius), (length, radius), (length, 0)], material, segments)
    return shape.moved(_frame_along(last - first), first)


def path_tube(points: Sequence[ArrayLike], radius: float, material: int) -> Mesh:
    """Build cylinders along a chain of points, with a ball on each inner one."""
    chain = [np.asarray(point, dtype=np.float64) for point in points]
    rods = [tube(a, b, radius, material) for a, b in pairwise(chain)]
    return merge([*rods, *(ball(point, radius, material, 10) for point in chain[1:-1])])


def ball(center: ArrayLike, radius: float, material: int, segments: int = 24) -> Mesh:
    """Build a sphere."""
    profile = ellipse_arc(0.0, radius, radius, 180.0, 0.0, max(5, segments // 2 + 1))
    return lathe(profile, material, segments).moved(shift=center)


def dish(
    center: ArrayLike, axis: ArrayLike, radius: float, depth: float, front: int, back: int
) -> Mesh:
    """Build a paraboloid reflector open toward `axis`; `center` is the middle of its rim."""
    r = np.linspace(0.0, radius, 7)
    x = depth * ((r / radius) ** 2 - 1.0)
    thickness = 0.03 * radius
    outer = list(zip(x - thickness, r, strict=True))
    inner = list(zip(x[::-1], r[::-1], strict=True))
    rim = [outer[-1], inner[0]]
    shape = merge([lathe(outer, back, 32), lathe(rim, back, 32), lathe(inner, front, 32)])
    return shape.moved(_frame_along(axis), center)


def box(size: ArrayLike, materials: int | Sequence[int]) -> Mesh:
    """Build a box about the origin with edges along the axes, of one material, or six.

    Six are those of the faces −x, +x, −y, +y, −z, +z.
    """
    half = np.asarray(size, dtype=np.float64) / 2
    numbers = [materials] * 6 if isinstance(materials, int) else list(materials)
    sides = []
    for side, number in enumerate(numbers):
        axis, sign = side // 2, (-1.0, 1.0)[side % 2]
        a, b = (axis + 1) % 3, (axis + 2) % 3
        a, b = (a, b) if sign > 0 else (b, a)
        corners = np.zeros((2, 2, 3))
        corners[..., axis] = sign * half[axis]
        corners[..., a] = np.array([[-1.0, 1.0], [-1.0, 1.0]]) * half[a]
        corners[..., b] = np.array([[-1.0, -1.0], [1.0, 1.0]]) * half[b]
        low, high = min(a, b), max(a, b)
        uv = np.stack([corners[..., low] + half[low], corners[..., high] + half[high]], axis=-1)
        sides.append(_grid(corners, uv, number))
    return merge(sides)


def _grid(points: Floats, uv: Floats, material: int) -> Mesh:
    """Triangulate a (rows, columns, 3) grid; cells without area are left out."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    corners = points.reshape(-1, 3)[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    faces = faces[area > 1e-12].astype(np.int32)
    return Mesh(
        points.reshape(-1, 3),
        faces,
        uv.reshape(-1, 2)[faces],
        np.full(len(faces), material, dtype=np.int32),
    )


def _frame_along(direction: ArrayLike) -> Floats:
    """Return a rotation (3, 3) that takes the x axis to `direction`."""
    x = np.asarray(direction, dtype=np.float64)
    x = x / np.linalg.norm(x)
    helper = np.eye(3)[np.argmin(np.abs(x))]
    y = np.cross(helper, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _corner_normals(mesh: Mesh) -> Floats:
    """Average, at each corner and by area, the face normals there within the crease angle."""
    normal, faces = mesh.face_normals, mesh.faces
    flat = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    corner, neighbor = _neighbors(mesh.vertices, faces)
    smooth = (flat[corner // 3] * flat[neighbor // 3]).sum(axis=1) > np.cos(np.radians(CREASE_DEG))
    total = np.zeros((faces.size, 3))
    np.add.at(total, corner[smooth], normal[neighbor[smooth] // 3])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    # A face without area has no neighbors and keeps whatever its plane is.
    total = np.where(length > 1e-12, total / np.maximum(length, 1e-300), flat.repeat(3, axis=0))
    return np.asarray(total.reshape(-1, 3, 3))


def _neighbors(
    vertices: Floats, faces: NDArray[np.int32]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all ordered pairs of corners (3 · face + k) at one place, each with itself too."""
    # Places are compared after rounding, because seams repeat vertices.
    _, place = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    place = place.reshape(-1)[faces.reshape(-1)]
    crowded = np.bincount(place)[place] > MAX_CORNERS
    place = np.where(crowded, place.max() + 1 + np.arange(len(place)), place)
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.diff(place[order], prepend=-1))
    counts = np.diff(np.append(starts, len(order)))
    repeats = np.repeat(counts, counts)
    ramp = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    return np.repeat(order, repeats), order[np.repeat(np.repeat(starts, counts), repeats) + ramp]
