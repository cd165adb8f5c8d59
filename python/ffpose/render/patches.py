"""Rendering training patches, which would be cut out of the whole image.

A network with a second look reads two of an image (`ffpose.imaging.patches`). A window of the
finest pyramid level is cut out of the whole image, bit for bit. Of the coarser windows and of the
frame, which average at least two pixels each way, the pixels are averaged anyway: they are cut out
of the whole image rendered at half its resolution, in a third of the time. Sun, stars, glare,
vignette, exposure and the noise of averaged pixels are those of the whole image there too; what
differs is what a pixel of twice the width does to edges and highlights.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import get_args

from ffpose._internal.machine import worker_processes
from ffpose.geometry import Camera, Pose
from ffpose.imaging.patches import Bytes, Content, Patches, PatchSpec, extract_patches, in_frame
from ffpose.render.layers import object_coordinates
from ffpose.render.renderer import label, prepared, shoot
from ffpose.render.scene import Scene
from ffpose.render.spacecraft.decoys import build_decoy

CHUNK = 8
"""Images per task of a worker process."""

RENDERING = 2
"""Version of how patches are rendered; those that were rendered otherwise are rendered again."""


def render_patches(
    scene: Scene, seed: int, index: int, spec: PatchSpec, content: Content = "object"
) -> Patches:
    """Render the patches of one image that a network with a second look reads.

    Args:
        scene: A set.
        seed: Seed of the whole set.
        index: Number of the image in the set.
        spec: Geometry of the two patches.
        content: "object": the set's spacecraft; "empty": no spacecraft, the window where it would
            be; "decoy": another spacecraft in its place (`ffpose.render.spacecraft.decoys`).

    Raises:
        ValueError: `content` is none of these.
    """
    if content not in get_args(Content):
        raise ValueError(f"content: expected one of {get_args(Content)}, got {content!r}")
    if content == "decoy":
        scene = scene.with_stranger(build_decoy(seed, index))
    empty = content == "empty"
    pose = label(scene, seed, index)
    level = spec.level(pose.t)
    halved = int(level > 0 and spec.first_stride % 2 == 0)
    camera = spec.level_camera(halved)
    shot = shoot(scene, seed, index, camera, scene.sensor, empty=empty, side=2**halved)

    def coordinates(pose: Pose, half: Camera) -> Bytes:
        window = spec.window_camera(pose.t, level)
        inside = in_frame(window, spec.level_camera(level))
        seen = object_coordinates(scene.build(), pose, half)
        return seen * (inside[::2, ::2] & inside[1::2, 1::2])[..., None]

    known = coordinates if content == "object" else None
    pieces = extract_patches(shot.image, pose, spec, known, halved)
    return pieces._replace(present=content == "object")


def describe(scene: Scene, seed: int, spec: PatchSpec, content: Content) -> dict[str, object]:
    """Return all parameters that patches depend on, except their indices, as plain values."""
    return {
        "rendering": RENDERING,
        "scene": scene.parameters(),
        "seed": seed,
        "spec": asdict(spec),
        "content": content,
    }


def render_all_patches(
    scene: Scene, seed: int, indices: range, spec: PatchSpec, content: Content, workers: int
) -> Iterator[Patches]:
    """Render the patches of images in order with several processes."""
    make = partial(_render_one, scene, seed, spec, content)
    if workers <= 1 or len(indices) < 2 * CHUNK:
        yield from map(make, indices)
        return
    prepared(scene.build())  # forked workers share the BVH
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    processes = worker_processes(workers, len(indices))
    with context.Pool(processes, _start_worker, (make,)) as pool:
        yield from pool.imap(_render_next, indices, CHUNK)


def _render_one(scene: Scene, seed: int, spec: PatchSpec, content: Content, index: int) -> Patches:
    return render_patches(scene, seed, index, spec, content)


_worker_make: list[Callable[[int], Patches]] = []
"""What this worker process renders by; sent once, because a spacecraft may be a large mesh."""


def _start_worker(make: Callable[[int], Patches]) -> None:
    _worker_make[:] = [make]


def _render_next(index: int) -> Patches:
    return _worker_make[0](index)
