"""Reprojection against projection: what a camera sees stands where `Camera.project` puts it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import Reprojection, reproject
from ffpose.imaging.undistortion import undistort

SOURCE = Camera(width=320, height=240, fx=210.0, fy=214.0, cx=150.5, cy=127.25)
POINTS = np.array([[0.1, -0.05, 1.0], [-1.2, 0.8, 5.0], [2.0, 1.0, 9.0]])
"""Within a quarter of a radian of the boresight, so that every view below shows them."""


def noise_image(width, height, seed=0):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    return Image.fromarray(pixels)


def dots(camera, sigma):
    """The image of `POINTS`: a round spot each, in a color plane of its own."""
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    planes = [
        np.exp(-((x - u) ** 2 + (y[:, None] - v) ** 2) / (2 * sigma**2))
        for u, v in camera.project(POINTS)
    ]
    return Image.fromarray((np.stack(planes, -1) * 255).round().astype(np.uint8))


def centers_of_mass(image):
    """(u, v) of each color plane, (3, 2)."""
    planes = np.asarray(image, float)
    mass = planes.sum((0, 1))
    u = (planes.sum(0) * (np.arange(image.width) + 0.5)[:, None]).sum(0) / mass
    v = (planes.sum(1) * (np.arange(image.height) + 0.5)[:, None]).sum(0) / mass
    return np.stack([u, v], -1)


@pytest.mark.parametrize(
    "view",
    [
        Camera(128, 96, 80.0, 90.0, 60.0, 50.0),  # coarser, and squeezed
        Camera(400, 400, 500.0, 480.0, 210.0, 190.0),  # finer and narrower
        Camera(200, 200, 100.0, 100.0, 100.0, 100.0),  # wider: black at all sides
        Camera(300, 100, 105.0, 60.0, 40.3, 77.7),  # wider at some
    ],
)
def test_points_stand_where_the_view_projects_them(view):
    seen = reproject(dots(SOURCE, sigma=6), SOURCE, view)
    assert seen.size == (view.width, view.height)
    np.testing.assert_allclose(centers_of_mass(seen), view.project(POINTS), atol=0.05)


FILTERS = {"bilinear": Image.Resampling.BILINEAR, "bicubic": Image.Resampling.BICUBIC}


@pytest.mark.parametrize("interpolation", FILTERS)
@settings(max_examples=40, deadline=None)
@given(st.integers(1, 300), st.integers(1, 300), st.integers(1, 90), st.integers(1, 90))
def test_of_the_same_camera_it_is_the_plain_resize(
    interpolation, width, height, new_width, new_height
):
    image = noise_image(width, height)
    source = URSO_CAMERA.resized(width, height)
    view = URSO_CAMERA.resized(new_width, new_height)
    seen = reproject(image, source, view, interpolation)
    expected = image.resize((new_width, new_height), FILTERS[interpolation])
    assert seen.tobytes() == expected.tobytes()


@pytest.mark.parametrize("interpolation", FILTERS)
@pytest.mark.parametrize("focal", [3.0, 8.0, 11.0, 20.0, 47.0])
def test_beyond_the_image_everything_is_black(interpolation, focal):
    """As if the image lay on a black canvas, wider than the view sees."""
    image, source = noise_image(20, 20), Camera(20, 20, 20.0, 20.0, 10.0, 10.0)
    view = Camera(120, 120, focal, focal, 60.0, 60.0)
    canvas = Image.new("RGB", (2020, 2020))
    canvas.paste(image, (1000, 1000))
    corners = [1010 + 20 * (edge - 60) / focal for edge in (0, 120)]
    box = (corners[0], corners[0], corners[1], corners[1])
    expected = canvas.resize((120, 120), FILTERS[interpolation], box=box)
    got = reproject(image, source, view, interpolation)
    np.testing.assert_allclose(np.asarray(got, int), np.asarray(expected, int), atol=1)


@settings(max_examples=40, deadline=None)
@given(st.integers(-60, 60), st.integers(-60, 60), st.integers(1, 150), st.integers(1, 150))
def test_of_the_same_focal_lengths_it_is_a_crop(left, top, width, height):
    """Whole pixels move by whole pixels, and what was not seen is black."""
    image = noise_image(50, 40)
    source = Camera(50, 40, 30.0, 30.0, 25.0, 20.0)
    view = source.cropped(left, top, width, height)
    rows, columns = np.arange(height) + top, np.arange(width) + left
    expected = np.zeros((height, width, 3), np.uint8)
    inside = np.ix_((rows >= 0) & (rows < 40), (columns >= 0) & (columns < 50))
    if not expected[inside].size:
        with pytest.raises(ValueError, match=r"view: expected one that .* covers in part"):
            reproject(image, source, view)
        return
    expected[inside] = np.asarray(image)[
        np.ix_(rows[(rows >= 0) & (rows < 40)], columns[(columns >= 0) & (columns < 50)])
    ]
    np.testing.assert_array_equal(np.asarray(reproject(image, source, view)), expected)


def test_what_the_source_did_not_see_is_black():
    white = Image.new("RGB", (100, 80), (255, 255, 255))
    source = Camera(100, 80, 100.0, 100.0, 50.0, 40.0)
    seen = np.asarray(reproject(white, source, Camera(100, 80, 25.0, 25.0, 50.0, 40.0)))
    # A quarter of the focal length: 25 x 20 pixels, from 37.5 to 62.5 and from 30 to 50.
    # The filter reaches one pixel of the view across the edge.
    assert (seen[31:49, 39:61] == 255).all()
    assert seen[:, :36].max() == seen[:, 64:].max() == seen[:29].max() == seen[51:].max() == 0
    assert seen[40, :, 0].sum() / 255 == pytest.approx(25, abs=0.1)


def test_a_view_far_wider_than_the_image_is_made_at_once():
    """The naive way, a canvas of all that the view covers, would take 5 GB here."""
    view = Camera(1000, 1000, 10.0, 10.0, 500.0, 500.0)
    source = Camera(400, 400, 400.0, 400.0, 200.0, 200.0)
    seen = np.asarray(reproject(Image.new("RGB", (400, 400), (255, 255, 255)), source, view), int)
    assert seen[..., 0].sum() / 255 == pytest.approx(10 * 10, rel=0.02)
    assert np.argwhere(seen[..., 0] > 0).min() >= 493
    assert np.argwhere(seen[..., 0] > 0).max() <= 506


@pytest.mark.parametrize(
    "view",
    [
        Camera(64, 48, 50.0, 50.0, 5000.0, 24.0),  # looks past the image
        Camera(64, 48, 0.1, 0.1, 32.0, 24.0),  # the image is a speck
    ],
)
def test_a_view_of_nothing_is_refused(view):
    with pytest.raises(ValueError, match=r"expected one that .*width=320.* covers in part, got"):
        reproject(noise_image(320, 240), SOURCE, view)


def test_the_image_is_the_sources():
    with pytest.raises(
        ValueError, match=r"expected \(width, height\) \(320, 240\), .*got \(240, 320\)"
    ):
        reproject(noise_image(240, 320), SOURCE, URSO_CAMERA)


VIEW = Camera(64, 48, 50.0, 51.0, 30.0, 20.0)
PLAIN = Preprocessing((48, 64), "center_crop", mean=(0.1, 0.2, 0.3), std=(0.5, 0.6, 0.7))


def test_the_network_gets_the_view_standardized():
    way = Reprojection.of(PLAIN, SOURCE, VIEW)
    image = noise_image(640, 480)  # the source's, twice as large
    pixels = np.asarray(reproject(image, SOURCE.resized(640, 480), VIEW)) / 255
    expected = (pixels - (0.1, 0.2, 0.3)) / (0.5, 0.6, 0.7)
    got = way(image).permute(1, 2, 0)
    assert got.dtype == torch.float32
    np.testing.assert_allclose(got, expected, atol=1e-6)
    assert way.camera(SOURCE) == VIEW
    assert way.image_camera(VIEW, 640, 480) == SOURCE.resized(640, 480)


def test_a_network_trained_with_another_filter_gets_that_one():
    """Of its own camera, reprojection is the network's resize, in all that this consists of."""
    bicubic = replace(PLAIN, mode="resize", interpolation="bicubic")
    image = noise_image(640, 480)
    way = Reprojection.of(bicubic, SOURCE, SOURCE.resized(64, 48))
    np.testing.assert_array_equal(way.array(image), bicubic.array(image))
    bilinear = replace(bicubic, interpolation="bilinear")
    assert np.abs(way.array(image) - bilinear.array(image)).max() > 0.01


