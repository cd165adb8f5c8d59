"""Under what light, and before what, an image is taken: what errors are broken down by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffpose.render.renderer import situation
from ffpose.render.sampler import meets_earth, visible_share
from ffpose.render.scene import Scene, get_scene


class Conditions(NamedTuple):
    """The conditions of one image.

    Attributes:
        distance_m: from the camera to the object's origin.
        eclipsed: the Earth hides the sun; a lamp at the camera gives light.
        sun_angle_deg: angle between the viewing ray, which goes to the object's origin, and the
            direction to the sun; below 90 the sun is before the camera and a sunlit object is
            back-lit.
        earth_behind: the viewing ray goes on to the Earth, and that is what the picture shows
            there: no wall of clouds (`ffpose.render.Randomization`) is in its place.
        visible_share: part of the spacecraft's extent, by points of its surface, in the frame.
    """

    distance_m: float
    eclipsed: bool
    sun_angle_deg: float
    earth_behind: bool
    visible_share: float


def conditions_of(scene: Scene | str, seed: int, index: int) -> Conditions:
    """The conditions of the image that `render` makes of the same arguments, at any size."""
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
