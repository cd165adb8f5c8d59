"""The exact layers beside an image: mask, depth and keypoints, at the pixels' centres."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.files import atomic_write
from ffpose.geometry import Camera, Pose
from ffpose.render.craft import Craft
from ffpose.render.renderer import camera_of, label, prepared
from ffpose.render.scene import Scene, get_scene
from ffpose.render.vectors import Floats, dot
from ffpose.render.view import find_window, look

TOUCH_M = 0.02
"""A keypoint counts as seen if nothing lies more than this before it."""


DEPTH_LIMIT_M = 65.535


class Keypoint(NamedTuple):
    """A named point of the spacecraft in one image.

    Attributes:
        name: which point.
        u: pixel coordinate to the right; NaN behind the camera.
        v: pixel coordinate downwards; NaN behind the camera.
        depth: z in the camera frame, metres.
        visible: in the frame, and not hidden by the spacecraft.
    """

    name: str
    u: float
    v: float
    depth: float
    visible: bool


class Layers(NamedTuple):
    """Truth for each pixel, taken at its centre.

    Attributes:
        mask: (H, W) bool, True on the spacecraft.
        depth: (H, W) float32, z in the camera frame in metres; 0 off the spacecraft.
        keypoints: the spacecraft's named points.
    """

    mask: NDArray[np.bool_]
    depth: Floats
    keypoints: list[Keypoint]


def render_layers(
    scene: Scene | str, seed: int, index: int, size: tuple[int, int] | None = None
) -> Layers:
    """Mask, depth and keypoints of the image that `render` makes of the same arguments.

    Raises:
        ValueError: as for `render`.
    """
    scene = get_scene(scene) if isinstance(scene, str) else scene
    camera, pose, craft = camera_of(scene, size), label(scene, seed, index), scene.build()
    depth = _depth(craft, pose, camera)
    return Layers(depth > 0, depth, _keypoints(craft, pose, camera))


def layer_names(index: int) -> list[str]:
    """The files of image `index`'s mask, depth and keypoints."""
    return [f"{index}_mask.png", f"{index}_depth.png", f"{index}_keypoints.csv"]


def write_layers(folder: Path, index: int, layers: Layers) -> None:
    """Write the layers of image `index`.

    ``N_mask.png`` is 255 on the spacecraft and 0 elsewhere; ``N_depth.png`` holds millimetres in 16
    bits, 0 off the spacecraft; ``N_keypoints.csv`` has a row for each named point.

    Raises:
        ValueError: a depth is beyond the 65.535 m of 16 bits.
    """
    from PIL import Image

    if layers.depth.max() > DEPTH_LIMIT_M:
        raise ValueError(
            f"depth of image {index}: expected at most {DEPTH_LIMIT_M} m, got {layers.depth.max()}"
        )
    mask, depth, keypoints = (folder / name for name in layer_names(index))
    with atomic_write(mask) as path:
        Image.fromarray(layers.mask.astype(np.uint8) * 255).save(path)
    with atomic_write(depth) as path:
        Image.fromarray(np.round(layers.depth * 1000).astype(np.uint16)).save(path)
    with atomic_write(keypoints) as path, path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["name", "u", "v", "depth", "visible"])
        writer.writerows((p.name, p.u, p.v, p.depth, int(p.visible)) for p in layers.keypoints)


def _depth(craft: Craft, pose: Pose, camera: Camera) -> Floats:
    depth = np.zeros((camera.height, camera.width), dtype=np.float32)
    window = find_window(craft.mesh.vertices, pose, camera)
    if window is None:
        return depth
    view = look(prepared(craft)[0], window, camera, pose, 1)
    inside = np.zeros(window.shape, dtype=np.float32)
    inside.reshape(-1)[view.hits.ray] = dot(pose.rotation[2], view.rays) * view.hits.distance
    depth[window.top : window.bottom, window.left : window.right] = inside
    return depth


def _keypoints(craft: Craft, pose: Pose, camera: Camera) -> list[Keypoint]:
    if not craft.keypoints:
        return []
    points = np.array(list(craft.keypoints.values()))
    seen = pose.transform(points)
    pixels = camera.project(seen)
    eye = -pose.rotation.T @ pose.t
    towards = points - eye
    distance = np.linalg.norm(towards, axis=1)
    rays = (towards / distance[:, None]).astype(np.float32)
    hits = prepared(craft)[0].first_hits(eye.astype(np.float32), rays)
    nearest = np.full(len(points), np.inf)
    nearest[hits.ray] = hits.distance
    free = (nearest > distance - TOUCH_M) & (seen[:, 2] > 0)
    inside = ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(axis=1)
    return [
        Keypoint(name, float(u), float(v), float(z), bool(shown))
        for name, (u, v), z, shown in zip(
            craft.keypoints, pixels, seen[:, 2], free & inside, strict=True
        )
    ]
