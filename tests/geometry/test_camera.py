"""Cameras, by numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera


@pytest.mark.parametrize(
    ("size", "same"),
    [((1280, 960), True), ((4, 3), True), ((640, 481), False), ((960, 1280), False)],
)
def test_an_image_has_the_aspect_of_its_camera(size, same):
    assert URSO_CAMERA.has_aspect(*size) is same


def test_camera_projects_as_its_matrix():
    camera = Camera(1920, 1200, 3003.413, 3003.413, 960.0, 600.0)
    points = np.random.default_rng(4).uniform([-1, -1, 5], [1, 1, 20], size=(7, 3))
    image = points @ camera.matrix.T
    np.testing.assert_allclose(camera.project(points), image[:, :2] / image[:, 2:])
    # SPEED's own check value.
    np.testing.assert_allclose(camera.project([0.1, -0.2, 10]), [990.03413, 539.93174])


def test_what_is_not_in_front_of_the_camera_has_no_pixel():
    pixels = URSO_CAMERA.project([[0, 0, 1], [0, 0, 0], [1, 1, -1]])
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, True, True])


@given(
    width=st.integers(1, 4000),
    height=st.integers(1, 4000),
    u=st.floats(0, 1),
    v=st.floats(0, 1),
)
def test_a_resized_camera_sees_a_point_at_the_same_place_of_the_image(width, height, u, v):
    point = [
        (u * 1280 - 640) / URSO_CAMERA.fx * 7,
        (v * 960 - 480) / URSO_CAMERA.fy * 7,
        7.0,
    ]
    pixel = URSO_CAMERA.resized(width, height).project(point)
    np.testing.assert_allclose(pixel, [u * width, v * height], atol=1e-9)


def test_a_cropped_camera_counts_from_the_crops_corner():
    whole, part = URSO_CAMERA, URSO_CAMERA.cropped(100, 50, 640, 480)
    point = [0.5, -0.25, 8.0]
    np.testing.assert_allclose(part.project(point), whole.project(point) - [100, 50])
    assert (part.width, part.height) == (640, 480)


@pytest.mark.parametrize(
    "change",
    [
        *({"width": 0}, {"height": -1}, {"width": 4.5}, {"width": np.nan}, {"height": np.inf}),
        *({"fx": 0.0}, {"fy": -640.463}, {"cx": np.nan}, {"fx": np.inf}),
    ],
)
def test_a_bad_camera_is_refused(change):
    fields = {"width": 4, "height": 3, "fx": 1.0, "fy": 1.0, "cx": 2.0, "cy": 1.5}
    with pytest.raises(ValueError, match="expected"):
        Camera(**(fields | change))


@pytest.mark.parametrize(
    "camera",
    [
        Camera(64, 48, 32.0, 33.5, 30.0, 24.25),
        DistortedCamera(64, 48, 32.0, 33.5, 30.0, 24.25, (-0.2, 0.05, 1e-3, -2e-3, 0.0)),
    ],
)
def test_a_camera_file_holds_the_camera(tmp_path, camera):
    camera.write(tmp_path / "camera.json")
    assert Camera.read(tmp_path / "camera.json") == camera


def test_a_camera_of_numpys_numbers_can_be_written(tmp_path):
    size, intrinsics = np.array([64, 48]), np.array([32, 33.5, 30, 24.25], np.float32)
    Camera(*size, *intrinsics).write(tmp_path / "camera.json")
    assert Camera.read(tmp_path / "camera.json") == Camera(64, 48, 32.0, 33.5, 30.0, 24.25)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1)])
def test_distortion_may_have_opencvs_shapes(shape):
    values = (-0.2, 0.05, 1e-3, -2e-3, 0.0)
    camera = DistortedCamera(64, 48, 32.0, 33.5, 30.0, 24.25, np.reshape(values, shape))
    assert camera.distortion == values


def test_a_size_of_a_camera_file_may_be_written_as_a_fraction(tmp_path):
    camera = Camera(64, 48, 32.0, 33.5, 30.0, 24.25)
    camera.write(tmp_path / "camera.json")
    text = (tmp_path / "camera.json").read_text().replace("64,", "64.0,").replace("48,", "4.8e1,")
    (tmp_path / "camera.json").write_text(text)
    read = Camera.read(tmp_path / "camera.json")
    assert (read, type(read.width), type(read.height)) == (camera, int, int)
