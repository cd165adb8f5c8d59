"""A spacecraft of six colored lamps on a dark frame, to be found in images without a doubt."""

import numpy as np

from ffpose.render.scene import Scene
from ffpose.render.shading.sensor import Sensor
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import Material
from ffpose.render.spacecraft.mesh import ball, merge, tube

LAMPS = {
    "red": ((2.0, 0.0, 0.0), (1, 0, 0)),
    "green": ((0.0, 2.0, 0.0), (0, 1, 0)),
    "blue": ((0.0, 0.0, 2.0), (0, 0, 1)),
    "cyan": ((-1.5, 0.0, 0.5), (0, 1, 1)),
    "magenta": ((0.5, -1.5, 0.0), (1, 0, 1)),
    "yellow": ((0.0, 0.5, -1.5), (1, 1, 0)),
}
RADIUS = 0.15


def beacons() -> Craft:
    dark = Material((0.0, 0.0, 0.0), 1.0)
    lamps = [
        Material((0, 0, 0), 1.0, emission=tuple(3.0 * c for c in rgb)) for _, rgb in LAMPS.values()
    ]
    parts = [ball(place, RADIUS, n + 1, 32) for n, (place, _) in enumerate(LAMPS.values())]
    parts += [tube((0, 0, 0), 0.9 * np.array(place), 0.01, 0) for place, _ in LAMPS.values()]
    return Craft("beacons", merge(parts), (dark, *lamps), {k: p for k, (p, _) in LAMPS.items()})


def beacon_scene() -> Scene:
    return Scene("beacons", beacons(), (8.0, 16.0), 8.0, min_visible=1.0, sensor=Sensor(bloom=0.0))
