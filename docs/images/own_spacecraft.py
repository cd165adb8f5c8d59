"""Draws own_spacecraft.jpg: spacecraft of mesh files, each with the axes that its network predicts.

python docs/images/own_spacecraft.py station landsat hubble    folders that ffpose learn wrote
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


SHOWN = [(2, 21, 23, 31), (14, 17, 23, 35), (2, 23, 31, 35)]
"""Indices of each row's images: sunlit and near, with errors about the median."""


def rows(folders: list[str]) -> Iterator[tuple[PoseEstimator, Scene, float]]:
    """Return the network, the set and the shown width of each run."""
    for folder in folders:
        scene = find_scene(str(Path(folder, "scene.json")))
        yield (
            ffpose.load(folder, backend="onnxruntime"),
            scene,
            DIAMETERS * 2 * scene.build().radius,
        )


write_sheet(Path(__file__).with_suffix(".jpg"), rows(sys.argv[1:]), CHOICES.start, SHOWN)
