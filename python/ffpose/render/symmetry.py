"""Rotations that leave a spacecraft's look unchanged, found by rendering it before and after.

Candidates are turns about the axes of the object's frame and the surface's principal axes, about
the diagonals of both, and about the normals of the largest faces. Both images have the same light,
relative to the camera; what differs is compared with the noise of the sensor at that exposure. A
look is the same where the root mean square of the difference, over the pixels that show the
spacecraft, is at most that of the noise in each of some views, and nowhere much more.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.geometry import Camera, FloatArray, Pose
from ffpose.geometry.rotations import multiply, rotation_matrix
from ffpose.geometry.symmetry import IDENTITY, Axis, SymmetryGroup
from ffpose.render.renderer import draw_alone
from ffpose.render.shading.reflection import Light
from ffpose.render.shading.sensor import Sensor, choose_gain
from ffpose.render.spacecraft.craft import Craft

SIDE = 128
"""Pixels of a view, which the spacecraft fills: about those that the network sees of a near one."""

VIEWS = 6

AWAY = 6.0
"""Distance of the camera in radii about the middle of the surface."""

PATCH, EDGES = 4, 6.0
"""Side of a patch in pixels, and how often the noise it may differ by.

A mark of some pixels hardly changes the mean over all. Edges that fall otherwise between the rays
change a patch by up to five times the noise."""

LAMP = 0.3
"""Light of a lamp at the camera relative to the sun's, so that no side is dark."""

FOLDS = (0, 8, 7, 6, 5, 4, 3, 2)
"""Folds that are tried about each axis, 0 for any angle; the first that holds is the axis's."""

ODD_TURNS = (0.1618, 0.3607, 0.4271)
"""Shares of a turn that stand for any angle."""

NEAR = 0.5
"""Difference relative to the contrast up to which looks are nearly the same, and reported."""

MORE_ALIKE = 0.8
"""Share of the difference after all turns about an axis up to which a part of them is reported
beside them."""

ALIKE = np.cos(np.radians(1.0))
"""Cosine of the angle between axes that are one."""

SHAPE = 0.05
"""Difference of second moments, relative to the largest, beyond which no look is the same."""

NORMALS = 8
"""Number of normals of faces that are tried as axes, those of the largest area."""


