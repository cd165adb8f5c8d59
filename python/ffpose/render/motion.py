"""Motions of a spacecraft before a camera in orbit: approaches, tumbles and flybys.

The camera holds its attitude to the Earth's center, as a vehicle in rendezvous does: the ground
passes below it, and the sun and the stars turn about the orbit's normal.
"""

from __future__ import annotations

import math
from itertools import count
from typing import Literal, NamedTuple, get_args

import numpy as np

from ffpose.arrays import quaternion_to_euler
from ffpose.errors import expect
from ffpose.geometry import FloatArray
from ffpose.geometry.rotations import from_rotation_vector, multiply, rotation_matrix
from ffpose.geometry.trajectory import Trajectory
from ffpose.render.sampler import (
    EARTH_RADIUS_M,
    Surroundings,
    direction,
    is_in_frame,
    meets_earth,
    sample_surroundings,
    unit_vector,
)
from ffpose.render.scene import Scene
from ffpose.render.spacecraft.craft import Craft

Kind = Literal["approach", "tumble", "flyby"]
KINDS: tuple[Kind, ...] = get_args(Kind)

SPEED_M_S = {"approach": (0.05, 0.25), "tumble": (0.0, 0.02), "flyby": (0.1, 0.25)}
RATE_DEG_S = {"approach": (0.0, 0.3), "tumble": (0.5, 5.0), "flyby": (0.0, 1.0)}
"""Ranges of the relative speed and of the angular velocity of each kind of motion."""

TERMINATOR_RATE = 1 / 3
"""Share of the sequences that pass into the Earth's shadow or out of it."""

GRAVITY_M3_S2 = 3.986_004_418e14
TRIES = 1000
STEP_S = 0.25
"""Largest step of the tumble's integration; at 5°/s its error is below 1e-8."""


class Orbit(NamedTuple):
    """Sun, Earth and stars about a camera in a circular orbit.

    Attributes:
        start: Directions at time zero, camera frame.
        normal: ``(3,)`` unit vector along the orbit's angular momentum, camera frame.
    """

    start: Surroundings
    normal: FloatArray

    @property
    def rate(self) -> float:
        """Mean motion, rad/s."""
        radius = EARTH_RADIUS_M * (1 + self.start.altitude)
        return math.sqrt(GRAVITY_M3_S2 / radius**3)

    def turn(self, time: float) -> FloatArray:
        """Return the rotation (3, 3) of the stars in the camera frame since time zero."""
        return rotation_matrix(from_rotation_vector(-self.rate * time * self.normal))

    def at(self, time: float) -> Surroundings:
        """Return the directions at a time, seconds."""
        start, turn = self.start, self.turn(time)
        sun = turn @ start.sun
        eclipsed = meets_earth(sun, start.nadir, start.altitude)
        return start._replace(sun=sun, ground=start.ground @ turn.T, eclipsed=eclipsed)

    def shadows(self, seconds: float) -> set[bool]:
        """Return the values of `Surroundings.eclipsed` from time zero to a time, seconds.

        They change at most once between the instants at which the sun is nearest to the nadir and
        farthest from it.
        """
        start = self.start
        across = np.cross(self.normal, start.nadir)
        angle = math.atan2(start.sun @ across, start.sun @ start.nadir)
        extremes = [(angle - extreme) % math.tau / self.rate for extreme in (0.0, math.pi)]
        times = [0.0, seconds, *(time for time in extremes if time < seconds)]
        return {self.at(time).eclipsed for time in times}


def sample_orbit(scene: Scene, seconds: float, rng: np.random.Generator) -> Orbit:
    """Sample sun and Earth; a share `TERMINATOR_RATE` of the sequences crosses the Earth's shadow.

    The others are in the shadow, all the time or not at all, as often as the scene's images; so are
    those too short to cross it. Those too long to stay in it cross it too. Where all images are in
    the shadow or none is, none else crosses it.
    """
    crossing = rng.random() < TERMINATOR_RATE and 0 < scene.eclipse_rate < 1
    eclipsed = rng.random() < scene.eclipse_rate
    wanted = {False, True} if crossing else {eclipsed}
    for attempt in count():
        if attempt == TRIES and (crossing or eclipsed):
            wanted = {eclipsed} if crossing else {False, True}
        start = sample_surroundings(scene, rng)
        normal = np.cross(start.nadir, rng.standard_normal(3))
        orbit = Orbit(start, normal / np.linalg.norm(normal))
        if orbit.shadows(seconds) == wanted:
            break
    return orbit


