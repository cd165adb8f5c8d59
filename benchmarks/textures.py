"""Cost of textures: images of meshes with them beside those of the same meshes without.

``python -m benchmarks textures MESH...`` prints CPU milliseconds of an image, and their ratio.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ffpose.render import Scene, load_craft, render
from ffpose.render.spacecraft.craft import Craft, bounding_sphere

SIZE = 512, 384
IMAGES, ROUNDS = 6, 5


def compare(craft: Craft) -> tuple[float, float]:
    """Return the least seconds of an image without textures and with them, in turns."""
    maps = ("color_map", "roughness_map", "normal_map", "emission_map")
    none: dict[str, Any] = dict.fromkeys(maps)
    plain = replace(craft, materials=tuple(replace(m, **none) for m in craft.materials))
    radius = bounding_sphere(craft.mesh.vertices)[1]
    near, far = 3 * radius, 6 * radius
    scenes = [Scene("mesh", each, (near, far), 0.5 * radius) for each in (plain, craft)]
    best = [float("inf")] * 2
    for _ in range(ROUNDS):
        for which, scene in enumerate(scenes):
            start = time.process_time()
            for index in range(IMAGES):
                render(scene, 0, index, SIZE)
            best[which] = min(best[which], (time.process_time() - start) / IMAGES)
    return best[0], best[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command line."""
    parser.add_argument("meshes", nargs="+", metavar="MESH", help="file, as for ffpose render")


def run(options: argparse.Namespace) -> None:
    """Measure each mesh, and print a line of it."""
    for path in options.meshes:
        without, with_them = compare(load_craft(path, center=True))
        ratio = with_them / without
        print(f"{Path(path).name}: {without * 1e3:.0f} {with_them * 1e3:.0f} ms, {ratio:.2f}")
