"""The Earth and its atmosphere seen from low orbit, shaded by ffpose-core."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose import arrays
from ffpose.render.shading.vectors import Floats


class Earth(NamedTuple):
    """The Earth in the camera frame; lengths in Earth radii.

    Attributes:
        nadir: (3,) unit vector to the Earth's center.
        altitude: Height of the camera above the ground.
        sun: (3,) unit vector to the sun.
        ground: (3, 3) rotation from the camera frame to the frame of land and clouds.
        octaves: Noise octaves of the clouds; finer images need more.
    """

    nadir: NDArray[np.float64]
    altitude: float
    sun: NDArray[np.float64]
    ground: NDArray[np.float64]
    octaves: int = 6


def shade_earth(earth: Earth, rays: Floats, pixel_angle: float) -> tuple[Floats, Floats]:
    """Compute the radiance that reaches the camera from the Earth and its atmosphere.

    Args:
        earth: The Earth in the camera frame.
        rays: (3, N) unit vectors, camera frame.
        pixel_angle: Angle that one pixel covers, radians; the limb is smoothed over it.

    Returns:
        Radiance (3, N), and the transmittance (N,) for what lies behind the Earth.
    """
    return arrays.shade_earth(
        rays,
        earth.nadir.tolist(),
        earth.altitude,
        earth.sun.tolist(),
        earth.ground.tolist(),
        earth.octaves,
        pixel_angle,
    )
