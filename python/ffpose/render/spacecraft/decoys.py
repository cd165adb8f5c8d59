"""Decoys: random spacecraft, as negative examples for a network trained on one spacecraft.

A decoy has a bus (box or cylinder), solar wings, booms, tanks and thrusters of random sizes and
materials. None models a real spacecraft. Each is a pure function of seed and index.
"""

from __future__ import annotations

import numpy as np

from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material, Pattern
from ffpose.render.spacecraft.mesh import Mesh, ball, box, lathe, merge, tube, turn

METAL, CELLS, WHITE, FOIL, BLANKET, BLACK = range(6)
COVERS = (METAL, WHITE, FOIL, BLANKET)


def build_decoy(seed: int, index: int) -> Craft:
    """Build decoy number ``index`` of a seed; both are at least 0."""
    if seed < 0 or index < 0:
        raise ValueError(f"seed and index: expected at least 0, got {seed} and {index}")
    rng = np.random.default_rng([seed, index, 0xDEC0])
    length, width = rng.uniform(1.5, 7.0), rng.uniform(1.0, 3.5)
    parts = [bus(length, width, rng)]
    for _ in range(int(rng.integers(0, 3))):
        parts += wings(length, width, rng)
    for _ in range(int(rng.integers(0, 3))):
        parts.append(fitting(length, width, rng))
    mesh = merge(parts)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return Craft(f"decoy-{seed}-{index}", mesh.moved(axes), paints(rng))


def paints(rng: np.random.Generator) -> tuple[Material, ...]:
    """Choose the materials that the parts name: metal, cells, white, foil, blanket, black."""

    def gray(low: float, high: float) -> tuple[float, float, float]:
        r, g, b = np.clip(rng.uniform(low, high) + rng.uniform(-0.06, 0.06, 3), 0.01, 1)
        return float(r), float(g), float(b)

    return (
        Material(gray(0.4, 0.7), 0.4, 0.6),
        Material((0.03, 0.04, float(rng.uniform(0.05, 0.15))), 0.16, pattern=Pattern.CELLS),
        Material(gray(0.6, 0.85), 0.5, pattern=Pattern.PANELS, scale=0.6),
        Material((0.85, 0.61, 0.28), 0.38, 0.7, pattern=Pattern.FOIL, scale=0.14),
        Material(gray(0.1, 0.7), 0.8, pattern=Pattern.BLANKET, scale=0.45),
        Material((0.035, 0.035, 0.04), 0.45),
    )


def bus(length: float, width: float, rng: np.random.Generator) -> Mesh:
    """Build a body along x, a box or a cylinder with a nose; meters."""
    cover = int(rng.choice(COVERS))
    if rng.random() < 0.5:
        return box((length, width, width * rng.uniform(0.6, 1.0)), cover)
    half, radius = length / 2, width / 2
    nose = radius * rng.uniform(0.2, 1.0)
    profile = [(half, 0.0), (half, nose), (half * rng.uniform(0.2, 0.9), radius)]
    return lathe([*profile, (-half, radius), (-half, 0.0)], cover, 32)


def wings(length: float, width: float, rng: np.random.Generator) -> list[Mesh]:
    """Build one solar wing of a bus of that size, or two on opposite sides."""
    span, chord = rng.uniform(1.0, 5.0), rng.uniform(0.5, 2.0)
    place = rng.uniform(-0.4, 0.4) * length
    roll = rng.uniform(0, 360)
    wing = box((chord, span, 0.05), CELLS).moved(turn("y", rng.uniform(-90, 90)))
    out = (0.0, width / 2 + span / 2 + rng.uniform(0.1, 0.6), 0.0)
    sides = (0.0, 180.0) if rng.random() < 0.8 else (0.0,)
    return [
        wing.moved(shift=out).moved(turn("x", roll + side), (place, 0.0, 0.0)) for side in sides
    ]


def fitting(length: float, width: float, rng: np.random.Generator) -> Mesh:
    """Build a tank, a boom or a thruster on a bus of that size."""
    angle = rng.uniform(0, 360)
    place = (rng.uniform(-0.5, 0.5) * length, 0.0, 0.0)
    match int(rng.integers(3)):
        case 0:
            part = ball((0.0, width / 2, 0.0), rng.uniform(0.2, 0.8), int(rng.choice(COVERS)))
        case 1:
            end = (rng.uniform(-1, 1), width / 2 + rng.uniform(0.5, 4.0), 0.0)
            part = tube((0.0, 0.0, 0.0), end, rng.uniform(0.04, 0.12), BLACK)
        case _:
            part = tube(
                (0.0, width / 2, 0.0),
                (0.0, width / 2 + rng.uniform(0.3, 1.0), 0.0),
                rng.uniform(0.3, 0.9),
                METAL,
            )
    return part.moved(turn("x", angle), place)
