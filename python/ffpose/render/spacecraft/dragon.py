"""A Dragon-like spacecraft: a capsule with an open nose cone, and a trunk with solar cells.

Frame: x along the docking axis, forward; y to starboard; z down. The origin lies on the axis where
capsule and trunk meet. 8 m long with the nose open, 3.7 m across, 4.9 m over the fins.

No view is ambiguous: the trunk carries cells to starboard and radiators to port, the nose cone
hangs open toward −z, windows and hatch look to +z, and the two upper fins are shorter.
"""

from __future__ import annotations

import numpy as np

from ffpose.render.spacecraft.materials import Material, Pattern
from ffpose.render.spacecraft.mesh import (
    Mesh,
    ball,
    box,
    ellipse_arc,
    lathe,
    merge,
    path_tube,
    tube,
    turn,
)

MATERIALS = (
    Material((0.80, 0.80, 0.79), 0.45, pattern=Pattern.PANELS, scale=0.62),  # SHELL
    Material((0.72, 0.72, 0.70), 0.50, pattern=Pattern.PANELS, scale=0.5),  # RADIATOR
    Material((0.030, 0.036, 0.075), 0.16, pattern=Pattern.CELLS, scale=0.21),  # CELLS
    Material((0.085, 0.075, 0.07), 0.8, pattern=Pattern.BLANKET, scale=0.45),  # SHIELD
    Material((0.58, 0.58, 0.59), 0.38, 0.6),  # METAL
    Material((0.78, 0.78, 0.77), 0.5),  # WHITE
    Material((0.035, 0.035, 0.04), 0.45),  # BLACK
    Material((0.02, 0.03, 0.04), 0.05),  # GLASS
    Material((0.04, 0.10, 0.36), 0.5),  # BLUE
    Material((0.85, 0.61, 0.28), 0.38, 0.7, pattern=Pattern.FOIL, scale=0.14),  # FOIL
    Material((0.5, 0.02, 0.02), 0.5, emission=(3.0, 0.10, 0.08)),  # RED
    Material((0.02, 0.4, 0.05), 0.5, emission=(0.08, 2.2, 0.25)),  # GREEN
)
(SHELL, RADIATOR, CELLS, SHIELD, METAL, WHITE, BLACK, GLASS, BLUE, FOIL, RED, GREEN) = range(
    len(MATERIALS)
)

RADIUS = 1.85
TRUNK_AFT = -3.65
CONE_FOOT = (0.28, 1.83)
CONE_TOP = (2.95, 1.02)
CONE_DEG = float(np.degrees(np.arctan2(CONE_FOOT[1] - CONE_TOP[1], CONE_TOP[0] - CONE_FOOT[0])))
HINGE = (3.06, 0.0, -0.97)
OPENING_DEG = 138.0
FIN_TIPS = {45.0: 2.60, 135.0: 2.60, 225.0: 2.25, 315.0: 2.25}
"""Distance of each fin's tip from the axis by its angle from +y toward +z."""

KEYPOINTS = {
    "ring": (3.42, 0.0, 0.0),
    "red_light": (0.12, -1.92, 0.0),
    "green_light": (0.12, 1.92, 0.0),
    **{
        f"fin_{int(angle)}": (
            TRUNK_AFT,
            tip * float(np.cos(np.radians(angle))),
            tip * float(np.sin(np.radians(angle))),
        )
        for angle, tip in FIN_TIPS.items()
    },
}


def build() -> Mesh:
    """Build the whole spacecraft as one mesh; material numbers index `MATERIALS`."""
    return merge([*_trunk(), *_capsule(), *_nose(), *_engines(), *_openings(), *_lights()])


def _trunk() -> list[Mesh]:
    side = [(TRUNK_AFT, RADIUS), (-0.16, RADIUS)]
    parts = [
        lathe(side, CELLS, 40, (-88.0, 88.0)),
        lathe(side, RADIATOR, 40, (92.0, 268.0)),
        lathe(side, METAL, 4, (88.0, 92.0)),
        lathe(side, METAL, 4, (268.0, 272.0)),
        lathe([(-0.16, RADIUS), (-0.10, 1.80), (-0.10, 1.2)], METAL),
        # Open at the back: the inside and the rim.
        lathe([(-0.30, 0.0), (-0.30, 1.79), (TRUNK_AFT, 1.79)], FOIL),
        lathe([(TRUNK_AFT, 1.79), (TRUNK_AFT - 0.05, 1.82), (TRUNK_AFT, RADIUS)], METAL),
    ]
    for angle, tip in FIN_TIPS.items():
        height = tip - RADIUS + 0.05
        fin = box((1.35, height, 0.07), [METAL, METAL, BLACK, WHITE, WHITE, WHITE])
        parts.append(
            fin.moved(shift=(TRUNK_AFT + 0.675, RADIUS - 0.05 + height / 2, 0)).moved(
                turn("x", angle)
            )
        )
    return parts


