"""Lens distortion: OpenCV's published equations, and images that lose it."""

import numpy as np
import pytest
from PIL import Image

from ffpose.geometry import Camera, DistortedCamera
from ffpose.imaging import undistortion
from ffpose.imaging.images import decode_all
from ffpose.imaging.undistortion import undistort

LENS = (-0.22, 0.51, -0.0007, -0.0002, -0.13)
CAMERA = DistortedCamera(320, 200, 160.0, 162.0, 158.0, 103.0, LENS)


def test_each_coefficient_bends_as_opencv_documents():
    """At x = 0.5, y = 1, so r² = 1.25: 1 + k r², r⁴ and r⁶; 2 p x y and p (r² + 2 y²); 1 at 0."""
    expected = {
        0: (0.5 * (1 + 0.1 * 1.25), 1 + 0.1 * 1.25),
        1: (0.5 * (1 + 0.1 * 1.5625), 1 + 0.1 * 1.5625),
        2: (0.5 + 2 * 0.1 * 0.5, 1 + 0.1 * (1.25 + 2)),
        3: (0.5 + 0.1 * (1.25 + 0.5), 1 + 2 * 0.1 * 0.5),
        4: (0.5 * (1 + 0.1 * 1.953125), 1 + 0.1 * 1.953125),
    }
    for place, (x, y) in expected.items():
        lens = tuple(0.1 * (place == index) for index in range(5))
        camera = DistortedCamera(20, 20, 10.0, 20.0, 10.0, 10.0, lens)
        pixel = (10 + 10 * x, 10 + 20 * y)
        np.testing.assert_allclose(camera.project([1.0, 2.0, 2.0]), pixel, rtol=1e-14)


def test_without_coefficients_it_is_a_pinhole():
    points = np.random.default_rng(0).normal((0, 0, 5), 1, (9, 3))
    camera = DistortedCamera(320, 200, 160.0, 162.0, 158.0, 103.0, (0.0,) * 5)
    np.testing.assert_array_equal(camera.project(points), CAMERA.pinhole.project(points))
    assert type(CAMERA.pinhole) is Camera


def test_resized_and_cropped_cameras_keep_the_lens():
    point = [0.7, -0.4, 2.0]
    pixel = CAMERA.project(point)
    np.testing.assert_allclose(CAMERA.resized(160, 50).project(point), pixel * (0.5, 0.25))
    np.testing.assert_allclose(CAMERA.cropped(7, 9, 100, 90).project(point), pixel - (7, 9))


def spots(camera, points):
    """An image with a round spot, two pixels wide, where the camera sees each point."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    light = sum(
        np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8) for u, v in camera.project(points)
    )
    return Image.fromarray(np.rint(255 * light.clip(0, 1)).astype(np.uint8)).convert("RGB")


def center(image, near):
    """The center of mass of the light within nine pixels of a place."""
    pixels = np.asarray(image)[..., 0].astype(float)
    rows, columns = np.mgrid[: image.height, : image.width] + 0.5
    light = pixels * (np.hypot(columns - near[0], rows - near[1]) < 9)
    return np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()


def test_an_undistorted_image_shows_points_where_the_pinhole_sees_them():
    points = np.array([[0, 0, 1], [0.7, 0.4, 1], [-0.8, -0.45, 1], [0.6, -0.5, 1]], float)
    assert np.abs(CAMERA.project(points) - CAMERA.pinhole.project(points)).max() > 5
    seen = undistort(spots(CAMERA, points), CAMERA)
    for pixel in CAMERA.pinhole.project(points):
        np.testing.assert_allclose(center(seen, pixel), pixel, atol=0.15)


def test_no_distortion_changes_no_pixel():
    noise = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    camera = DistortedCamera(30, 20, 25.0, 25.0, 15.0, 10.0, (0.0,) * 5)
    np.testing.assert_array_equal(undistort(Image.fromarray(noise), camera), noise)


def test_what_the_image_does_not_show_is_black():
    camera = DistortedCamera(30, 20, 15.0, 15.0, 15.0, 10.0, (0.4, 0.0, 0.0, 0.0, 0.0))
    seen = np.asarray(undistort(Image.new("RGB", (30, 20), "white"), camera))
    assert (seen[0, 0] == 0).all()
    assert (seen[10, 15] == 255).all()


@pytest.mark.parametrize("image", [Image.new("L", (320, 200)), Image.new("RGB", (200, 320))])
def test_another_mode_or_size_is_refused(image):
    with pytest.raises(ValueError, match=r"expected mode and size \('RGB', \(320, 200\)\)"):
        undistort(image, CAMERA)


def test_a_lens_that_folds_the_image_is_refused():
    """The radius r (1 + k r²) turns back where 1 + 3 k r² is 0; the corner is at r² = 1 + 0.75²."""
    square = 1 + 0.75**2
    lenses = [(share / (3 * square), 0.0, 0.0, 0.0, 0.0) for share in (-0.9, -1.5)]
    DistortedCamera(400, 300, 200.0, 200.0, 200.0, 150.0, lenses[0])
    with pytest.raises(ValueError, match=r"distortion: expected different pixels .* folds it"):
        DistortedCamera(400, 300, 200.0, 200.0, 200.0, 150.0, lenses[1])


@pytest.mark.parametrize("lens", [(0.1,), (0.1, 0.0, 0.0, 0.0, float("nan"))])
def test_bad_coefficients_are_refused(lens):
    with pytest.raises(ValueError, match="distortion: expected"):
        DistortedCamera(320, 200, 160.0, 162.0, 158.0, 103.0, lens)


def test_many_threads_make_the_table_of_a_camera_once():
    """Each takes 64 bytes a pixel, and longer than an image."""
    image = Image.new("RGB", (320, 200), "white")
    undistortion._corners.cache_clear()
    seen = list(decode_all(lambda camera: undistort(image, camera), [CAMERA] * 20))
    assert len(seen) == 20
    assert undistortion._corners.cache_info().misses == 1
