"""Rendering the frames of a motion: one sun, one Earth, exact times and poses.

A frame is a pure function of the sequence and its number, as an image of a set is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import expect
from ffpose.geometry import Camera, Pose
from ffpose.geometry.trajectory import Trajectory
from ffpose.render.motion import Kind, Orbit, sample_motion, sample_orbit
from ffpose.render.renderer import NO_LIGHT, background, camera_of, draw_window, subject_of
from ffpose.render.scene import Scene
from ffpose.render.shading.rays import Window, find_window
from ffpose.render.shading.sensor import choose_gain, expose

SEQUENCE = 0x5E9
"""Separates the generators of sequences from those of sets of the same seed."""

PIXELS_A_PART = 0.5
"""Motion, in pixels, within which an exposure or a part of the rows counts as one instant."""

MOST_PARTS = 16


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
        """Return the sequence of a given motion; a ValueError if another renderer is asked for."""
        expect(scene.renderer == "ffpose", "renderer", "ffpose for sequences", scene.renderer)
        expect(seed >= 0, "seed", "at least 0", seed)
        expect(len(trajectory.times) > 0, "trajectory", "at least one pose", 0)
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
        """Return a sequence of an approach, a tumble or a flyby within the scene's ranges.

        It lasts so many seconds, of ``rate`` frames each, of ``size`` (width, height) pixels, by
        default the camera's. A ValueError if a number is out of range, or no such motion was found.
        """
        if not (0 < seconds <= 1e5 and 0 < rate <= 1000):
            raise ValueError(
                f"expected seconds in 0…100000 and rate in 0…1000, got {seconds} and {rate}"
            )
        expect(seed >= 0, "seed", "at least 0", seed)
        times = np.arange(max(1, round(seconds * rate))) / rate
        rng = np.random.default_rng([seed, SEQUENCE, 0])
        motion = sample_motion(kind, scene, times, rng)
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


def render_frame(sequence: Sequence, index: int) -> NDArray[np.uint8]:
    """Render one frame (H, W, 3), uint8, RGB; the same arguments give the same bytes."""
    scene, camera = sequence.scene, sequence.camera
    streams = [np.random.default_rng([sequence.seed, SEQUENCE, 2, part]) for part in range(4)]
    star_rng, gain_rng, surface_rng, odd_rng = streams
    time = float(sequence.trajectory.times[index] - sequence.trajectory.times[0])
    around = sequence.orbit.at(time)
    radiance = background(scene, camera, around, star_rng, odd_rng, 1, sequence.orbit.turn(time))
    subject = subject_of(scene, sequence.pose(index), around, odd_rng, surface_rng)
    lit = [NO_LIGHT]
    total = np.zeros_like(radiance)
    instants = _instants(sequence, index, sequence.exposure_s)
    for instant in instants:
        layer = radiance.copy()
        for window, seen in _rows(sequence, index, instant):
            lit.append(draw_window(layer, window, camera, seen, subject))
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
