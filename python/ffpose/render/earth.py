"""The Earth and its air as seen from a low orbit; the light is worked out in ffpose-core."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose import arrays
from ffpose.render.vectors import Floats


class Earth(NamedTuple):
    """The Earth in the camera frame; lengths in Earth radii.

    Attributes:
        nadir: (3,) unit vector to its centre.
        altitude: of the camera.
        sun: (3,) unit vector to the sun.
        ground: (3, 3) rotation from the camera frame to the frame of land and clouds.
        octaves: detail of the clouds; finer images need more.
    """

    nadir: NDArray[np.float64]
    altitude: float
    sun: NDArray[np.float64]
    ground: NDArray[np.float64]
    octaves: int = 6


def shade_earth(earth: Earth, rays: Floats, pixel_angle: float) -> tuple[Floats, Floats]:
    """Light that comes along rays from the Earth and its air.

    Args:
        earth: where the Earth is.
        rays: (3, N) unit vectors, camera frame.
        pixel_angle: angle of one pixel in radians, over which the limb is smoothed.

    Returns:
        radiance (3, N), and (N,) the part of what lies behind that still shows.
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
