"""Rendering the frames of a motion: one sun, one Earth, exact times and poses.

A frame is a pure function of the sequence and its number, as an image of a set is.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose
from ffpose.geometry.trajectory import Trajectory
from ffpose.render.motion import Kind, Orbit, sample_motion, sample_orbit
from ffpose.render.renderer import (
    BAND,
    background,
    camera_of,
    composite,
    object_light,
    prepared,
    sample_count,
    shade,
)
from ffpose.render.scene import Scene
from ffpose.render.shading.rays import Window, cast_rays, find_window
from ffpose.render.shading.sensor import choose_gain, expose

SEQUENCE = 0x5E9
"""Separates the generators of sequences from those of sets of the same seed."""

PIXELS_A_PART = 0.5
"""Motion, in pixels, within which an exposure or a part of the rows counts as one instant."""

MOST_PARTS = 16

POSE = ("tx", "ty", "tz", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, eq=False)
class Sequence:
    """Everything that the frames of a motion depend on, but for their number.

    Attributes:
        scene: Spacecraft, camera, sensor; its own motion blur is not used.
        seed: Seed of light, stars, surface and noise.
        trajectory: Poses of the spacecraft at the middle of each exposure.
        orbit: Sun and Earth.
        camera: Camera of the frames.
        exposure_s: Length of an exposure, during which the motion blurs.
        readout_s: Time from the exposure of the first row to that of the last (rolling shutter); a
            frame's time is that of the middle row.
    """

    scene: Scene
    seed: int
    trajectory: Trajectory
    orbit: Orbit
    camera: Camera
    exposure_s: float = 0.01
    readout_s: float = 0.02

    @classmethod
    def along(
        cls,
        scene: Scene,
        trajectory: Trajectory,
        seed: int = 0,
        size: tuple[int, int] | None = None,
    ) -> Sequence:
        """Return the sequence of a given motion.

        Raises:
            ValueError: The scene's renderer is another one, or `seed` or `size` is out of range.
        """
        if scene.renderer != "ffpose":
            raise ValueError(f"renderer: expected ffpose for sequences, got {scene.renderer!r}")
        if seed < 0:
            raise ValueError(f"seed: expected at least 0, got {seed}")
        seconds = float(trajectory.times[-1] - trajectory.times[0])
        orbit = sample_orbit(scene, seconds, np.random.default_rng([seed, SEQUENCE, 1]))
        return cls(scene, seed, trajectory, orbit, camera_of(scene, size))

    @classmethod
    def of_kind(
        cls,
        kind: Kind,
        scene: Scene,
        seconds: float,
        rate: float,
        seed: int = 0,
        size: tuple[int, int] | None = None,
    ) -> Sequence:
        """Return a sequence of an approach, a tumble or a flyby.

        Args:
            kind: Which of them.
            scene: The set within whose ranges it stays.
            seconds: Its length.
            rate: Frames a second.
            seed: Seed of motion, light, stars, surface and noise.
            size: (width, height) in pixels; default is that of the scene's camera.

        Raises:
            ValueError: A number is out of range, or no such motion was found.
        """
        if not (0 < seconds <= 1e5 and 0 < rate <= 1000):
            raise ValueError(
                f"expected seconds in 0…100000 and rate in 0…1000, got {seconds} and {rate}"
            )
        if seed < 0:
            raise ValueError(f"seed: expected at least 0, got {seed}")
        times = np.arange(max(1, round(seconds * rate))) / rate
        rng = np.random.default_rng([seed, SEQUENCE, 0])
        motion = sample_motion(kind, scene, scene.build(), times, rng)
        return cls.along(scene, motion, seed, size)

    def __len__(self) -> int:
        return len(self.trajectory.times)

    def pose(self, index: int) -> Pose:
        """Return the exact pose in the middle of a frame's exposure."""
        return self.trajectory.pose(index)

    def parameters(self) -> dict[str, Any]:
        """Return all that the frames depend on as plain values."""
        moves = self.trajectory
        return {
            "scene": self.scene.parameters(),
            "seed": self.seed,
            "size": [self.camera.width, self.camera.height],
            "exposure_s": self.exposure_s,
            "readout_s": self.readout_s,
            "times_s": moves.times.tolist(),
            "poses": np.concatenate([moves.t, moves.q], axis=1).tolist(),
        }


