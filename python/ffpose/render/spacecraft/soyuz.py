"""A Soyuz-like spacecraft: orbital, descent and service modules, and two solar wings.

Frame: x along the docking axis, forward; y to starboard, along the wings; z down, to the Earth in
level flight. The origin lies on the axis in the descent module. Sizes follow published drawings:
7.5 m long, 2.7 m wide at the base, 10.6 m between the wings' tips.

No view is ambiguous: the wings have their cells on the −z side only, the periscope looks down (+z),
the rendezvous dish stands on −z, the sidelights are red to port and green to starboard, and port
and starboard carry different antennas, hatch and radiator.
"""

from __future__ import annotations

from itertools import product

from ffpose.render.spacecraft.materials import Material, Pattern
from ffpose.render.spacecraft.mesh import (
    Mesh,
    ball,
    box,
    dish,
    ellipse_arc,
    lathe,
    merge,
    path_tube,
    tube,
    turn,
)

MATERIALS = (
    Material((0.30, 0.34, 0.25), 0.75, pattern=Pattern.BLANKET, scale=0.55),  # ORBITAL
    Material((0.17, 0.145, 0.12), 0.7, pattern=Pattern.BLANKET, scale=0.5),  # DESCENT
    Material((0.60, 0.60, 0.57), 0.6, pattern=Pattern.PANELS, scale=0.45),  # SERVICE
    Material((0.82, 0.82, 0.80), 0.35, pattern=Pattern.PANELS, scale=0.3),  # RADIATOR
    Material((0.90, 0.64, 0.28), 0.36, 0.75, pattern=Pattern.FOIL, scale=0.14),  # FOIL
    Material((0.035, 0.05, 0.16), 0.18, pattern=Pattern.CELLS, scale=0.16),  # CELLS
    Material((0.52, 0.50, 0.45), 0.65, pattern=Pattern.PANELS, scale=0.53),  # WING_BACK
    Material((0.56, 0.57, 0.59), 0.36, 0.6),  # METAL
    Material((0.70, 0.70, 0.68), 0.45),  # WHITE
    Material((0.03, 0.03, 0.035), 0.4),  # BLACK
    Material((0.02, 0.03, 0.04), 0.06),  # GLASS
    Material((0.5, 0.02, 0.02), 0.5, emission=(3.0, 0.10, 0.08)),  # RED
    Material((0.02, 0.4, 0.05), 0.5, emission=(0.08, 2.2, 0.25)),  # GREEN
    Material((0.75, 0.22, 0.04), 0.55),  # ORANGE
)
ORBITAL, DESCENT, SERVICE, RADIATOR, FOIL, CELLS, WING_BACK = range(7)
METAL, WHITE, BLACK, GLASS, RED, GREEN, ORANGE = range(7, 14)

WING_X = -2.05
WING_ROOT = 1.45
WING_TIP = 5.3
WING_CHORD = 1.45
WING_SEGMENTS = 4

KEYPOINTS = {
    "probe_tip": (4.02, 0.0, 0.0),
    "nozzle": (-3.56, 0.0, 0.0),
    "starboard_fore_tip": (WING_X + WING_CHORD / 2, WING_TIP, 0.0),
    "starboard_aft_tip": (WING_X - WING_CHORD / 2, WING_TIP, 0.0),
    "port_fore_tip": (WING_X + WING_CHORD / 2, -WING_TIP, 0.0),
    "port_aft_tip": (WING_X - WING_CHORD / 2, -WING_TIP, 0.0),
    "periscope": (-0.05, 0.0, 1.62),
    "dish": (2.35, 0.0, -1.72),
    "red_light": (-1.3, -1.22, 0.0),
    "green_light": (-1.3, 1.22, 0.0),
}


def build() -> Mesh:
    """Build the whole spacecraft as one mesh; material numbers index `MATERIALS`."""
    return merge(
        [
            *_service_module(),
            *_descent_module(),
            *_orbital_module(),
            *_docking_probe(),
            *_wing(1.0),
            *_wing(-1.0),
            *_antennas(),
            *_lights(),
        ]
    )


def _service_module() -> list[Mesh]:
    body = [
        lathe([(-3.30, 0.0), (-3.30, 1.30), (-3.22, 1.36), (-2.95, 1.36)], METAL),
        lathe([(-2.95, 1.36), (-2.50, 1.13)], FOIL),
        lathe([(-2.50, 1.13), (-1.25, 1.10)], SERVICE),
        lathe([(-1.25, 1.10), (-1.05, 1.10), (-1.05, 0.98)], METAL),
        lathe([(-3.56, 0.34), (-3.40, 0.27), (-3.29, 0.16)], BLACK, 32),
        lathe([(-3.29, 0.15), (-3.40, 0.26), (-3.56, 0.335)], METAL, 32),
    ]
    # The radiator covers the port side only.
    radiator = [
        box((1.05, 0.52, 0.03), [WHITE, WHITE, WHITE, WHITE, RADIATOR, RADIATOR])
        .moved(shift=(0, 0, -1.13))
        .moved(turn("x", angle), (-1.88, 0, 0))
        for angle in (-60, -90, -120)
    ]
    thrusters = [
        lathe([(-0.10, 0.06), (0.05, 0.03)], BLACK, 12).moved(shift=(-3.30, y, z))
        for y, z in ((0, 1.12), (0, -1.12), (1.12, 0), (-1.12, 0))
    ]
    return body + radiator + thrusters


