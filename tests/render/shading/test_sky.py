"""Stars in the frame of a pinhole."""

import numpy as np
import pytest

from ffpose.geometry import Camera
from ffpose.render.shading.sky import draw_stars


@pytest.mark.filterwarnings("error")
def test_rays_along_the_image_plane_are_no_pixels():
    """Their numbers are beyond those that integers hold."""
    stars = draw_stars(Camera(128, 96, 64.0, 64.0, 64.0, 48.0), np.random.default_rng(0))
    assert np.isfinite(stars).all()
    assert stars.max() > 0
