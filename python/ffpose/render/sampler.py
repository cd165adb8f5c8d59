"""Sampling of the positions of spacecraft, sun and Earth in one image, from the set's ranges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ffpose.geometry import Camera, FloatArray, Pose
from ffpose.render.scene import Scene

EARTH_RADIUS_M = 6_371_000.0
ALTITUDE_M = (380_000.0, 440_000.0)

DUSK_DEG = 3.0
"""Height of the sun above which the ground gives the spacecraft light, about."""

DIRECTION_TRIES = 24

LEAST_DEPTH_M = 0.5
"""Depth that the whole spacecraft keeps from the camera; a tenth of the least distance if less."""


class Surroundings(NamedTuple):
    """The lights and the Earth about the spacecraft, all in the camera frame.

    Attributes:
        sun: (3,) unit vector to the sun.
        nadir: (3,) unit vector to the Earth's center.
        altitude: height above the ground in Earth radii.
        ground: (3, 3) rotation from the camera frame to that of the Earth's features.
        eclipsed: whether the Earth hides the sun; a lamp at the camera then gives light.
    """

    sun: FloatArray
    nadir: FloatArray
    altitude: float
    ground: FloatArray
    eclipsed: bool


def sample_pose(scene: Scene, rng: np.random.Generator) -> Pose:
    """A pose within the set's ranges that leaves as much of the spacecraft in frame as they say.

    The distance is uniform, the attitude uniform over rotations within `attitude_range_deg`, and
    the direction uniform over the frame among those that satisfy `lateral_m` and
    the visible part's bounds.

    Raises:
        ValueError: no pose was found; the set's ranges contradict each other.
    """
    outline = scene.build().outline
    for _ in range(200):
        distance = rng.uniform(*scene.distance_m)
        q = _attitude(scene.attitude_range_deg, rng)
        for _ in range(DIRECTION_TRIES):
            pose = Pose(distance * direction(scene, rng), q)
            near_axis = np.hypot(pose.t[0], pose.t[1]) <= scene.lateral_m
            if near_axis and is_in_frame(pose.transform(outline), scene):
                return pose
    raise ValueError(
        f"{scene.name}: found no pose with {scene.min_visible:.0%} to {scene.max_visible:.0%} "
        f"of the spacecraft in frame at {scene.distance_m} m within {scene.lateral_m} m of the "
        "axis; they may be too near for the camera's angle of view"
    )


def sample_surroundings(scene: Scene, rng: np.random.Generator) -> Surroundings:
    """Sun and Earth as a camera of random attitude in a low orbit meets them.

    A share `eclipse_rate` of the images is taken in the Earth's shadow, the others outside it; of
    a set at dusk where the sun is at most `DUSK_DEG` above the horizon of the ground below.
    """
    eclipsed = bool(rng.random() < scene.eclipse_rate)
    altitude = rng.uniform(*ALTITUDE_M) / EARTH_RADIUS_M
    nadir = unit_vector(rng)
    ground = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    while True:
        sun = unit_vector(rng)
        wanted = eclipsed or not scene.dusk or is_low(sun, nadir)
        if wanted and meets_earth(sun, nadir, altitude) == eclipsed:
            return Surroundings(sun, nadir, altitude, ground, eclipsed)


def is_low(sun: FloatArray, nadir: FloatArray) -> bool:
    """Whether the sun, seen from the ground below, is at most `DUSK_DEG` above the horizon."""
    return bool(sun @ nadir >= -math.sin(math.radians(DUSK_DEG)))


def meets_earth(ray: FloatArray, nadir: FloatArray, altitude: float) -> bool:
    """Whether a ray from a place `altitude` Earth radii above the ground meets the Earth."""
    return bool(ray @ nadir > horizon_cosine(altitude))


def horizon_cosine(altitude: float) -> float:
    """Return the cosine of the angle between nadir and horizon, `altitude` Earth radii up."""
    return math.sqrt(1 - 1 / (1 + altitude) ** 2)


def unit_vector(rng: np.random.Generator) -> FloatArray:
    """Sample a direction (3,)."""
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _attitude(limits_deg: tuple[float, float, float], rng: np.random.Generator) -> FloatArray:
    roll_limit, pitch_limit, yaw_limit = np.radians(limits_deg)
    roll = rng.uniform(-roll_limit, roll_limit)
    # Uniform over rotations means uniform in the sine of the pitch.
    pitch = np.arcsin(rng.uniform(-1.0, 1.0) * np.sin(pitch_limit))
    yaw = rng.uniform(-yaw_limit, yaw_limit)
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll, pitch, yaw))
    return np.array(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def direction(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Sample the unit vector (3,) through a place in the frame."""
    camera = scene.camera
    u, v = rng.uniform(0.0, camera.width), rng.uniform(0.0, camera.height)
    ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
    return np.asarray(ray / np.linalg.norm(ray))


def visible_share(points: FloatArray, camera: Camera) -> float:
    """Share of points (N, 3) of the camera frame that lie in the frame."""
    u, v = camera.project(points).T
    inside = (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    return float(inside.mean())


def is_in_frame(points: FloatArray, scene: Scene) -> bool:
    """Return whether as many of an outline's points (N, 3) as the set wants lie in the frame.

    All of them have to keep their distance from the camera (`LEAST_DEPTH_M`).
    """
    if points[:, 2].min() < min(LEAST_DEPTH_M, 0.1 * scene.distance_m[0]):
        return False
    return scene.min_visible <= visible_share(points, scene.camera) <= scene.max_visible
