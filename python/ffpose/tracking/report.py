"""A track as one page: errors or values within ±3σ, consistency, and the way about the target."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from ffpose._internal.figures import embedded, new_figure, style_axes
from ffpose._internal.files import atomic_write, write_text
from ffpose.errors import DataError
from ffpose.geometry import Camera, FloatArray, Pose
from ffpose.geometry.rotations import rotation_vector
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.imaging.images import read_rgb
from ffpose.imaging.overlay import draw_axes
from ffpose.tracking.errors import NEES_BOUNDS, NIS_BOUNDS, TrackErrors, track_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ffpose.tracking.follow import Followed

COLORS = ("#d64545", "#2f9e44", "#3b6fd4")
GROUPS = (
    ("position", "m", 0),
    ("velocity", "m/s", 3),
    ("attitude", "deg", 6),
    ("angular velocity", "deg/s", 9),
)
OVERLAY_WIDTH = 480
MOST_PICTURES = 300
"""The most frames of an overlay, which are in memory together, half a megabyte each."""

MARKS = {"switched": "#d64545", "gated": "#ffb000", "flagged": "#8a8f98", "coasted": "#8a8f98"}
"""Border of the frames that did not correct the track, by outcome."""


def write_report(
    followed: Sequence[Followed], path: Path, title: str, symmetry: SymmetryGroup = IDENTITY
) -> None:
    """Write a track as one self-contained HTML page; ``symmetry`` is as of `track_errors`."""
    measured = track_errors(followed, symmetry)
    known = bool(np.isfinite(measured.nees).any())
    figures = [
        (_over_time(followed, measured, known), "position, velocity, attitude and rate over time"),
        (_consistency(measured), "normalized squared errors against their bounds"),
        (_about_target(followed, measured), "the camera's way in the frame of the target"),
    ]
    rows: dict[str, float] = {**Counter(each.step.outcome for each in followed)}
    if known:
        rows |= measured.summary()
    table = "".join(
        f"<tr><th>{html.escape(name.replace('_', ' '))}</th><td>{_shown(value)}</td></tr>"
        for name, value in rows.items()
    )
    pictures = "\n".join(
        f"<p>{embedded(figure, text, format='png', dpi=110)}</p>" for figure, text in figures
    )
    what = "Errors, true minus estimated" if known else "Estimates, as there are no true poses"
    page = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}}
img{{max-width:100%}}th{{text-align:left;font-weight:400;padding-right:2rem}}
td{{text-align:right;font-variant-numeric:tabular-nums}}</style></head>
<body><h1>{html.escape(title)}</h1>
<p>{what}, inside their ±3σ. Velocity is along the camera's axes; attitude errors and angular
velocity are about the object's.</p>
<table>{table}</table>
{pictures}
</body></html>
"""
    write_text(path, page)


def write_overlay(
    followed: Sequence[Followed],
    camera: Camera,
    path: Path,
    white: float | str | None = None,
    axis_m: float | None = None,
) -> None:
    """Write the frames with the track's axes as an animation (WebP).

    Of more than `MOST_PICTURES` frames it shows every second, or every third, and so on. Frames
    that did not correct the track have a colored border. Files that cannot be read, with ``white``
    as of `read_rgb`, are left out; ``axis_m`` is as of `draw_axes`.
    """
    shown = followed[:: math.ceil(len(followed) / MOST_PICTURES) or 1]
    pictures = _pictures(shown, camera, white, axis_m)
    first = next(pictures, None)
    if first is None:
        return
    times = np.array([each.frame.time for each in shown])
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    with atomic_write(path) as temporary:
        first.save(
            temporary,
            "WEBP",
            save_all=True,
            append_images=list(pictures),
            duration=max(20, round(1000 * min(step, 0.25))),
            loop=0,
            quality=60,
            method=2,
        )


