"""Sets that differ from one in a single thing, which a training may have had or not.

The pictures of a variation are those of the set with the same poses, sun and Earth wherever the
variation leaves them, so that its errors can be compared picture by picture. Variations that differ
in the sensor alone are rendered together: the light is computed once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, product
from pathlib import Path

import numpy as np
from PIL import Image, ImageFilter

from ffpose import __version__
from ffpose._internal.files import atomic_write
from ffpose.imaging.images import read_rgb
from ffpose.imaging.patches import Bytes
from ffpose.render.processes import in_processes
from ffpose.render.renderer import Frame, camera_of, label, shoot_each
from ffpose.render.scene import Scene
from ffpose.render.shading.sensor import Sensor

CUT = (0.3, 0.6)
"""Least and greatest share of the spacecraft that the border leaves."""

BEYOND = 1.3
"""How many times as far as the farthest distance of training."""

BLUR_PX = 1.5
JPEG_QUALITY = 50
RANDOMIZATION = 0.5


@dataclass(frozen=True)
class Variation:
    """A set that differs from another in one thing.

    Attributes:
        name: a word or two.
        about: what differs, for a reader.
        scene: the set.
        blur_px: standard deviation of a Gaussian blur of the finished picture, in pixels of an
            image 640 wide.
        monochrome: the finished picture has no colors (ITU-R BT.601's luma).
        empty: the spacecraft is left out.
    """

    name: str
    about: str
    scene: Scene
    blur_px: float = 0.0
    monochrome: bool = False
    empty: bool = False

    @property
    def light(self) -> tuple[Scene, bool]:
        """Key of what the light before the sensor depends on; equal keys share one rendering."""
        return replace(self.scene, sensor=Sensor()), self.empty


def variations(
    scene: Scene, farthest_m: float, *, second_renderer: bool = False
) -> list[Variation]:
    """The set, and sets that differ from it in one thing.

    Training went as far as ``farthest_m``; with ``second_renderer`` one has Mitsuba's pictures.
    """
    least, most = CUT
    beyond = BEYOND * farthest_m
    lateral = scene.lateral_m * beyond / scene.distance_m[1]
    far = replace(scene, distance_m=(farthest_m, beyond), lateral_m=lateral)
    jpeg = replace(scene.sensor, jpeg_quality=JPEG_QUALITY)
    mitsuba = replace(scene, renderer="mitsuba")
    second = Variation("second renderer", "the spacecraft rendered by Mitsuba 3", mitsuba)
    return [
        Variation("as trained", "the set's own scenes", scene),
        Variation(
            "noise doubled",
            "shot noise and read noise of twice the standard deviation",
            replace(scene, sensor=noisier(scene.sensor)),
        ),
        Variation("blur", f"Gaussian, {BLUR_PX} pixels of an image 640 wide", scene, BLUR_PX),
        Variation("monochrome", "the colors' luma alone", scene, monochrome=True),
        Variation(f"JPEG {JPEG_QUALITY}", "through a JPEG file", replace(scene, sensor=jpeg)),
        Variation(
            f"randomize {RANDOMIZATION}",
            "light, exposure, materials and backgrounds that are not real",
            scene.randomized(RANDOMIZATION),
        ),
        Variation(
            "cut by the border",
            f"{100 * least:.0f} to {100 * most:.0f} % of the spacecraft in the frame",
            scene.truncated(least, most),
        ),
        Variation("beyond range", f"{farthest_m:g} to {beyond:.3g} m", far),
        *([second] if second_renderer else []),
    ]


def without_object(scene: Scene) -> list[Variation]:
    """The set without the spacecraft, and with another one in its place."""
    other = "soyuz" if scene.build().name == "dragon" else "dragon"
    return [
        Variation("empty scenes", "Earth, stars and sun alone", scene, empty=True),
        Variation("another spacecraft", f"{other} in its place", scene.with_stranger(other)),
    ]


def noisier(sensor: Sensor) -> Sensor:
    """The sensor whose noise has twice the standard deviation at every brightness.

    A quarter of the electrons doubles the shot noise, the root of their number; the read noise,
    which counts in electrons, is then halved to be twice as much of full scale.
    """
    return replace(sensor, full_well=sensor.full_well / 4, read_noise=sensor.read_noise / 2)


def render_variations(
    chosen: Sequence[Variation],
    seed: int,
    count: int,
    size: tuple[int, int],
    workers: int,
    keep: Path | None = None,
) -> Iterator[tuple[Variation, Frame]]:
    """Render `count` pictures of each variation, and yield variation and picture.

    The pictures of a variation come in order, between those of others; the variations of one
    `Variation.light` that stand together are rendered together. A folder ``keep`` has the pictures
    by the digest of what they depend on; those that lie there already are read, so that an
    interrupted run goes on where it was.
    """
    groups = [tuple(group) for _, group in groupby(chosen, key=lambda variation: variation.light)]
    items = list(product(range(len(groups)), range(count)))
    made = in_processes(partial(_render_item, groups, seed, size, keep), items, workers)
    for (group, _), frames in zip(items, made, strict=True):
        yield from zip(groups[group], frames, strict=True)


def _render_item(
    groups: Sequence[Sequence[Variation]],
    seed: int,
    size: tuple[int, int],
    keep: Path | None,
    item: tuple[int, int],
) -> list[Frame]:
    """Render a picture of variations that share the light, or read those that were kept."""
    together, number = groups[item[0]], item[1]
    scene, empty = together[0].scene, together[0].empty
    camera = camera_of(scene, size)
    kept = [keep / _folder(v, seed, size) / f"{number}.png" for v in together] if keep else []
    if kept and all(path.exists() for path in kept):
        return [
            Frame(np.asarray(read_rgb(path)), label(v.scene, seed, number), camera)
            for v, path in zip(together, kept, strict=True)
        ]
    sensors = [variation.scene.sensor for variation in together]
    shot = shoot_each(scene, seed, number, camera, sensors, empty=empty)
    frames = [
        frame._replace(image=finished(frame.image, variation))
        for variation, frame in zip(together, shot, strict=True)
    ]
    for path, frame in zip(kept, frames, strict=False):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as temporary:
            Image.fromarray(frame.image).save(temporary, "PNG")
    return frames


def _folder(variation: Variation, seed: int, size: tuple[int, int]) -> str:
    depends = [__version__, variation.scene.parameters(), variation.blur_px, variation.empty]
    depends += [seed, size, *["monochrome"] * variation.monochrome]
    digest = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()
    return f"{variation.name.replace(' ', '-')}-{digest[:16]}"


def finished(image: Bytes, variation: Variation) -> Bytes:
    """Do to a finished picture (H, W, 3) what the variation does."""
    picture = Image.fromarray(image)
    if variation.blur_px > 0:
        picture = picture.filter(ImageFilter.GaussianBlur(variation.blur_px * picture.width / 640))
    if variation.monochrome:
        picture = picture.convert("L").convert("RGB")
    return np.asarray(picture)
