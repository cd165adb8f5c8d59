"""Draws gallery.jpg: rendered spacecraft, each with the axes that its shipped network predicts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import ffpose
from ffpose._internal.seeds import CHOICES
from ffpose.imaging.overlay import draw_axes
from ffpose.render import get_scene, render

SIZE, TILE, COLUMNS = (1280, 960), (400, 300), 4
SHOWN_M = 16.0
"""Width of the part of an image that is shown, at the spacecraft."""

SHOWN = {"soyuz_easy": (0, 1, 2, 3), "soyuz_hard": (4, 5, 6, 7), "dragon_hard": (8, 9, 10, 11)}
"""Indices of the images of each set."""

sheet = Image.new("RGB", (COLUMNS * TILE[0], len(SHOWN) * TILE[1]))
for row, (name, indices) in enumerate(SHOWN.items()):
    estimate = ffpose.load(name.partition("_")[0], backend="onnxruntime")
    scene = replace(get_scene(name), attitude_range_deg=(180.0, 90.0, 180.0))
    for column, index in enumerate(indices):
        frame = render(scene, CHOICES.start, index, SIZE)
        camera = frame.camera.resized(*SIZE)
        pose = estimate(np.ascontiguousarray(frame.image))
        thickness = max(2, round(60 / frame.pose.t[2]))
        drawn = draw_axes(Image.fromarray(frame.image), pose, camera, width=thickness)
        width = min(SHOWN_M * camera.fx / frame.pose.t[2], SIZE[0])
        shown = np.array([width, 0.75 * width])
        corner = np.clip(pose.project(np.zeros(3), camera) - shown / 2, 0, SIZE - shown)
        tile = drawn.resize(TILE, Image.Resampling.LANCZOS, (*corner, *(corner + shown)))
        sheet.paste(tile, (column * TILE[0], row * TILE[1]))
sheet.save(Path(__file__).with_suffix(".jpg"), quality=85)
