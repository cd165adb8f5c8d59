"""Definition of a set of images: the spacecraft, the range of poses and the camera."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from ffpose.errors import check_choices, expect
from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera
from ffpose.render.shading.randomization import Randomization
from ffpose.render.shading.sensor import Sensor
from ffpose.render.spacecraft.craft import Craft, build_craft

ORBIT_ECLIPSE_RATE = 0.34
"""Share of its time that a station spends in the Earth's shadow, 410 km up at 51.6 degrees of
inclination: 39 % of an orbit when the sun lies in its plane, 34 % in the mean over the year."""


ALL_ATTITUDES = (180.0, 90.0, 180.0)
"""Greatest absolute roll, pitch and yaw, degrees."""

Renderer = Literal["ffpose", "mitsuba"]
"""What renders the spacecraft: `ffpose.render.shading`, or `ffpose.render.mitsuba`."""

USUAL_RADIUS_M = 5.0
"""Radius of the spacecraft that come with ffpose, about."""

LAMP = 30.0
"""Strength of the camera's lamp in eclipse: at 10 m it gives a surface a third of the sun's light.
No real lamp is so strong; the value also stands for a longer exposure."""


def lamp_for(craft: Craft) -> float:
    """Return the lamp of a spacecraft of any size, seen from as many diameters as those of ffpose.

    Light falls with the square of the distance.
    """
    return LAMP * (craft.radius / USUAL_RADIUS_M) ** 2


@dataclass(frozen=True)
class Scene:
    """Everything that an image depends on, but for the seed, its index and its size.

    Attributes:
        name: the set's name.
        craft: the spacecraft, or the name of one that comes with ffpose.
        distance_m: (least, most) distance of the object's origin from the camera.
        lateral_m: largest distance of the object's origin from the optical axis.
        attitude_range_deg: (roll, pitch, yaw): each angle of the label lies within plus and minus
            its number; the attitude is uniform over rotations within these bounds.
        min_visible: at least this part of the spacecraft's extent lies in the frame ...
        max_visible: ... and at most this, so that a set may hold nothing but cut spacecraft.
        eclipse_rate: share of the images taken in the Earth's shadow by the light of a lamp at the
            camera.
        camera: the camera at full size; images of other sizes are this one resized.
        sensor: how light becomes numbers.
        randomization: how far pictures leave what is real; not at all by default.
        renderer: what renders the spacecraft; sky and Earth are always ours.
        lamp: irradiance of the camera's lamp in eclipse, relative to the sun's, at 1 m.
        dusk: whether outside the Earth's shadow the sun is so low that the ground below is dark:
            then nothing lights the side of the spacecraft that is turned away from the sun.

    Raises:
        ValueError: A range is empty or out of bounds, a choice is unknown, the camera distorts, or
            Mitsuba is to render randomized materials.
    """

    name: str
    craft: str | Craft
    distance_m: tuple[float, float]
    lateral_m: float
    attitude_range_deg: tuple[float, float, float] = (180.0, 60.0, 180.0)
    min_visible: float = 0.9
    max_visible: float = 1.0
    eclipse_rate: float = ORBIT_ECLIPSE_RATE
    camera: Camera = URSO_CAMERA
    sensor: Sensor = field(default_factory=Sensor)
    randomization: Randomization = field(default_factory=Randomization)
    renderer: Renderer = "ffpose"
    lamp: float = LAMP
    dusk: bool = False

    def __post_init__(self) -> None:
        check_choices(self)
        pinhole = not isinstance(self.camera, DistortedCamera)
        expect(pinhole, "camera", "one without distortion, as images are a pinhole's", self.camera)
        able = self.renderer == "ffpose" or self.randomization.materials == 0
        expect(able, "renderer", "ffpose for randomized materials", self.renderer)
        least, most = self.distance_m
        expect(0 < least <= most < math.inf, "distance_m", "0 < least <= most < ∞", self.distance_m)
        expect(self.lateral_m >= 0, "lateral_m", "at least 0", self.lateral_m)
        angles = self.attitude_range_deg
        within = len(angles) == 3 and all(
            0 <= angle <= most for angle, most in zip(angles, ALL_ATTITUDES, strict=True)
        )
        expected = "(roll, pitch, yaw) within 0…180, 0…90, 0…180"
        expect(within, "attitude_range_deg", expected, angles)
        expect(0 <= self.lamp < math.inf, "lamp", "a finite number of at least 0", self.lamp)
        for name in ("min_visible", "max_visible", "eclipse_rate"):
            expect(0 <= getattr(self, name) <= 1, name, "0…1", getattr(self, name))
        expected = f"min_visible {self.min_visible} or more"
        expect(self.max_visible >= self.min_visible, "max_visible", expected, self.max_visible)

    def build(self) -> Craft:
        """The spacecraft itself."""
        return build_craft(self.craft) if isinstance(self.craft, str) else self.craft

    def with_stranger(self, stranger: str | Craft) -> Scene:
        """The set with another spacecraft in its place.

        Spacecraft of files may be of any size, and strangers are then as much larger or smaller as
        they are than those that come with ffpose.
        """
        if isinstance(self.craft, str):
            return replace(self, craft=stranger)
        other = build_craft(stranger) if isinstance(stranger, str) else stranger
        return replace(self, craft=other.scaled(self.craft.radius / USUAL_RADIUS_M))

    def truncated(self, least: float, most: float) -> Scene:
        """The set whose spacecraft the frame's border cuts: a share of least to most is seen."""
        lateral_m = self.distance_m[1]  # as far off the axis as the frame goes
        return replace(self, min_visible=least, max_visible=most, lateral_m=lateral_m)

    def scaled(self, near: float, far: float) -> Scene:
        """The set with its least and greatest distance times ``near`` and ``far``."""
        least, most = self.distance_m
        return replace(self, distance_m=(least * near, most * far))

    def randomized(self, strength: float) -> Scene:
        """The set with `ffpose.render.shading.randomization.Randomization.of_strength`."""
        return replace(self, randomization=Randomization.of_strength(strength))

    def at_dusk(self) -> Scene:
        """The set in the light of a low sun, or of one that has just risen, over dark ground."""
        return replace(self, eclipse_rate=0.0, dusk=True)

    def parameters(self) -> dict[str, Any]:
        """All fields as plain values for a manifest; the spacecraft by its name.

        ``dusk`` only where it is true: folders and files of sets from before it stay theirs.
        """
        values = asdict(replace(self, craft=self.build().name))
        return values if self.dusk else {k: v for k, v in values.items() if k != "dusk"}


SCENES = {
    scene.name: scene
    for scene in (
        Scene("soyuz_easy", "soyuz", (8.0, 22.0), 12.0),
        Scene("soyuz_hard", "soyuz", (8.0, 42.0), 22.0),
        Scene("dragon_hard", "dragon", (8.0, 42.0), 22.0),
    )
}
"""The sets of the paper's section 4.1."""