def test_an_image_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"aspect ratio of .*width=320.*got 64x64"):
        Reprojection.of(PLAIN, SOURCE, VIEW)(noise_image(64, 64))


def test_the_view_has_the_inputs_size():
    with pytest.raises(ValueError, match=r"view: expected \(height, width\) \(48, 64\), got"):
        Reprojection.of(PLAIN, SOURCE, replace(VIEW, width=65))


def test_a_source_with_distortion_is_undistorted_first():
    lens = DistortedCamera(320, 240, 210.0, 214.0, 150.5, 127.25, (0.1, 0.0, 0.0, 0.0, 0.0))
    view = Camera(64, 48, 42.0, 43.0, 31.0, 25.0)
    image = noise_image(320, 240)
    bent = Reprojection.of(Preprocessing((48, 64)), lens, view)
    flat = Reprojection.of(Preprocessing((48, 64)), lens.pinhole, view)
    np.testing.assert_array_equal(bent.frame(image), flat.frame(undistort(image, lens)))
    assert (bent.frame(image) != flat.frame(image)).any()
    assert bent.image_camera(view, 320, 240) == lens


def test_distortion_is_not_ignored():
    lens = DistortedCamera(320, 240, 210.0, 214.0, 150.5, 127.25, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="expected a camera without distortion"):
        reproject(noise_image(320, 240), lens, VIEW)
