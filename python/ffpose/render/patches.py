"""Rendering training patches, which would be cut out of the whole image.

A network with a second look reads two of an image (`ffpose.imaging.patches`). A window of the
finest pyramid level is cut out of the whole image, bit for bit. Of the coarser windows and of the
frame, which average at least two pixels each way, the pixels are averaged anyway: they are cut out
of the whole image rendered at half its resolution, in a third of the time. Sun, stars, glare,
vignette, exposure and the noise of averaged pixels are those of the whole image there too; what
differs is what a pixel of twice the width does to edges and highlights.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import get_args

from ffpose.errors import expect
from ffpose.geometry import Camera
from ffpose.imaging.patches import Bytes, Content, Patches, PatchSpec, extract_patches, in_frame
from ffpose.render.layers import object_coordinates
from ffpose.render.processes import in_processes
from ffpose.render.renderer import label, prepared, shoot
from ffpose.render.scene import Scene
from ffpose.render.spacecraft.decoys import build_decoy

RENDERING = 3
"""Version of how patches are rendered; those that were rendered otherwise are rendered again."""


def render_patches(
    scene: Scene, seed: int, index: int, spec: PatchSpec, content: Content = "object"
) -> Patches:
    """Render the patches of one image that a network with a second look reads.

    They show as ``content`` "object", the set's spacecraft; "empty", none, the window where it
    would be; or "decoy", another in its place (`ffpose.render.spacecraft.decoys`).
    """
    expect(content in get_args(Content), "content", f"one of {get_args(Content)}", content)
    if content == "decoy":
        scene = scene.with_stranger(build_decoy(seed, index))
    empty = content == "empty"
    pose = label(scene, seed, index)
    level = spec.level(pose.t)
    halved = int(level > 0 and spec.first_stride % 2 == 0)
    camera = spec.level_camera(halved)
    shot = shoot(scene, seed, index, camera, empty=empty, side=2**halved)

    def coordinates(half: Camera) -> Bytes:
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
    make = partial(render_patches, scene, seed, spec=spec, content=content)
    if sys.platform != "linux":
        return in_processes(make, indices, workers, "spawn")
    prepared(scene.build())  # forked workers share the BVH
    return in_processes(make, indices, workers, "fork")
