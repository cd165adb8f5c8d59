"""Ground truth for every pixel of a rendered image: mask, depth, keypoints, coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write, write_csv
from ffpose.errors import expect
from ffpose.geometry import Camera, Pose
from ffpose.render.renderer import camera_of, label, prepared
from ffpose.render.scene import Scene
from ffpose.render.scene_file import find_scene
from ffpose.render.shading.rays import View, cast_rays, find_window
from ffpose.render.shading.vectors import Floats, dot
from ffpose.render.spacecraft.craft import Craft

LABELS = {
    "mask": "mask.png",
    "depth": "depth.png",
    "keypoints": "keypoints.csv",
    "coordinates": "coordinates.png",
}
"""Layers that can be written, each with the part of its file name after `N_`."""

LAYERS = ("mask", "depth", "keypoints")
"""Layers that ``ffpose render --layers`` writes."""

TOUCH_M = 0.02
"""Occlusion tolerance: a surface less than this in front of a keypoint does not hide it."""

DEPTH_CODES = 65535
"""Largest code of a depth file, of 16 bits."""


class Keypoint(NamedTuple):
    """A named point of the spacecraft in one image.

    Attributes:
        name: Name of the point.
        u: Pixel coordinate to the right; NaN behind the camera.
        v: Pixel coordinate downward; NaN behind the camera.
        depth: z in the camera frame, meters.
        visible: Whether the point is in the frame and not hidden by the spacecraft.
    """

    name: str
    u: float
    v: float
    depth: float
    visible: bool


class Layers(NamedTuple):
    """Ground truth for each pixel, sampled at the pixel's center.

    Attributes:
        mask: (H, W) bool, True on the spacecraft.
        depth: (H, W) float32, z in the camera frame in meters; 0 off the spacecraft.
        keypoints: Named points of the spacecraft.
        coordinates: (H, W, 4) uint8, object coordinates (`object_coordinates`).
    """

    mask: NDArray[np.bool_]
    depth: Floats
    keypoints: list[Keypoint]
    coordinates: NDArray[np.uint8]


def render_layers(
    scene: Scene | str | Path, seed: int, index: int, size: tuple[int, int] | None = None
) -> Layers:
    """Compute the ground truth of the image that `render` makes of the same arguments.

    Returns:
        Silhouette, depth in meters, keypoints and object coordinates, of the image's size.

    Raises:
        ValueError: An argument is invalid, as for `render`.
    """
    scene = find_scene(scene)
    camera, pose, craft = camera_of(scene, size), label(scene, seed, index), scene.build()
    depth = np.zeros((camera.height, camera.width), dtype=np.float32)
    seen = _traced(craft, pose, camera)
    if seen is not None:
        pixels, view = seen
        depth[pixels] = dot(pose.rotation[2], view.rays) * view.hits.distance
    coordinates = _coordinates(seen, craft, camera)
    return Layers(depth > 0, depth, _keypoints(craft, pose, camera), coordinates)


def object_coordinates(craft: Craft, pose: Pose, camera: Camera) -> NDArray[np.uint8]:
    """Encode the point of the spacecraft that each pixel sees as a color image.

    A target for dense supervision, as in Wang et al., "Normalized Object Coordinate Space" (CVPR
    2019), with a cube that is centered on the object's origin.

    Args:
        craft: The spacecraft.
        pose: Pose of the spacecraft in the camera frame; any pose.
        camera: Camera whose pixels' centers are sampled; any camera.

    Returns:
        (H, W, 4) uint8. On the spacecraft red, green and blue are x, y and z of the surface in the
        object frame, −L…+L meters mapped to 0…255 and rounded, L being `coordinates_limit`, and
        alpha is 255; elsewhere all four are 0. So the meters are ``(2 · code / 255 − 1) · L``,
        within L / 255.
    """
    return _coordinates(_traced(craft, pose, camera), craft, camera)


def coordinates_limit(craft: Craft) -> float:
    """Return L of `object_coordinates`: the largest vertex coordinate, rounded up to 0.1 m."""
    largest = float(np.abs(craft.mesh.vertices).max())
    return math.ceil(round(10 * largest, 6)) / 10  # 10 · 1.1 is more than 11


def depth_step(scene: Scene) -> float:
    """Return the meters of one code of a depth file, so that 16 bits hold the set's largest depth.

    The least power of ten that suffices: 0.001 where the spacecraft stays within 65.535 m.
    """
    reach = np.linalg.norm(scene.build().corners, axis=1).max()  # of the origin, wherever that is
    largest = scene.distance_m[1] + float(reach)
    return 10.0 ** math.ceil(math.log10(largest / DEPTH_CODES))


def check_labels(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the names once each, in the order of `LABELS`; a ValueError for another name."""
    for name in labels:
        expect(name in LABELS, "labels", f"some of {', '.join(LABELS)}", name)
    return tuple(name for name in LABELS if name in labels)


