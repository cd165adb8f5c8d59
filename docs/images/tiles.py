"""Draws rendered spacecraft with the axes that a network predicts, in rows of four tiles."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ffpose.imaging.overlay import draw_axes
from ffpose.inference.estimator import PoseEstimator
from ffpose.render import Scene, render

SIZE, TILE = (1280, 960), (400, 300)


def write_sheet(
    path: Path,
    rows: Iterable[tuple[PoseEstimator, Scene, float]],
    seed: int,
    images: Sequence[Sequence[int]],
) -> None:
    """Write a JPEG of tiles, each the part of a rendered image about the spacecraft.

    Args:
        path: File to write.
        rows: Of each row the network, the set, and the width of what a tile shows, meters.
        seed: Seed of the images.
        images: Indices of each row's images.
    """
    sheet = Image.new("RGB", (len(images[0]) * TILE[0], len(images) * TILE[1]))
    for row, ((estimate, scene, shown_m), indices) in enumerate(zip(rows, images, strict=True)):
        for column, index in enumerate(indices):
            frame = render(scene, seed, index, SIZE)
            camera = frame.camera.resized(*SIZE)
            pose = estimate(np.ascontiguousarray(frame.image))
            width = min(shown_m * camera.fx / frame.pose.t[2], SIZE[0])
            thickness = max(2, round(60 / 16 * shown_m / frame.pose.t[2]))
            drawn = draw_axes(
                Image.fromarray(frame.image), pose, camera, shown_m / 8, width=thickness
            )
            shown = np.array([width, 0.75 * width])
            corner = np.clip(pose.project(np.zeros(3), camera) - shown / 2, 0, SIZE - shown)
            tile = drawn.resize(TILE, Image.Resampling.LANCZOS, (*corner, *(corner + shown)))
            sheet.paste(tile, (column * TILE[0], row * TILE[1]))
    sheet.save(path, quality=85)
