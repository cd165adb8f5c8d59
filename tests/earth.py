"""The Earth in the camera frame, for `ffpose.arrays.shade_earth`; lengths in Earth radii."""

from typing import NamedTuple

import numpy as np

from ffpose.arrays import shade_earth


class Earth(NamedTuple):
    nadir: np.ndarray
    altitude: float
    sun: np.ndarray
    ground: np.ndarray
    octaves: int = 6

    def shade(self, rays, pixel_angle):
        vectors = self.nadir.tolist(), self.altitude, self.sun.tolist(), self.ground.tolist()
        return shade_earth(rays, *vectors, self.octaves, pixel_angle)