def label_files(index: int, labels: Sequence[str]) -> list[str]:
    """Return the file names of these layers of image `index`."""
    return [f"{index}_{LABELS[name]}" for name in labels]


def write_layers(
    folder: Path, index: int, layers: Layers, labels: Sequence[str], depth_step_m: float
) -> None:
    """Write the layers of image `index` that `labels` names.

    ``N_mask.png`` is 255 on the spacecraft and 0 elsewhere; ``N_depth.png`` holds the depth in
    steps of `depth_step_m` meters in 16 bits, 0 off the spacecraft; ``N_keypoints.csv`` has a row
    for each named point; ``N_coordinates.png`` is what `object_coordinates` gives. Its alpha holds
    the mask: any color, black too, may be a place on the spacecraft.
    """
    from PIL import Image

    pictures: dict[str, NDArray[Any]] = {
        "mask": layers.mask.astype(np.uint8) * 255,
        "coordinates": layers.coordinates,
    }
    if "depth" in labels:
        pictures["depth"] = np.round(layers.depth / depth_step_m).astype(np.uint16)
    for name, file in zip(labels, label_files(index, labels), strict=True):
        if name == "keypoints":
            rows = [(p.name, p.u, p.v, p.depth, int(p.visible)) for p in layers.keypoints]
            write_csv(folder / file, [Keypoint._fields, *rows], durable=False)
        else:
            with atomic_write(folder / file, durable=False) as path:
                Image.fromarray(pictures[name]).save(path)


Traced = tuple[tuple[NDArray[np.intp], NDArray[np.intp]], View]
"""Rows and columns of the pixels whose centers see the spacecraft, and what they see."""


def _traced(craft: Craft, pose: Pose, camera: Camera) -> Traced | None:
    """Trace a ray through each pixel's center; None if the spacecraft is out of frame."""
    window = find_window(craft.corners, pose, camera)
    if window is None:
        return None
    view = cast_rays(prepared(craft)[0], window, camera, pose, 1)
    row, column = np.divmod(view.hits.ray, window.shape[1])
    return (window.top + row, window.left + column), view


def _coordinates(seen: Traced | None, craft: Craft, camera: Camera) -> NDArray[np.uint8]:
    coordinates = np.zeros((camera.height, camera.width, 4), dtype=np.uint8)
    if seen is not None:
        pixels, view = seen
        scaled = view.place.T / np.float32(2 * coordinates_limit(craft)) + np.float32(0.5)
        coordinates[..., :3][pixels] = np.round(scaled * 255)
        coordinates[..., 3][pixels] = 255
    return coordinates


def _keypoints(craft: Craft, pose: Pose, camera: Camera) -> list[Keypoint]:
    if not craft.keypoints:
        return []
    points = np.array(list(craft.keypoints.values()))
    seen = pose.transform(points)
    pixels = camera.project(seen)
    eye = pose.camera_center
    toward = points - eye
    distance = np.linalg.norm(toward, axis=1)
    rays = (toward / distance[:, None]).astype(np.float32)
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