def _descent_module() -> list[Mesh]:
    bell = lathe(
        [
            (-1.05, 0.98),
            (-1.00, 1.08),
            (-0.70, 1.09),
            (-0.30, 1.04),
            (0.10, 0.95),
            (0.50, 0.81),
            (0.80, 0.62),
            (0.98, 0.42),
            (1.05, 0.36),
        ],
        DESCENT,
    )
    windows = [
        merge(
            [
                tube((-0.25, side * 0.98, -0.12), (-0.25, side * 1.10, -0.13), 0.17, METAL, 24),
                tube((-0.25, side * 1.00, -0.12), (-0.25, side * 1.115, -0.13), 0.13, GLASS, 24),
            ]
        )
        for side in (1.0, -1.0)
    ]
    periscope = [
        tube((-0.05, 0.0, 0.90), (-0.05, 0.0, 1.42), 0.13, BLACK, 20),
        box((0.34, 0.26, 0.24), WHITE).moved(shift=(0.0, 0.0, 1.50)),
        tube((0.12, 0.0, 1.50), (0.20, 0.0, 1.50), 0.09, GLASS, 20),
    ]
    return [bell, *windows, *periscope]


def _orbital_module() -> list[Mesh]:
    aft = ellipse_arc(1.95, 0.92, 1.12, 158.0, 90.0, 9)
    fore = ellipse_arc(2.35, 0.92, 1.12, 90.0, 24.0, 9)
    body = [
        lathe([(1.02, 0.36), (1.05, 0.44), aft[0]], METAL),
        lathe(aft, ORBITAL),
        lathe([aft[-1], fore[0]], ORBITAL),
        lathe(fore, ORBITAL),
        lathe([fore[-1], (3.25, 0.46), (3.32, 0.46), (3.32, 0.0)], METAL),
        lathe([(2.10, 1.135), (2.20, 1.135)], WHITE),
    ]
    # A side hatch to starboard, an orange handrail to port.
    hatch = [
        tube((2.15, 1.02, 0.0), (2.15, 1.165, 0.0), 0.40, METAL, 32),
        tube((2.15, 1.03, 0.0), (2.15, 1.185, 0.0), 0.34, WHITE, 32),
        tube((2.15, 1.04, 0.0), (2.15, 1.195, 0.0), 0.10, BLACK, 24),
    ]
    rail = path_tube(
        [(1.75, -1.05, 0.25), (1.75, -1.26, 0.28), (2.55, -1.26, 0.28), (2.55, -1.05, 0.25)],
        0.03,
        ORANGE,
    )
    return [*body, *hatch, rail]


def _docking_probe() -> list[Mesh]:
    return [
        lathe([(3.32, 0.40), (3.45, 0.30), (3.45, 0.0)], METAL, 32),
        tube((3.40, 0, 0), (3.92, 0, 0), 0.075, METAL, 20),
        ball((3.95, 0, 0), 0.09, METAL),
        *(
            tube((3.42, 0.24 * y, 0.24 * z), (3.62, 0.07 * y, 0.07 * z), 0.025, BLACK, 8)
            for y, z in product((1, -1), repeat=2)
        ),
    ]


def _wing(side: float) -> list[Mesh]:
    """Build one solar wing; `side` is +1 to starboard, −1 to port."""
    length = (WING_TIP - WING_ROOT) / WING_SEGMENTS
    gap = 0.05
    parts = []
    for number in range(WING_SEGMENTS):
        middle = side * (WING_ROOT + length * (number + 0.5))
        plate = box(
            (WING_CHORD, length - gap, 0.035), [METAL, METAL, METAL, METAL, CELLS, WING_BACK]
        )
        parts.append(plate.moved(shift=(WING_X, middle, 0.0)))
        # Stiffening ribs stand on the back only.
        for offset in (-0.36, 0.36):
            rib = box((0.05, length - gap, 0.06), METAL)
            parts.append(rib.moved(shift=(WING_X + offset * WING_CHORD, middle, 0.045)))
    spar_start, spar_stop = side * 1.05, side * (WING_ROOT + 0.1)
    parts.append(tube((WING_X, spar_start, 0.0), (WING_X, spar_stop, 0.0), 0.07, METAL))
    struts = [
        tube((WING_X + 0.4 * x, spar_start, 0.0), (WING_X + x, spar_stop, 0.0), 0.035, METAL)
        for x in (-0.5, 0.5)
    ]
    return parts + struts


def _antennas() -> list[Mesh]:
    kurs = [
        path_tube([(2.15, 0, -1.05), (2.15, 0, -1.55), (2.30, 0, -1.72)], 0.04, METAL),
        dish((2.42, 0, -1.72), (1, 0, 0), 0.30, 0.12, WHITE, METAL),
        tube((2.31, 0, -1.72), (2.55, 0, -1.72), 0.02, METAL, 8),
    ]
    # Starboard aft: a whip; port aft: a short boom with a box.
    whip = [tube((-2.6, 0.85, -0.85), (-3.3, 1.75, -1.75), 0.022, METAL, 8)]
    boom = [
        path_tube([(-2.6, -0.8, 0.8), (-2.6, -1.35, 1.35)], 0.045, METAL),
        box((0.30, 0.22, 0.22), ORANGE).moved(turn("x", 45), (-2.6, -1.42, 1.42)),
    ]
    tips = [
        tube(
            (WING_X, side * WING_TIP, 0),
            (WING_X + 0.5, side * (WING_TIP + 0.25), 0),
            0.02,
            METAL,
            8,
        )
        for side in (1.0, -1.0)
    ]
    return kurs + whip + boom + tips


def _lights() -> list[Mesh]:
    return [
        ball((-1.30, -1.16, 0.0), 0.08, RED, 16),
        ball((-1.30, 1.16, 0.0), 0.08, GREEN, 16),
    ]
