"""Draws spacecraft of mesh files, each with the axes that its network predicts.

Of folders that ffpose learn wrote, and the indices of the images that are shown, sunlit and near, with
errors about the median:

python docs/images/own_spacecraft.py own_spacecraft_hour.jpg iss=187,152,12,203 landsat=40,35,72,2 orion=25,35,31,76
python docs/images/own_spacecraft.py own_spacecraft_voyager_cubesat.jpg voyager=25,286,175,190 cubesat=189,37,268,195
"""

import sys
from collections.abc import Iterator
from pathlib import Path

from tiles import write_sheet

import ffpose
from ffpose._internal.seeds import CHOICES
from ffpose.inference.estimator import PoseEstimator
from ffpose.render import Scene
from ffpose.render.scene_file import find_scene

DIAMETERS = 1.2
"""Width of the part of an image that is shown, in diameters of the spacecraft."""


def rows(folders: list[str]) -> Iterator[tuple[PoseEstimator, Scene, float]]:
    """Return the network, the set and the shown width of each run."""
    for folder in folders:
        scene = find_scene(str(Path(folder, "scene.json")))
        yield (
            ffpose.load(folder, backend="onnxruntime"),
            scene,
            DIAMETERS * 2 * scene.build().radius,
        )


name, *runs = sys.argv[1:]
folders, images = zip(*(run.rsplit("=", 1) for run in runs), strict=True)
shown = [[int(index) for index in indices.split(",")] for indices in images]
write_sheet(Path(__file__).with_name(name), rows(folders), CHOICES.start, shown)