def _capsule() -> list[Mesh]:
    return [
        lathe([(-0.10, 1.2), (-0.10, 1.70), (0.02, 1.82), (0.12, 1.86), CONE_FOOT], SHIELD),
        lathe([CONE_FOOT, CONE_TOP], SHELL),
        lathe([CONE_TOP, (3.06, 0.92), (3.10, 0.78)], SHELL),
    ]


def _nose() -> list[Mesh]:
    """Build the docking ring, and the nose cone swung open toward −z."""
    cap = merge(
        [
            lathe(ellipse_arc(0.0, 0.95, 0.90, 90.0, 0.0, 10), SHELL, 48),
            lathe(ellipse_arc(0.0, 0.91, 0.86, 0.0, 90.0, 10), BLACK, 48),
            lathe([(0.0, 0.86), (-0.03, 0.88), (0.0, 0.90)], METAL, 48),
        ]
    )
    pivot = np.array(HINGE)
    opened = cap.moved(shift=(3.10, 0.0, 0.0) - pivot).moved(turn("y", OPENING_DEG), pivot)
    hinge = [
        path_tube([(2.80, y, -0.98), (2.98, y, -1.02), (3.20, y, -1.06)], 0.05, METAL)
        for y in (-0.22, 0.22)
    ]
    ring = [
        lathe([(3.10, 0.78), (3.30, 0.72), (3.42, 0.66), (3.42, 0.58)], METAL, 48),
        lathe([(3.42, 0.58), (3.20, 0.52), (3.20, 0.0)], BLACK, 48),
        *(
            box((0.16, 0.20, 0.03), METAL).moved(shift=(3.47, 0, 0.60)).moved(turn("x", angle))
            for angle in (0.0, 120.0, 240.0)
        ),
    ]
    return [opened, *hinge, *ring]


def _engines() -> list[Mesh]:
    """Build four pods with two nozzles each, sunk into the cone."""
    # A fairing twice as wide as it is high covers each pair of nozzles.
    fairing = lathe(ellipse_arc(0.0, 0.85, 0.30, 180.0, 0.0, 17), SHELL, 36)
    pod = fairing.moved(np.diag((1.0, 1.0, 2.0))).moved(turn("z", -CONE_DEG), (1.02, 1.58, 0.0))
    nozzles = [tube((0.34, 1.83, z), (0.62, 1.78, z), 0.15, BLACK, 20) for z in (-0.28, 0.28)]
    return [
        part.moved(turn("x", angle))
        for angle in (45.0, 135.0, 225.0, 315.0)
        for part in (pod, *nozzles)
    ]


def _openings() -> list[Mesh]:
    """Build windows and hatch toward +z, and a blue mark to port."""

    def on_cone(x: float, degrees: float, radius: float, number: int, lift: float) -> Mesh:
        share = (x - CONE_FOOT[0]) / (CONE_TOP[0] - CONE_FOOT[0])
        away = CONE_FOOT[1] + share * (CONE_TOP[1] - CONE_FOOT[1])
        plug = tube((0.0, -0.3, 0.0), (0.0, lift, 0.0), radius, number, 32)
        return plug.moved(turn("z", -CONE_DEG), (x, away, 0.0)).moved(turn("x", degrees))

    parts = []
    for x, degrees, radius, glass in (
        (2.15, 78.0, 0.20, GLASS),
        (2.15, 102.0, 0.20, GLASS),
        (1.15, 90.0, 0.50, WHITE),
        (1.30, 180.0, 0.34, BLUE),
        (2.20, 270.0, 0.16, GLASS),
    ):
        parts.append(on_cone(x, degrees, radius + 0.05, METAL, 0.035))
        parts.append(on_cone(x, degrees, radius, glass, 0.05))
    return parts


def _lights() -> list[Mesh]:
    return [
        ball((0.12, -1.86, 0.0), 0.08, RED, 16),
        ball((0.12, 1.86, 0.0), 0.08, GREEN, 16),
    ]
