"""Rendering training views directly: the small frame and the window, not the whole image.

A network with a second look reads two pieces of an image (`ffpose.views`). Rendering the image and
cutting them out would spend most of the time on pixels that are averaged away. Instead each piece
is rendered at its own resolution, with the same scene, light and exposure, and with a sensor whose
blur and noise are those of averaged pixels: a tenth of the time of a 1280 x 960 image.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import get_args

import numpy as np

from ffpose.render.layers import object_coordinates
from ffpose.render.renderer import prepared, shoot
from ffpose.render.scene import Scene
from ffpose.render.shading.sensor import Sensor
from ffpose.render.spacecraft.decoys import build_decoy
from ffpose.views import WINDOW, Content, Pieces, ViewSpec, in_frame

CHUNK = 8
"""Views per task of a worker process."""


def render_view(
    scene: Scene, seed: int, index: int, spec: ViewSpec, content: Content = "object"
) -> Pieces:
    """Render the pieces of one image that a network with a second look reads.

    Args:
        scene: A set.
        seed: Seed of the whole set.
        index: Number of the image in the set.
        spec: Geometry of the network's two views.
        content: "object": the set's spacecraft; "empty": no spacecraft, the window where it would
            be; "decoy": another spacecraft in its place (`ffpose.render.spacecraft.decoys`).

    Raises:
        ValueError: `content` is none of these.
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
    """Return the sensor whose pixels are means of ``side`` x ``side`` pixels of this one."""
    return replace(
        sensor, full_well=sensor.full_well * side**2, read_noise=sensor.read_noise * side
    )


def in_window(sensor: Sensor, width: int) -> Sensor:
    """Return the sensor for a window of an image ``width`` pixels wide, without vignetting.

    Blur and motion are relative to the image's width, of which the window covers a part.
    """
    scale = width / WINDOW
    return replace(
        sensor, blur_px=sensor.blur_px * scale, motion_px=sensor.motion_px * scale, vignette=0.0
    )


def describe(scene: Scene, seed: int, spec: ViewSpec, content: Content) -> dict[str, object]:
    """Return all parameters that views depend on, except their indices, as plain values."""
    return {"scene": scene.parameters(), "seed": seed, "spec": asdict(spec), "content": content}


def render_views(
    scene: Scene, seed: int, indices: range, spec: ViewSpec, content: Content, workers: int
) -> Iterator[Pieces]:
    """Render views in order with several processes."""
    make = partial(_render_one, scene, seed, spec, content)
    if workers <= 1 or len(indices) < 2 * CHUNK:
        yield from map(make, indices)
        return
    prepared(scene.build())  # forked workers share the BVH
    context = multiprocessing.get_context("fork" if os.name == "posix" else "spawn")
    with context.Pool(min(workers, len(indices))) as pool:
        yield from pool.imap(make, indices, CHUNK)


def _render_one(scene: Scene, seed: int, spec: ViewSpec, content: Content, index: int) -> Pieces:
    return render_view(scene, seed, index, spec, content)
