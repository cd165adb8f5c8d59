"""Rendering one image, as a pure function of the scene, the seed, the index and the size."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, default_rng  # not later: a fork during it would hang
from numpy.typing import NDArray

from ffpose.arrays import shade_earth
from ffpose.errors import expect
from ffpose.geometry import Camera, Pose
from ffpose.render import mitsuba
from ffpose.render.sampler import (
    Surroundings,
    horizon_cosine,
    sample_pose,
    sample_surroundings,
)
from ffpose.render.scene import Scene
from ffpose.render.scene_file import find_scene
from ffpose.render.shading.alpha_test import AlphaTest
from ffpose.render.shading.randomization import backdrop, stops
from ffpose.render.shading.rays import View, Window, cast_rays, find_window, pixel_rays, smoothed
from ffpose.render.shading.reflection import (
    Light,
    MaterialTable,
    earth_visible,
    reflected,
    sun_visible,
)
from ffpose.render.shading.sensor import Sensor, choose_gain, expose
from ffpose.render.shading.sky import draw_stars, sun_disk
from ffpose.render.shading.tracer import Tracer
from ffpose.render.shading.vectors import Floats
from ffpose.render.spacecraft.craft import Craft

MIN_SIDE, MAX_SIDE = 16, 8192
BLOCK = 8192
"""Background pixels per block: small enough that the temporaries stay in the CPU's cache."""

BAND = 1 << 16
"""Spacecraft samples per block: small enough that the temporaries stay in the CPU's cache."""

NO_LIGHT: Floats = np.zeros((3, 0), dtype=np.float32)
"""Radiance of no samples."""

SAMPLES = ((0.02, 4), (0.06, 3), (1.0, 2))
"""Samples along each side of a pixel, by the fraction of the frame that the spacecraft fills."""


class Frame(NamedTuple):
    """One rendered image and its label.

    Attributes:
        image: (H, W, 3) uint8, RGB.
        pose: The spacecraft's exact pose.
        camera: The camera that took the image.
    """

    image: NDArray[np.uint8]
    pose: Pose
    camera: Camera


def render(
    scene: Scene | str | Path, seed: int, index: int, size: tuple[int, int] | None = None
) -> Frame:
    """Render one image; the same arguments give the same bytes.

    Args:
        scene: A set, the name of one (`ffpose.render.SCENES`), or the path of one's file (.json).
        seed: Seed of the whole set, at least 0.
        index: Number of the image in the set, at least 0.
        size: (width, height) in pixels; default is that of the scene's camera.

    Returns:
        The image ``(H, W, 3)``, uint8, with its pose and camera.

    Raises:
        ValueError: `scene` is not in `SCENES`, `seed` or `index` is negative, or a side of `size`
            is not within `MIN_SIDE`…`MAX_SIDE`.
        FileNotFoundError: There is no file of that path, or its mesh is gone.
        DataError: The file of the scene, or its mesh, cannot be used.
    """
    scene = find_scene(scene)
    return shoot(scene, seed, index, camera_of(scene, size))


def render_empty(
    scene: Scene | str | Path, seed: int, index: int, size: tuple[int, int] | None = None
) -> NDArray[np.uint8]:
    """Render the image that `render` makes of the same arguments, without the spacecraft.

    Earth, stars, sun and sensor noise come from the same random generators; the exposure is chosen
    from the background alone. Such images are negatives for detecting whether the spacecraft is
    present.

    Returns:
        (H, W, 3) uint8, RGB.

    Raises:
        ValueError: An argument is invalid, as for `render`.
    """
    scene = find_scene(scene)
    return shoot(scene, seed, index, camera_of(scene, size), empty=True).image


def shoot(
    scene: Scene, seed: int, index: int, camera: Camera, *, empty: bool = False, side: int = 1
) -> Frame:
    """Render scene `index` with any camera at the position of the scene's own.

    Pose and lights are those of the scene's own camera. There are `side` pixels of a finer image
    along each side of one of this, 1 or 2: sun, stars, glare, noise and exposure are then those of
    that image, averaged. With `empty` the spacecraft is left out.
    """
    return shoot_each(scene, seed, index, camera, (scene.sensor,), empty=empty, side=side)[0]


