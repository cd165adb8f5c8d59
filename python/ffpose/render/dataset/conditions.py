"""The conditions an image is taken under, by which an evaluation breaks its errors down."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffpose.render.renderer import situation
from ffpose.render.sampler import meets_earth, visible_share
from ffpose.render.scene import Scene, get_scene


class Conditions(NamedTuple):
    """The conditions of one image.

    Attributes:
        distance_m: Distance from the camera to the object's origin, meters.
        eclipsed: Whether the Earth hides the sun; a lamp at the camera then gives light.
        sun_angle_deg: Angle between the viewing ray, which goes to the object's origin, and the
            direction to the sun; below 90 degrees the sun is in front of the camera and a sunlit
            object is back-lit.
        earth_behind: Whether the viewing ray goes on to the Earth, and the image shows the Earth
            there rather than the random background of `ffpose.render.Randomization`.
        visible_share: Fraction of points on the spacecraft's surface that lie in the frame.
    """

    distance_m: float
    eclipsed: bool
    sun_angle_deg: float
    earth_behind: bool
    visible_share: float


def conditions_of(scene: Scene | str, seed: int, index: int) -> Conditions:
    """Return the conditions of the image that `render` makes of these arguments, at any size."""
    scene = get_scene(scene) if isinstance(scene, str) else scene
    pose, around, backdrop = situation(scene, seed, index)
    distance = float(np.linalg.norm(pose.t))
    ray = pose.t / distance
    across = float(np.linalg.norm(np.cross(ray, around.sun)))
    return Conditions(
        distance_m=distance,
        eclipsed=around.eclipsed,
        sun_angle_deg=float(np.degrees(np.arctan2(across, ray @ around.sun))),
        earth_behind=not backdrop and meets_earth(ray, around.nadir, around.altitude),
        visible_share=visible_share(pose.transform(scene.build().outline), scene.camera),
    )