class Symmetry(NamedTuple):
    """A turn that leaves the look the same, or nearly so.

    Attributes:
        axis: About which, and how far.
        noise: Difference of the looks in units of the sensor's noise, in the view in which they
            differ most: root mean square over the pixels of the spacecraft, or over the patch that
            differs most, divided by `EDGES`, if that is more.
        contrast: Root mean square over the pixels of the spacecraft in units of their standard
            deviation, in the view in which it is most.
        offset_m: Distance by which the axis misses the object's origin; the pose's translation
            changes too, by up to twice as much, where it is not zero.
    """

    axis: Axis
    noise: float
    contrast: float
    offset_m: float

    def __str__(self) -> str:
        missed = f", {self.offset_m:.2g} m beside the origin" if self.offset_m > 0 else ""
        return (
            f"{self.axis}{missed}: looks differ by {self.noise:.2g} of the sensor's noise, "
            f"{self.contrast:.1%} of the contrast"
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        axis = SymmetryGroup((self.axis,)).to_json()[0]
        return axis | dict(zip(self._fields[1:], self[1:], strict=True)) | {"text": str(self)}


class Symmetries(NamedTuple):
    """Symmetries and near symmetries of a spacecraft's look.

    Attributes:
        group: All turns about axes through the origin that leave the look the same.
        same: Turns that leave it the same, those that others imply left out.
        near: Turns that do nearly so, and those about axes beside the origin.
    """

    group: SymmetryGroup
    same: list[Symmetry]
    near: list[Symmetry]

    def to_json(self) -> dict[str, Any]:
        """Return plain values: ``axes`` as `SymmetryGroup.to_json`, ``same`` and ``near``."""
        return {
            "axes": self.group.to_json(),
            "same": [each.to_json() for each in self.same],
            "near": [each.to_json() for each in self.near],
        }


def find_symmetries(craft: Craft) -> Symmetries:
    """Find the turns that leave a spacecraft's look the same, and those that nearly do.

    Raises:
        ValueError: The spacecraft looks the same from all sides, as a sphere, so it has no
            attitude; it is flat, so from the side there is nothing to see; or it is invisible.
    """
    points, area, normals = _surface(craft)
    center = area @ points / area.sum()
    spread = (points - center) * np.sqrt(area / area.sum())[:, None]
    moments = spread.T @ spread
    reach = np.linalg.norm(craft.corners - center, axis=1).max()
    if np.linalg.eigvalsh(moments)[0] < (1e-4 * reach) ** 2:
        raise ValueError(
            "mesh: expected a spacecraft of some depth, got one that is flat, of which nothing is"
            " seen from the side"
        )
    looks = _Renders(craft, center, float(reach))
    found = list[Symmetry]()
    for direction in _directions(moments, normals, area):
        for fold in FOLDS:
            axis = Axis(tuple(direction.tolist()), fold)
            turn = rotation_matrix(_turns(axis)[0])
            if np.abs(turn @ moments @ turn.T - moments).max() > SHAPE * np.abs(moments).max():
                continue
            if (symmetry := looks.compare(axis)) is not None:
                found.append(symmetry)
                if symmetry.noise <= 1:
                    break
        if sum(each.noise <= 1 and each.axis.fold == 0 for each in found) > 1:
            raise ValueError(
                "mesh: expected a spacecraft with an attitude, got one that looks the same from all"
                " sides, as a sphere does: no image tells how it is turned"
            )
    return _sorted(found)


def _sorted(found: list[Symmetry]) -> Symmetries:
    """Tell what generates a group from what is implied by it, and from what is nearly the same."""
    group, same, near = IDENTITY, list[Symmetry](), list[Symmetry]()
    free_first = sorted(found, key=lambda s: (s.axis.fold > 0, -s.axis.fold, s.noise))
    for each in [s for s in free_first if s.noise <= 1]:
        if group.has(_turns(each.axis)):
            continue
        try:
            if each.offset_m == 0:
                group = SymmetryGroup((*group.axes, each.axis))
                same.append(each)
                continue
        except ValueError:
            pass  # within the noise, but in no group with those before
        near.append(each)
    for each in [s for s in free_first if s.noise > 1]:
        if not group.has(_turns(each.axis)) and not any(_tells(other, each) for other in near):
            near.append(each)
    near.sort(key=lambda s: (s.axis.fold > 0, s.contrast))
    return Symmetries(group, same, near)


def _tells(other: Symmetry, each: Symmetry) -> bool:
    """Tell whether all turns of one are among another's, which leaves the look about as alike."""
    about_one_axis = abs(np.dot(each.axis.direction, other.axis.direction)) > ALIKE
    among = other.axis.fold == 0 or (each.axis.fold > 0 and other.axis.fold % each.axis.fold == 0)
    return bool(about_one_axis and among and each.contrast > MORE_ALIKE * other.contrast)


def _turns(axis: Axis) -> FloatArray:
    """Return the turns that are rendered, unit quaternions ``(N, 4)``: those that generate all."""
    if axis.fold:
        return axis.turns[1:2]
    half = np.pi * np.array(ODD_TURNS)[:, None]
    return np.concatenate([np.cos(half), np.sin(half) * np.asarray(axis.direction)], axis=1)


def _surface(craft: Craft) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points ``(N, 3)`` with weights ``(N,)`` for the surface's moments, and its normals.

    Three points of a triangle, halfway from its middle to the corners, have its second moments.
    """
    corners = craft.mesh.vertices[craft.mesh.faces]
    cross = craft.mesh.face_normals
    area = np.linalg.norm(cross, axis=1)
    points = (corners + corners.mean(axis=1, keepdims=True)) / 2
    unit = np.divide(cross, area[:, None], out=np.zeros_like(cross), where=area[:, None] > 0)
    return points.reshape(-1, 3), np.repeat(area / 6, 3), unit


def _directions(moments: FloatArray, normals: FloatArray, area: FloatArray) -> list[FloatArray]:
    """Return the axes that are tried, unit vectors ``(3,)``, no two of them alike."""
    signs = itertools.product((-1, 0, 1), repeat=3)
    cube = np.array([s for s in signs if s > (0, 0, 0)], np.float64)  # faces, edges, diagonals
    # Of a normal and its opposite one is kept.
    upward = normals * np.where(normals @ (0.36, 0.48, 0.8) < 0, -1, 1)[:, None]
    _, first, place = np.unique(np.round(upward, 3), axis=0, return_index=True, return_inverse=True)
    weight = np.bincount(place.reshape(-1), area[::3])
    largest = upward[first[np.argsort(-weight, kind="stable")[:NORMALS]]]
    frames = (cube, cube @ np.linalg.eigh(moments)[1].T, largest)
    chosen: list[FloatArray] = []
    for row in np.concatenate(frames):
        length = np.linalg.norm(row)
        if length > 0 and all(abs(row @ each) < ALIKE * length for each in chosen):
            chosen.append(row / length)
    return chosen


class _Renders:
    """Views about a center ``(3,)`` of what reaches so far, each with a light of its own."""

    def __init__(self, craft: Craft, center: FloatArray, reach: float) -> None:
        rng = np.random.default_rng(0)
        self.craft, self.center, self.reach = craft, center, reach
        attitudes = rng.standard_normal((VIEWS, 4))
        self.attitudes = attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True)
        suns = np.concatenate([rng.uniform(-1, 1, (VIEWS, 2)), np.full((VIEWS, 1), -0.7)], axis=1)
        self.suns = suns / np.linalg.norm(suns, axis=1, keepdims=True)
        focal = SIDE / 2 * np.sqrt(AWAY**2 - 1)
        self.camera = Camera(SIDE, SIDE, focal, focal, SIDE / 2, SIDE / 2)
        self.before = [
            self._render(q, sun) for q, sun in zip(self.attitudes, self.suns, strict=True)
        ]
        if not any(view.any() for view in self.before):
            raise ValueError(
                "mesh: expected a spacecraft that is seen, got one that is transparent or black"
            )

    def compare(self, axis: Axis) -> Symmetry | None:
        """Return how different the looks are after turns about an axis; None if not nearly same."""
        noise = contrast = 0.0
        for number, turn in itertools.product(range(VIEWS), _turns(axis)):
            after = self._render(multiply(self.attitudes[number], turn), self.suns[number])
            of_noise, of_contrast = _difference(self.before[number], after)
            noise, contrast = max(noise, of_noise), max(contrast, of_contrast)
            if noise > 1 and contrast > NEAR:
                return None
        along = np.asarray(axis.direction)
        offset = float(np.linalg.norm(np.cross(self.center, along)))
        # What moves the object by less than a pixel of these views is no offset.
        return Symmetry(axis, noise, contrast, offset if offset > self.reach / SIDE else 0.0)

    def _render(self, q: FloatArray, sun: FloatArray) -> NDArray[np.float32]:
        """Return the radiance ``(SIDE, SIDE, 3)`` of an attitude about the center."""
        distance = AWAY * self.reach
        back = rotation_matrix(q).T
        pose = Pose(np.array([0.0, 0.0, distance]) - back.T @ self.center, q)
        light = Light(  # without the Earth, whose shadows are drawn at random
            (back @ sun).astype(np.float32),
            -back[:, 2].astype(np.float32),
            lamp=LAMP * distance**2,
        )
        return draw_alone(self.craft, pose, self.camera, light)


def _difference(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[float, float]:
    """Return the difference of two looks in units of the noise, and of the contrast."""
    shown = (before > 0).any(axis=-1) | (after > 0).any(axis=-1)
    if not shown.any():
        return 0.0, 0.0
    sensor, lit = Sensor(), before[(before > 0).any(axis=-1)].T
    gain = choose_gain(before, lit, 0.0, np.random.default_rng(0))
    signal = before[shown] * gain
    error = float(np.sqrt(np.square(after[shown] * gain - signal).mean()))
    variance = signal.mean() / sensor.full_well + (sensor.read_noise / sensor.full_well) ** 2
    # The noise of a difference is that of two images.
    noise = float(np.sqrt(2 * variance))
    squares = np.square((after - before) * gain).mean(axis=-1)
    cells = squares.reshape(SIDE // PATCH, PATCH, SIDE // PATCH, PATCH).mean(axis=(1, 3))
    spread = float(signal.std(axis=0).mean())
    worst = max(error, float(np.sqrt(cells.max())) / EDGES)
    return worst / noise, error / max(spread, 1e-9)