def _pictures(
    followed: Sequence[Followed], camera: Camera, white: float | str | None, axis_m: float | None
) -> Iterator[Image.Image]:
    for each in followed:
        try:
            image = read_rgb(each.frame.image, white)
        except (OSError, DataError):
            continue
        height = round(camera.height * OVERLAY_WIDTH / camera.width)
        image = image.resize((OVERLAY_WIDTH, height), Image.Resampling.BILINEAR)
        if each.step.estimate is not None:
            image = draw_axes(image, each.step.estimate.pose, camera, axis_m)
            mark = None if each.step.accepted else MARKS.get(each.step.outcome)
            if mark:
                box = (0, 0, image.width - 1, image.height - 1)
                ImageDraw.Draw(image).rectangle(box, outline=mark, width=4)
        yield image


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.4g}"


def _values(followed: Sequence[Followed]) -> FloatArray:
    """Return position, velocity, attitude's rotation vector and rate ``(N, 12)`` of the track."""
    values = np.full((len(followed), 12), np.nan)
    for row, each in enumerate(followed):
        one = each.step.estimate
        if one is not None:
            values[row] = np.concatenate([one.t, one.v, np.degrees(rotation_vector(one.q)), one.w])
    return values


def _over_time(followed: Sequence[Followed], measured: TrackErrors, known: bool) -> Figure:
    values = measured.errors if known else _values(followed)
    figure = new_figure(9, 9)
    for axes, (name, unit, start) in zip(figure.subplots(4, 1, sharex=True), GROUPS, strict=True):
        for axis, color in enumerate(COLORS):
            line = values[:, start + axis]
            band = 3 * measured.deviations[:, start + axis]
            middle = np.zeros_like(line) if known else line
            axes.fill_between(
                measured.times, middle - band, middle + band, color=color, alpha=0.12, linewidth=0
            )
            axes.plot(measured.times, line, color=color, linewidth=1, label="xyz"[axis])
        axes.set_ylabel(f"{name}, {unit}")
        style_axes(axes)
    figure.axes[0].legend(loc="upper right", ncols=3, frameon=False)
    figure.axes[-1].set_xlabel("time, s")
    return figure


def _consistency(measured: TrackErrors) -> Figure:
    figure = new_figure(9, 3.5)
    for axes, name, values, bounds in zip(
        figure.subplots(1, 2),
        ("NEES, 12 degrees of freedom", "NIS, 6 degrees of freedom"),
        (measured.nees, measured.nis),
        (NEES_BOUNDS, NIS_BOUNDS),
        strict=True,
    ):
        axes.axhspan(*bounds, color="#3b6fd4", alpha=0.12, linewidth=0)
        axes.plot(measured.times, values, ".", color="#1f2a44", markersize=3)
        axes.set(yscale="log", ylim=(0.1, 1000), xlabel="time, s")
        axes.set_title(name, fontsize=10)
        style_axes(axes)
    return figure


def _about_target(followed: Sequence[Followed], measured: TrackErrors) -> Figure:
    """Draw where the camera was in the target's frame: tracked, and true where that is known."""
    figure = new_figure(9, 4.2)
    tracked = [each.step.estimate.pose for each in followed if each.step.estimate is not None]
    known = zip(followed, measured.q, strict=True)
    true = [
        Pose(each.frame.pose.t, q) for each, q in known if each.frame.pose and np.isfinite(q[0])
    ]
    for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
        for poses, color, label in ((true, "#8a8f98", "true"), (tracked, "#d64545", "tracked")):
            if poses:
                way = np.array([pose.camera_center for pose in poses])
                axes.plot(way[:, across], way[:, up], color=color, linewidth=1.2, label=label)
        axes.plot([0], [0], "+", color="#1f2a44")
        axes.set(xlabel=f"{'xyz'[across]}, m", ylabel=f"{'xyz'[up]}, m")
        axes.set_aspect("equal", "datalim")
        style_axes(axes)
    if figure.axes[0].get_legend_handles_labels()[0]:
        figure.axes[0].legend(frameon=False)
    return figure