def shoot_each(
    scene: Scene,
    seed: int,
    index: int,
    camera: Camera,
    sensors: Sequence[Sensor],
    *,
    empty: bool = False,
    side: int = 1,
) -> list[Frame]:
    """Render with each of several sensors; each image equals that of a scene with that sensor.

    The radiance, which takes nearly all of the time, is computed once.
    """
    pose_rng, light_rng, star_rng, sensor_rng, surface_rng, odd_rng = _streams(seed, index)
    pose = sample_pose(scene, pose_rng)
    around = sample_surroundings(scene, light_rng)
    radiance = background(scene, camera, around, star_rng, odd_rng, side)
    lit = NO_LIGHT
    if not empty:
        subject = subject_of(scene, pose, around, odd_rng, surface_rng)
        if scene.renderer == "mitsuba":
            craft, _, light, rng = subject
            lit = mitsuba.draw_craft(radiance, camera, pose, craft, light, rng)
        else:
            lit = draw_craft(radiance, camera, pose, subject)
    frames = []
    for sensor in sensors:
        rng = copy.deepcopy(sensor_rng)
        spread = math.hypot(sensor.exposure_spread, scene.randomization.exposure)
        gain = choose_gain(radiance, lit, spread, rng, side)
        frames.append(Frame(expose(radiance, gain, sensor, rng, side), pose, camera))
    return frames


def label(scene: Scene | str | Path, seed: int, index: int) -> Pose:
    """Return the pose of image `index` without rendering it; arguments and errors as `render`."""
    scene = find_scene(scene)
    return sample_pose(scene, _streams(seed, index)[0])


class Situation(NamedTuple):
    """The arrangement of one image: pose, sun and Earth.

    Attributes:
        pose: Pose of the spacecraft, as in `Frame`.
        around: Directions and state of sun and Earth.
        backdrop: Whether colored clouds replace stars and Earth.
    """

    pose: Pose
    around: Surroundings
    backdrop: bool


def situation(scene: Scene | str | Path, seed: int, index: int) -> Situation:
    """Return the arrangement of image `index` without rendering it."""
    scene = find_scene(scene)
    pose_rng, light_rng, _, _, _, odd_rng = _streams(seed, index)
    pose = sample_pose(scene, pose_rng)
    around = sample_surroundings(scene, light_rng)
    return Situation(pose, around, bool(odd_rng.random() < scene.randomization.background))


def camera_of(scene: Scene, size: tuple[int, int] | None) -> Camera:
    """Return the scene's camera at `size` (width, height), each within `MIN_SIDE`…`MAX_SIDE`."""
    if size is None:
        size = (scene.camera.width, scene.camera.height)
    fits = len(size) == 2 and all(MIN_SIDE <= side <= MAX_SIDE for side in size)
    expect(fits, "size", f"width and height within {MIN_SIDE}…{MAX_SIDE}", size)
    return scene.camera.resized(*size)


@lru_cache(maxsize=4)
def prepared(craft: Craft) -> tuple[Tracer, MaterialTable]:
    """Return ray tracer and material tables of a spacecraft, built once for each."""
    materials = MaterialTable(craft)
    return Tracer(craft.mesh, AlphaTest(craft, materials.maps)), materials


def _streams(seed: int, index: int) -> list[Generator]:
    """Seed independent generators for pose, light, stars, sensor, surface and randomization."""
    expect(min(seed, index) >= 0, "seed and index", "at least 0", (seed, index))
    return default_rng([seed, index]).spawn(6)


def background(
    scene: Scene,
    camera: Camera,
    around: Surroundings,
    star_rng: Generator,
    odd_rng: Generator,
    side: int,
    turn: NDArray[np.float64] | None = None,
) -> Floats:
    """Compute the radiance (H, W, 3) behind the spacecraft; `turn` as for `draw_stars`."""
    if odd_rng.random() < scene.randomization.background:
        clouds = backdrop(pixel_rays(camera), odd_rng)
        return np.ascontiguousarray(clouds.T).reshape(camera.height, camera.width, 3)
    radiance = draw_stars(camera, star_rng, side, turn)
    _draw_background(radiance, camera, around, side)
    return radiance


def _draw_background(radiance: Floats, camera: Camera, around: Surroundings, side: int) -> None:
    """Composite sun, Earth and atmosphere over the stars in `radiance` (H, W, 3)."""
    rays = pixel_rays(camera)
    pixel_angle = 1.0 / camera.fx
    octaves = int(np.clip(round(math.log2(camera.fx)), 5, 9))
    above = around.nadir.tolist(), around.altitude, around.sun.tolist(), around.ground.tolist()
    flat = radiance.reshape(-1, 3)
    for start in range(0, len(flat), BLOCK):
        pixels, through = flat[start : start + BLOCK], rays[:, start : start + BLOCK]
        disk = sun_disk(around.sun, through, pixel_angle, side)
        if disk.any():
            pixels += disk[:, None]
        glow, behind = shade_earth(through, *above, octaves, pixel_angle)
        if (behind < 1).any():
            pixels *= behind[:, None]
        if glow.any():
            pixels += glow.T


