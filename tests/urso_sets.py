"""A small URSO set, made by hand, that holds every trap of the real ones.

Images are 64x48, URSO's 1280x960 through twenty. Each is dark, with a bright square of 3x3 pixels
where the label says that the object's origin is, worked out by hand in URSO's own frame:
u = 32 + 32 x / z, v = 24 - 32.02315 y / z.
"""

import numpy as np
from PIL import Image

SIZE = (64, 48)
HEADER = ("q4", "z", "q1", "x", "q3", "y", "q2")
"""Not the order of the original, so that only names can find the columns."""

LABELS = {
    "0_rgb.png": {"x": 2, "y": 1, "z": 10, "q1": 0.1, "q2": -0.5, "q3": 0.5, "q4": -0.7},
    "1_rgb.png": {"x": -3, "y": -2, "z": 12, "q1": 0, "q2": 0.6, "q3": 0, "q4": 0.8},
    "2_rgb.png": {"x": 0, "y": 4, "z": 20, "q1": 0, "q2": 0, "q3": -1, "q4": 0},
    "3_rgb.png": {"x": 5, "y": 0, "z": 25, "q1": 0.48, "q2": 0.64, "q3": 0, "q4": -0.6},
}
POSES = {
    "0_rgb.png": [2, -1, 10, 0.7, -0.1, -0.5, -0.5],
    "1_rgb.png": [-3, 2, 12, 0.8, 0, -0.6, 0],
    "2_rgb.png": [0, -4, 20, 0, 0, 0, 1],
    "3_rgb.png": [5, 0, 25, 0.6, -0.48, 0.64, 0],
}
PIXELS = {
    "0_rgb.png": (38, 20),
    "1_rgb.png": (24, 29),
    "2_rgb.png": (32, 17),
    "3_rgb.png": (38, 24),
}
"""Column and row of the pixel that holds the origin."""

SPLITS = {"train": ["2_rgb.png", "0_rgb.png"], "val": ["3_rgb.png"], "test": ["1_rgb.png"]}
MODES = {"0_rgb.png": "RGBA", "1_rgb.png": "RGB", "2_rgb.png": "P", "3_rgb.png": "RGBA"}


def table(names, labels=LABELS):
    rows = [",".join(str(labels[name][column]) for column in HEADER) for name in names]
    return "\n".join([",".join(HEADER), *rows, ""])


def picture(name):
    pixels = np.full((SIZE[1], SIZE[0], 3), 20, np.uint8)
    column, row = PIXELS[name]
    pixels[row - 1 : row + 2, column - 1 : column + 2] = (250, 200, 150)
    image = Image.fromarray(pixels)
    if MODES[name] == "RGBA":
        image.putalpha(40)  # to be dropped, not to be mixed in
    if MODES[name] == "P":
        image = image.quantize(8)
        image.info["transparency"] = bytes([0] * 8)
    return image


def write_set(root, images="images"):
    """Write the set; ``images`` is the folder of the images within it, "" for the set's own."""
    folder = root / images
    folder.mkdir(parents=True, exist_ok=True)
    for name in LABELS:
        picture(name).save(folder / name)
    (root / "gt.csv").write_text(table(LABELS))
    for split, names in SPLITS.items():
        (root / f"{split}_images.csv").write_text("\n".join(names) + "\n")
        (root / f"{split}_poses_gt.csv").write_text(table(names))
    return root
