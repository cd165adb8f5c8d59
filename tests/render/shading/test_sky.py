"""Stars through a lens that distorts."""

import numpy as np
import pytest

from ffpose.geometry import Camera, DistortedCamera
from ffpose.render.shading.sky import draw_stars

INTRINSICS = (128, 96, 64.0, 64.0, 64.0, 48.0)


def test_a_lens_without_coefficients_shows_the_stars_of_a_pinhole():
    lens = DistortedCamera(*INTRINSICS, (0.0,) * 5)
    one, other = (
        draw_stars(camera, np.random.default_rng(0)) for camera in (lens, Camera(*INTRINSICS))
    )
    assert one.max() > 0
    np.testing.assert_array_equal(one, other)


@pytest.mark.filterwarnings("error")
def test_rays_far_outside_of_a_lens_are_no_pixels():
    """The polynomial sends rays along the image plane to numbers that no integer holds."""
    stars = draw_stars(
        DistortedCamera(*INTRINSICS, (-0.2, 0.05, 0.0, 0.0, 0.01)), np.random.default_rng(0)
    )
    assert np.isfinite(stars).all()
    assert stars.max() > 0