def read_trajectory(path: Path) -> Trajectory:
    """Read poses over time from a CSV file of ``time,tx,ty,tz,qw,qx,qy,qz``, in any order.

    Other columns are left out, so that ``trajectory.csv`` of ``ffpose track`` is one too.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: A column is missing, a number is none, a quaternion is not of norm one, or a time
            is not later than the one before; the error names file and line.
    """
    times: list[float] = []
    poses = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for line, row in enumerate(csv.DictReader(file), start=2):
                try:
                    time, *values = (float(row[name] or "") for name in ("time", *POSE))
                    poses.append(Pose.from_vector(values))
                except KeyError as error:
                    expected = f"expected the columns time, {', '.join(POSE)}"
                    raise DataError(f"{expected}; {error.args[0]} is missing", path, 1) from error
                except (TypeError, ValueError) as error:
                    raise DataError(str(error), path, line) from error
                if not math.isfinite(time) or (times and time <= times[-1]):
                    before = f" later than {times[-1]} s, the row before" if times else ""
                    raise DataError(f"time: expected seconds{before}, got {time}", path, line)
                times.append(time)
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"expected a CSV file: {error}", path) from error
    if not times:
        raise DataError("expected at least one row, got none", path)
    return Trajectory.through(np.array(times), poses)


def render_frame(sequence: Sequence, index: int) -> NDArray[np.uint8]:
    """Render one frame of a sequence; the same arguments give the same bytes.

    Returns:
        (H, W, 3) uint8, RGB.
    """
    scene, camera = sequence.scene, sequence.camera
    streams = [np.random.default_rng([sequence.seed, SEQUENCE, 2, part]) for part in range(4)]
    star_rng, gain_rng, surface_rng, odd_rng = streams
    time = float(sequence.trajectory.times[index] - sequence.trajectory.times[0])
    around = sequence.orbit.at(time)
    radiance = background(scene, camera, around, star_rng, odd_rng, 1, sequence.orbit.turn(time))
    craft = scene.build()
    tracer, materials = prepared(craft)
    if scene.randomization.materials > 0:
        materials = materials.varied(scene.randomization.materials, odd_rng)
    pose = sequence.pose(index)
    light = object_light(pose, around, scene, odd_rng)
    lit = [np.zeros((3, 0), dtype=np.float32)]
    total = np.zeros_like(radiance)
    instants = _instants(sequence, index, sequence.exposure_s)
    for instant in instants:
        layer = radiance.copy()
        for window, seen in _rows(sequence, index, instant):
            samples = sample_count(window, camera)
            for band in window.bands(BAND // samples**2):
                view = cast_rays(tracer, band, camera, seen, samples)
                lit.append(
                    shade(view, tracer, band, samples, camera, materials, light, surface_rng)
                )
                composite(layer, band, view.hits.ray, lit[-1], samples)
        total += layer
    total /= len(instants)
    spread = math.hypot(scene.sensor.exposure_spread, scene.randomization.exposure)
    gain = choose_gain(total, np.concatenate(lit, axis=1), spread, gain_rng)
    noise_rng = np.random.default_rng([sequence.seed, SEQUENCE, 3, index])
    return expose(total, gain, replace(scene.sensor, motion_px=0.0), noise_rng)


def _instants(sequence: Sequence, index: int, span: float) -> list[float]:
    """Return the middles of the parts of a time span, about zero, in which little moves."""
    outline = sequence.scene.build().outline
    ends = [
        sequence.trajectory.pose(index, later).project(outline, sequence.camera)
        for later in (-span / 2, span / 2)
    ]
    motion = float(np.nan_to_num(np.abs(ends[1] - ends[0])).max())
    parts = min(MOST_PARTS, max(1, math.ceil(motion / PIXELS_A_PART)))
    return [((part + 0.5) / parts - 0.5) * span for part in range(parts)]


def _rows(sequence: Sequence, index: int, instant: float) -> Iterator[tuple[Window, Pose]]:
    """Yield the rows that a rolling shutter exposes together, and the pose that they see."""
    corners, height = sequence.scene.build().corners, sequence.camera.height
    laters = _instants(sequence, index, sequence.readout_s)
    for part, later in enumerate(laters):
        pose = sequence.trajectory.pose(index, instant + later)
        window = find_window(corners, pose, sequence.camera)
        if window is None:
            continue
        first, last = (height * edge // len(laters) for edge in (part, part + 1))
        top, bottom = max(window.top, first), min(window.bottom, last)
        if top < bottom:
            yield window._replace(top=top, bottom=bottom), pose
