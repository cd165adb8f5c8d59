"""Draws polar_view.jpg: what the second look of `polar` sees, before and after a turn."""

import math
from pathlib import Path

import numpy as np
import torch

from ffpose._internal.figures import new_figure, save_figure
from ffpose.config import PRESETS
from ffpose.models.virtual_camera import homography, pyramid, render_virtual, turn_to
from ffpose.nn.pyramid import sample_pyramid
from ffpose.render import render

SIDE = 400
"""Pixels along each side of the view in rows and columns."""

TURN_CELLS = 4
"""Cells of the last map, of 15 degrees each, by which the camera of the lower row is turned."""

config = PRESETS["polar"]
frame = render("soyuz_easy", 3, 4, size=(1024, 768))
image = torch.from_numpy(frame.image.copy()).permute(2, 0, 1)[None].float() / 255
point = torch.tensor(frame.pose.t).float()[None]
camera = frame.camera.resized(1024, 768)
intrinsics = torch.tensor([camera.fx, camera.fy, camera.cx, camera.cy])
cells = config.object_grid[1]

figure = new_figure(11, 5.2)
for row, turn in enumerate((0.0, 2 * math.pi / cells * TURN_CELLS)):
    twist = torch.tensor([turn])
    view = turn_to(point, config.object_radius_m, config.object_size, config.object_width, twist)
    side = ((torch.arange(SIDE) + 0.5) / SIDE - 0.5) * view.width
    plane = torch.stack(torch.meshgrid(side, side, indexing="xy"))
    finest, levels = torch.zeros(1), pyramid(image)
    seen = (
        picture[0].permute(1, 2, 0)
        for picture in (
            sample_pyramid(homography(view, intrinsics), finest, plane, levels),
            render_virtual(levels, view, point, intrinsics),
        )
    )
    left, right = (figure.add_subplot(2, 2, 2 * row + column) for column in (1, 2))
    for axes, picture in zip((left, right), seen, strict=True):
        axes.imshow(np.clip(picture.numpy(), 0, 1), aspect="auto" if axes is right else "equal")
        axes.set_xticks([])
        axes.set_yticks([])
    around = np.linspace(0, 2 * math.pi, 200)
    for radius in (50, 100, 150, 199):
        left.plot(200 + radius * np.cos(around), 200 + radius * np.sin(around), "w", lw=0.5)
    for angle in np.arange(0, 2 * math.pi, math.pi / 6):
        ends = np.array([8, 199])
        left.plot(200 + ends * math.cos(angle), 200 + ends * math.sin(angle), "w", lw=0.3)
    degrees = np.arange(0, 360, 60)
    right.set_xticks(degrees / 360 * config.object_size[1] - 0.5, [f"{d}°" for d in degrees])
    right.set_yticks([0, config.object_size[0] - 1], ["ray", f"{config.object_radius_m} m"])
    left.set_ylabel("as it is" if row == 0 else f"turned by {math.degrees(turn):.0f}°")
    if row == 0:
        left.set_title("virtual camera, and the rings that are sampled")
        right.set_title("what the network sees: radii × angles")
save_figure(figure, Path(__file__).with_suffix(".jpg"), format="jpg")