class Subject(NamedTuple):
    """A spacecraft, with what its look depends on but for the pose."""

    craft: Craft
    materials: MaterialTable
    light: Light
    rng: Generator


def subject_of(
    scene: Scene, pose: Pose, around: Surroundings, odd_rng: Generator, surface_rng: Generator
) -> Subject:
    """Return a scene's spacecraft, its materials and lights varied as the randomization says."""
    craft, spread = scene.build(), scene.randomization.materials
    materials = prepared(craft)[1]
    if spread > 0:
        materials = materials.varied(spread, odd_rng)
    return Subject(craft, materials, object_light(pose, around, scene, odd_rng), surface_rng)


def draw_craft(radiance: Floats, camera: Camera, pose: Pose, subject: Subject) -> Floats:
    """Composite the spacecraft over `radiance` and return the radiance (3, H) of its samples."""
    window = find_window(subject.craft.corners, pose, camera)
    return draw_window(radiance, window, camera, pose, subject) if window else NO_LIGHT


def draw_alone(craft: Craft, pose: Pose, camera: Camera, light: Light, gray: float = 0.0) -> Floats:
    """Render the radiance (H, W, 3) of a spacecraft before gray, with the same random numbers."""
    radiance = np.full((camera.height, camera.width, 3), gray, np.float32)
    subject = Subject(craft, prepared(craft)[1], light, default_rng(0))
    draw_craft(radiance, camera, pose, subject)
    return radiance


def draw_window(
    radiance: Floats, window: Window, camera: Camera, pose: Pose, subject: Subject
) -> Floats:
    """Composite what a window shows of the spacecraft, as `draw_craft`."""
    tracer, samples = prepared(subject.craft)[0], sample_count(window, camera)
    colors = []
    for band in window.bands(BAND // samples**2):
        view = cast_rays(tracer, band, camera, pose, samples)
        colors.append(_shade(view, tracer, band, samples, camera, subject))
        _composite(radiance, band, view.hits.ray, colors[-1], samples)
    return np.concatenate(colors, axis=1)


def _shade(
    view: View, tracer: Tracer, window: Window, samples: int, camera: Camera, subject: Subject
) -> Floats:
    """Compute the radiance (3, H) of the points that a view hit."""
    _, materials, light, rng = subject
    surface = materials.surface(view, view.hits.distance * np.float32(1 / camera.fx), samples)
    place = view.place
    sunlit = sun_visible(tracer, place, surface.normal, light)
    # About one sample per pixel is enough, as the mean over the pixels around is taken.
    some = slice(None, None, samples**2)
    earthlit = earth_visible(tracer, place[:, some], surface.normal[:, some], light, rng)
    earthlit = smoothed(earthlit, view.hits.ray[some], view.hits.ray, window, samples)
    return reflected(surface, view, light, sunlit, earthlit)


def sample_count(window: Window, camera: Camera) -> int:
    """Choose samples per pixel side; a distant, small spacecraft gets more at little cost."""
    share = math.prod(window.shape) / (camera.width * camera.height)
    return next(samples for most, samples in SAMPLES if share <= most)


def object_light(pose: Pose, around: Surroundings, scene: Scene, rng: Generator) -> Light:
    """Return the lights in the object frame, varied as the set's randomization says."""
    spread = scene.randomization.light
    back = pose.rotation.T
    # The lit part of the Earth's disk grows with the sun's height over the ground below.
    above = float(-around.sun @ around.nadir)
    return Light(
        sun=(back @ around.sun).astype(np.float32),
        nadir=(back @ around.nadir).astype(np.float32),
        earth=float(np.clip((above + 0.35) / 1.35, 0.0, 1.0) * stops(spread, (), rng)),
        horizon=horizon_cosine(around.altitude),
        sunlight=0.0 if around.eclipsed else 1.0,
        lamp=scene.lamp if around.eclipsed else 0.0,
        tint=stops(spread, (3, 1), rng),
    )


def _composite(
    radiance: Floats, window: Window, ray: NDArray[np.intp], color: Floats, samples: int
) -> None:
    """Average the samples of each pixel and composite them over the background."""
    rows, columns = window.shape
    layer = np.zeros((rows * columns * samples**2, 4), dtype=np.float32)
    layer[ray, :3] = color.T
    layer[ray, 3] = 1
    grid = layer.reshape(rows, samples, columns, samples, 4)
    pixels = np.zeros((rows, columns, 4), dtype=np.float32)
    for i, j in np.ndindex(samples, samples):
        pixels += grid[:, i, :, j]
    pixels *= np.float32(1 / samples**2)
    part = radiance[window.top : window.bottom, window.left : window.right]
    part *= 1 - pixels[..., 3:]
    part += pixels[..., :3]
