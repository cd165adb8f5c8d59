"""Axes drawn where the projection says."""

import numpy as np
import pytest
from PIL import Image

from ffpose.config import PRESETS
from ffpose.geometry import URSO_CAMERA, Pose
from ffpose.imaging.overlay import draw_axes
from ffpose.inference.prediction import axis_length

COLORS = ("#ff0000", "#00ff00", "#0000ff")


def colored(image, color):
    """(u, v) of the pixels of one color, (N, 2)."""
    rows, columns = np.nonzero((np.asarray(image) == color).all(axis=-1))
    return np.stack([columns, rows], axis=-1) + 0.5


def test_axes_point_along_the_camera_frame_for_the_identity():
    image = Image.new("RGB", (640, 480))
    pose = Pose([0, 0, 10], [1, 0, 0, 0])
    drawn = draw_axes(image, pose, URSO_CAMERA, length=2, colors=COLORS, width=3)
    # Half the camera's size: 320 * 2 / 10 = 64 pixels to the right, 64 and a bit downward.
    x, y = colored(drawn, (255, 0, 0)), colored(drawn, (0, 255, 0))
    assert x[:, 0].max() == pytest.approx(384, abs=1.5)
    assert np.abs(x[:, 1] - 240).max() < 3
    assert y[:, 1].max() == pytest.approx(304, abs=1.5)
    assert np.abs(y[:, 0] - 320).max() < 3
    assert np.asarray(image).max() == 0  # the image that came is as it was


def test_axes_of_an_object_of_unknown_size_are_a_tenth_of_its_distance():
    pose = Pose([0, 0, 10], [1, 0, 0, 0])
    shown = [
        np.asarray(draw_axes(Image.new("RGB", (64, 48)), pose, URSO_CAMERA, length))
        for length in (None, 1.0)
    ]
    np.testing.assert_array_equal(*shown)
    assert axis_length(PRESETS["polar"]) == PRESETS["polar"].object_radius_m / 3
    assert axis_length(PRESETS["base"]) is None


def test_the_nearest_axis_lies_on_top():
    # Turned by 180 degrees about y, z points at the camera and covers the origin.
    pose = Pose([0, 0, 10], [0, 0, 1, 0])
    drawn = draw_axes(Image.new("RGB", (64, 48)), pose, URSO_CAMERA, colors=COLORS, width=9)
    assert drawn.getpixel((32, 24)) == (0, 0, 255)


def test_what_is_behind_the_camera_is_left_out():
    pose = Pose([0, 0, -5], [1, 0, 0, 0])
    drawn = draw_axes(Image.new("RGB", (64, 48)), pose, URSO_CAMERA)
    assert np.asarray(drawn).max() == 0


def test_only_rgb_is_taken():
    with pytest.raises(ValueError, match="expected mode RGB, got 'L'"):
        draw_axes(Image.new("L", (64, 48)), Pose([0, 0, 5], [1, 0, 0, 0]), URSO_CAMERA)