def sample_motion(
    kind: Kind, scene: Scene, times: FloatArray, rng: np.random.Generator
) -> Trajectory:
    """Sample a motion that stays within the scene's ranges of distance, attitude and view.

    An approach comes nearer along the line of sight, a tumble stays where it is and turns as a free
    rigid body does, a flyby crosses the line of sight. A ValueError where no such motion was found.
    """
    expect(kind in KINDS, "motion", f"one of {', '.join(KINDS)}", kind)
    craft, middle = scene.build(), (times[0] + times[-1]) / 2
    for _ in range(TRIES):
        distance = rng.uniform(*scene.distance_m)
        ray = direction(scene, rng)
        way = {"approach": -ray, "tumble": rng.standard_normal(3)}.get(
            kind, np.cross(ray, rng.standard_normal(3))
        )
        velocity = way / np.linalg.norm(way) * rng.uniform(*SPEED_M_S[kind])
        t = distance * ray + velocity * (times - middle)[:, None]
        if not _in_place(t, scene):
            continue
        spin = unit_vector(rng) * math.radians(rng.uniform(*RATE_DEG_S[kind]))
        start = rng.standard_normal(4)
        q, w = _tumble(start / np.linalg.norm(start), spin, inertia(craft), times)
        if _in_view(t, q, scene, craft):
            return Trajectory(times, t, q, np.broadcast_to(velocity, t.shape).copy(), w)
    raise ValueError(
        f"{kind}: found no motion of {times[-1] - times[0]:g} s within the ranges of {scene.name}: "
        f"{scene.distance_m} m, attitudes within {scene.attitude_range_deg}; "
        "expected wider ranges (--attitude-range 180 90 180) or fewer --seconds"
    )


def _in_place(t: FloatArray, scene: Scene) -> bool:
    distance = np.linalg.norm(t, axis=1)
    least, most = scene.distance_m
    across = np.hypot(t[:, 0], t[:, 1]).max()
    return bool(distance.min() >= least and distance.max() <= most and across <= scene.lateral_m)


def _in_view(t: FloatArray, q: FloatArray, scene: Scene, craft: Craft) -> bool:
    angles = np.abs(quaternion_to_euler(q))
    if (angles > np.array(scene.attitude_range_deg) + 1e-9).any():
        return False
    return all(
        is_in_frame(craft.outline @ rotation_matrix(turn).T + each, scene)
        for each, turn in zip(t, q, strict=True)
    )


def inertia(craft: Craft) -> FloatArray:
    """Return the inertia (3, 3) of the outline's points, of any unit, by which a tumble turns."""
    points = craft.outline - craft.outline.mean(axis=0)
    return np.asarray((points**2).sum() * np.eye(3) - points.T @ points) / len(points)


def _tumble(
    q: FloatArray, w: FloatArray, moments: FloatArray, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Integrate Euler's equations of a free rigid body by Runge and Kutta's fourth order."""
    inverse = np.linalg.inv(moments)

    def change(state: FloatArray) -> FloatArray:
        q, w = state[:4], state[4:]
        return np.concatenate(
            [0.5 * multiply(q, np.array([0.0, *w])), inverse @ np.cross(moments @ w, w)]
        )

    state = np.concatenate([q, w])
    states = [state]
    for elapsed in np.diff(times):
        steps = math.ceil(elapsed / STEP_S)
        h = elapsed / steps
        for _ in range(steps):
            a = change(state)
            b = change(state + h / 2 * a)
            c = change(state + h / 2 * b)
            d = change(state + h * c)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
            state[:4] /= np.linalg.norm(state[:4])
        states.append(state)
    all_states = np.array(states)
    return all_states[:, :4], all_states[:, 4:]
