"""Views for training, rendered as such: the small frame and the window, not the whole image.

A network with a second look reads two pieces of an image (`ffpose.views`). Rendering the image to
cut them out of it spends most of the time on pixels that are averaged away. Here each piece is
rendered at its own resolution: the same scene, light and exposure, and a sensor whose blur and
noise are those of the pixels' means. It takes a tenth of the time of a 1280 x 960 image.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import get_args

import numpy as np

from ffpose.render.decoys import build_decoy
from ffpose.render.layers import object_coordinates
from ffpose.render.renderer import prepared, shoot
from ffpose.render.scene import Scene
from ffpose.render.sensor import Sensor
from ffpose.views import WINDOW, Content, Pieces, ViewSpec, in_frame

CHUNK = 8
"""Views that a process renders before it reports."""


def render_view(
    scene: Scene, seed: int, index: int, spec: ViewSpec, content: Content = "object"
) -> Pieces:
    """Render the pieces of one image that a network with a second look reads.

    Args:
        scene: a set.
        seed: seed of the whole set.
        index: number of the image in the set.
        spec: how the network looks.
        content: "object": the set's spacecraft; "empty": none, and the window is where it would be;
            "decoy": another one in its place (`ffpose.render.decoys`).

    Raises:
        ValueError: an unknown content.
    """
    if content not in get_args(Content):
        raise ValueError(f"content: expected one of {get_args(Content)}, got {content!r}")
    if content == "decoy":
        scene = replace(scene, craft=build_decoy(seed, index))
    empty = content == "empty"
    height, width = spec.frame_size
    small = spec.camera.resized(width, height)
    frame = shoot(
        scene, seed, index, small, averaging(scene.sensor, spec.first_stride), empty=empty
    )
    level = spec.level(frame.pose.t)
    camera = spec.window_camera(frame.pose.t, level)
    whole = spec.level_camera(level)
    sensor = in_window(averaging(scene.sensor, 2**level), whole.width)
    window = shoot(scene, seed, index, camera, sensor, gain=frame.gain, empty=empty).image
    coordinates = np.zeros((WINDOW // 2, WINDOW // 2, 4), np.uint8)
    if content == "object":
        half = camera.resized(WINDOW // 2, WINDOW // 2)
        coordinates = object_coordinates(scene.build(), frame.pose, half)
    inside = in_frame(camera, whole)
    window = window * inside[..., None]
    coordinates = coordinates * (inside[::2, ::2] & inside[1::2, 1::2])[..., None]
    return Pieces(frame.image, window, coordinates, frame.pose, camera, level, content == "object")


def averaging(sensor: Sensor, side: int) -> Sensor:
    """The sensor whose pixels are means of ``side`` x ``side`` of this one's."""
    return replace(
        sensor, full_well=sensor.full_well * side**2, read_noise=sensor.read_noise * side
    )


def in_window(sensor: Sensor, width: int) -> Sensor:
    """The sensor for a window of an image ``width`` pixels wide, whose corners are not dark.

    A sensor counts blur and motion in parts of the picture's width, and the window is a part of it.
    """
    scale = width / WINDOW
    return replace(
        sensor, blur_px=sensor.blur_px * scale, motion_px=sensor.motion_px * scale, vignette=0.0
    )


def describe(scene: Scene, seed: int, spec: ViewSpec, content: Content) -> dict[str, object]:
    """All that views depend on, but for their indices, as plain values."""
    return {"scene": scene.parameters(), "seed": seed, "spec": asdict(spec), "content": content}


def render_views(
    scene: Scene, seed: int, indices: range, spec: ViewSpec, content: Content, workers: int
) -> Iterator[Pieces]:
    """Render views in order, by as many processes as are asked for."""
    make = partial(_render_one, scene, seed, spec, content)
    if workers <= 1 or len(indices) < 2 * CHUNK:
        yield from map(make, indices)
        return
    prepared(scene.build())  # forked workers share the search tree
    context = multiprocessing.get_context("fork" if os.name == "posix" else "spawn")
    with context.Pool(min(workers, len(indices))) as pool:
        yield from pool.imap(make, indices, CHUNK)


def _render_one(scene: Scene, seed: int, spec: ViewSpec, content: Content, index: int) -> Pieces:
    return render_view(scene, seed, index, spec, content)
