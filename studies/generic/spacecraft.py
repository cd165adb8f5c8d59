"""Many spacecraft to learn from at once: those that come with ffpose, and some of random parts."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ffpose.imaging.patches import PatchSpec
from ffpose.learn.plan import BEYOND, DEFAULT_CAMERA, FAR_DIAMETERS, NEAR_DIAMETERS, VIEW_MARGIN
from ffpose.render import Scene
from ffpose.render.scene import lamp_for
from ffpose.render.spacecraft.craft import SHIPPED, Craft, bounding_sphere, build_craft
from ffpose.render.spacecraft.decoys import bus, fitting, paints, wings
from ffpose.render.spacecraft.mesh import merge, turn
from ffpose.training.calibration_images import varied

SEED = 700_000
"""Seed of the random spacecraft; those of their views count on from it, ten for each."""

KINDS = {"whole": 0.58, "cut": 0.12, "randomized": 0.2, "dusk": 0.1}
"""Shares of the views: as the set is, cut by the border, randomized, in the light of a low sun."""


class Subject(NamedTuple):
    """One of the spacecraft.

    Attributes:
        scene: Its set, at distances of so many diameters.
        radius_m: Greatest distance of its surface from its origin.
    """

    scene: Scene
    radius_m: float

    def spec(self, first_stride: int, object_width: int) -> PatchSpec:
        """Return how a network looks at it."""
        return PatchSpec(DEFAULT_CAMERA, first_stride, object_width, VIEW_MARGIN * self.radius_m)


def build_random_spacecraft(index: int) -> Craft:
    """Build a spacecraft of one or two bodies, wings and two to seven fittings.

    It is a pure function of its number, and has more parts than a decoy, which leave few of its
    sides alike. Its origin is the middle of its bounding sphere.

    Raises:
        ValueError: `index` is negative.
    """
    if index < 0:
        raise ValueError(f"index: expected at least 0, got {index}")
    rng = np.random.default_rng([SEED, index, 0xA11])
    length, width = rng.uniform(1.5, 7.0), rng.uniform(1.0, 3.5)
    parts = [bus(length, width, rng)]
    for _ in range(int(rng.integers(0, 2))):
        size = length * rng.uniform(0.3, 0.8), width * rng.uniform(0.4, 0.9)
        along = (rng.uniform(-0.4, 0.4) * length, 0.0, 0.0)
        second = bus(*size, rng).moved(turn("z", rng.uniform(0, 180)), along)
        roll = turn("x", rng.uniform(0, 360))
        parts.append(second.moved(roll, (0.0, 0.0, width * rng.uniform(0.2, 0.6))))
    for _ in range(int(rng.integers(0, 3))):
        parts += wings(length, width, rng)
    for _ in range(int(rng.integers(2, 8))):
        parts.append(fitting(length, width, rng))
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    mesh = merge(parts).moved(axes)
    center, _ = bounding_sphere(mesh.vertices)
    mesh = replace(mesh, vertices=mesh.vertices - center)
    return Craft(f"random-{SEED}-{index}", mesh, paints(rng))


def subject(number: int) -> Subject:
    """Return spacecraft ``number``: first those that come with ffpose, then random ones."""
    own = sorted(SHIPPED, reverse=True)
    craft = build_craft(own[number]) if number < len(own) else build_random_spacecraft(number)
    vertices = craft.mesh.vertices[np.unique(craft.mesh.faces)]
    radius = float(np.linalg.norm(vertices, axis=1).max())
    near, far = 2 * radius * NEAR_DIAMETERS, 2 * radius * FAR_DIAMETERS
    scene = Scene(
        f"many-{number}",
        craft,
        (near, far),
        far,  # as far off the axis as the frame goes
        attitude_range_deg=(180.0, 90.0, 180.0),
        camera=DEFAULT_CAMERA,
        lamp=lamp_for(craft),
    )
    return Subject(scene.scaled(*BEYOND), radius)


def parts(scene: Scene, number: int, views: int) -> list[tuple[Scene, int, int]]:
    """Return the sets of spacecraft ``number``, each with its seed and its number of views."""
    variants = varied(scene)
    first = SEED + 10 * number
    return [
        (variants[kind][0], first + place, max(1, round(share * views)))
        for place, (kind, share) in enumerate(KINDS.items())
    ]
