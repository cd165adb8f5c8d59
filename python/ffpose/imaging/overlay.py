"""Drawing a pose on its image, and images on a sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from ffpose.errors import expect
from ffpose.geometry import Camera, Pose

AXIS_COLORS = ("#ff4b4b", "#4bff6a", "#5b9dff")
"""Colors of the axes x, y and z."""

TRUTH_COLORS = ("#ffd0d0", "#d0ffd8", "#d5e2ff")
"""Colors of the true axes, pale because the predicted ones are drawn over them."""


def draw_axes(
    image: Image.Image,
    pose: Pose,
    camera: Camera,
    length: float | None = None,
    colors: Sequence[str] = AXIS_COLORS,
    width: int | None = None,
) -> Image.Image:
    """Draw the object's axes from its origin, back to front.

    Args:
        image: RGB image of any size.
        pose: The object's pose.
        camera: The camera, resized to the image, which must show the camera's whole view.
        length: Length of each axis, meters; None for a tenth of the object's distance.
        colors: Colors of the three axes.
        width: Width of the lines in pixels; None for a width suited to the image.

    Returns:
        A new image. An axis that reaches behind the camera is left out.

    Raises:
        ValueError: The image is not RGB, or there are not three colors.
    """
    expect(image.mode == "RGB", "image", "mode RGB", image.mode)
    drawn = image.copy()
    tips = (length or np.linalg.norm(pose.t) / 10) * np.eye(3)
    view = camera.resized(*image.size)
    origin, ends = pose.project(np.zeros(3), view), pose.project(tips, view)
    depths = pose.transform(tips)[:, 2]
    canvas = ImageDraw.Draw(drawn)
    thickness = width or max(2, round(min(image.size) / 120))
    axes = zip(depths, ends, colors, strict=True)
    for _, end, color in sorted(axes, key=lambda axis: -axis[0]):
        if np.isfinite([origin, end]).all():
            canvas.line([*origin, *end], fill=color, width=thickness)
    return drawn


def tiled(tiles: Sequence[Image.Image], columns: int, gap: int = 0) -> Image.Image:
    """Return images of one width, row by row on white, with so many pixels between and around."""
    width, height = tiles[0].width + gap, max(tile.height for tile in tiles) + gap
    rows = -(-len(tiles) // columns)
    sheet = Image.new("RGB", (columns * width + gap, rows * height + gap), "white")
    for place, tile in enumerate(tiles):
        row, column = divmod(place, columns)
        sheet.paste(tile, (column * width + gap, row * height + gap))
    return sheet
