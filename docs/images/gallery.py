"""Draws gallery.jpg: rendered spacecraft, each with the axes that its shipped network predicts."""

from dataclasses import replace
from pathlib import Path

from tiles import write_sheet

import ffpose
from ffpose._internal.seeds import CHOICES
from ffpose.render import find_scene

SHOWN_M = 16.0
"""Width of the part of an image that is shown, at the spacecraft."""

SHOWN = {"soyuz_easy": (0, 1, 2, 3), "soyuz_hard": (4, 5, 6, 7), "dragon_hard": (8, 9, 10, 11)}
"""Indices of the images of each set."""

rows = (
    (
        ffpose.load(name.partition("_")[0], backend="onnxruntime"),
        replace(find_scene(name), attitude_range_deg=(180.0, 90.0, 180.0)),
        SHOWN_M,
    )
    for name in SHOWN
)
write_sheet(Path(__file__).with_suffix(".jpg"), rows, CHOICES.start, list(SHOWN.values()))
