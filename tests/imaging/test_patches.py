"""Stored views: averages by NumPy, windows that hold the pixels which their cameras name."""

import numpy as np
import pytest

from ffpose.datasets.patches import open_patches
from ffpose.geometry import Camera, Pose
from ffpose.imaging.patches import (
    LABELS,
    PatchSpec,
    averaged,
    extract_patches,
    nearest_pixels,
)

CAMERA = Camera(256, 192, 200.0, 190.0, 120.0, 100.0)
SPEC = PatchSpec(CAMERA, first_stride=4, object_width=32, object_radius_m=3.0)
UNTURNED = (1, 0, 0, 0)
SIDE = 80  # of a window: twice the virtual camera's 32 pixels, and 16


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def pixels(generator, height, width):
    return generator.integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize(("side", "size"), [(1, (6, 7)), (2, (8, 6)), (3, (10, 11)), (4, (9, 15))])
def test_averages_are_rounded_means_of_blocks(generator, side, size):
    image = pixels(generator, *size)
    rows, columns = size[0] // side, size[1] // side
    expected = np.empty((rows, columns, 3), np.uint8)
    for i, j in np.ndindex(rows, columns):
        block = image[i * side : (i + 1) * side, j * side : (j + 1) * side].astype(np.float64)
        expected[i, j] = np.floor(block.mean(axis=(0, 1)) + 0.5)
    got = averaged(image, side)
    assert got.dtype == np.uint8
    np.testing.assert_array_equal(got, expected)


def test_averages_of_white_do_not_overflow():
    white = np.full((64, 64, 3), 255, np.uint8)
    assert (averaged(white, 64) == 255).all()


@pytest.mark.parametrize("corner", [(20, 30), (-40, -10), (150, 130), (-300, 5), (7, 400)])
def test_a_window_is_black_outside_the_image(generator, corner):
    image = pixels(generator, 192, 256)
    left, top = corner
    around = 500
    padded = np.pad(image, ((around, around), (around, around), (0, 0)))
    expected = padded[around + top :, around + left :][:48, :48]
    window = CAMERA.cropped(left, top, 48, 48)
    np.testing.assert_array_equal(nearest_pixels(image, CAMERA, window), expected)


@pytest.mark.parametrize(
    ("distance", "level"),
    [(100, 0), (23.5, 0), (23.4, 1), (11.8, 1), (11.6, 2), (5.9, 2), (5.8, 3), (0.1, 3)],
)
def test_the_level_has_pixels_like_the_virtual_cameras(distance, level):
    """The virtual focal length is 16 distance / 3; twice 0.8 of the camera's 200 at 23.44 m."""
    assert SPEC.level(np.array([0.0, 0.0, distance])) == level
    # At 60 degrees off the axis a pinhole image is twice as large, as at half the distance.
    oblique = distance * np.array([np.sin(np.pi / 3), 0, np.cos(np.pi / 3)])
    assert SPEC.level(oblique) == SPEC.level(np.array([0.0, 0.0, distance / 2]))


def empty_arrays(spec, count=1):
    return {name: np.zeros(shape, dtype) for name, (shape, dtype) in spec.shapes(count).items()}


def named_pixels(camera):
    """An image whose red and green say column and row."""
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    image[..., 0] = np.arange(camera.width)
    image[..., 1] = np.arange(camera.height)[:, None]
    image[..., 2] = 255
    return image


def label(arrays, name):
    return arrays["labels"][0, LABELS.index(name)]


@pytest.mark.parametrize("size", [(256, 192), (251, 189)])
@pytest.mark.parametrize(
    ("t", "level"),
    [((3.0, -2.0, 24.0), 0), ((2.0, 1.5, 14.0), 1), ((-1, 1, 7), 2), ((1.0, 0.6, 3.0), 3)],
)
def test_a_window_shows_what_its_camera_says(generator, size, t, level):
    """Each point lies in the very pixel of the image that its pixel of the window was made of."""
    camera = Camera(*size, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    spec = PatchSpec(camera, SPEC.first_stride, SPEC.object_width, SPEC.object_radius_m)
    arrays = empty_arrays(spec)
    extract_patches(named_pixels(camera), Pose(t, UNTURNED), spec).store(arrays, 0)
    assert label(arrays, "level") == level
    window = Camera(SIDE, SIDE, *(label(arrays, name) for name in ("fx", "fy", "cx", "cy")))

    middle = window.project(t)
    assert np.abs(middle - SIDE / 2).max() <= 0.5 + 1e-9
    points = t + generator.uniform(-0.3, 0.3, (4000, 3)) * t[2]
    column, row = np.floor(window.project(points)).astype(int).T
    inside = (column >= 0) & (column < SIDE) & (row >= 0) & (row < SIDE)
    source = camera.project(points[inside])
    seen = arrays["windows"][0, row[inside], column[inside]].astype(np.float64)
    side = 2**level
    covered = np.array([camera.width // side, camera.height // side]) * side
    shown = ((source >= 0) & (source < covered)).all(axis=-1)
    assert shown.sum() > 500
    centers = seen[shown, :2] + (0.5 if level == 0 else 0)  # a mean of indices is rounded up
    assert np.abs(source[shown] - centers).max() <= side / 2 + 1e-6
    assert not seen[~shown].any()


def test_a_row_holds_frame_labels_and_coordinates(generator):
    asked = []

    def coordinates(camera):
        asked.append(camera)
        return np.full((camera.height, camera.width, 4), 9, np.uint8)

    image, pose = pixels(generator, 192, 256), Pose((1, 2, 20), (0.6, 0, -0.8, 0))
    arrays = empty_arrays(SPEC, 3)
    extract_patches(image, pose, SPEC, coordinates).store(arrays, 1)
    np.testing.assert_array_equal(arrays["frames"][1], averaged(image, 4))
    assert arrays["frames"].shape[1:3] == SPEC.frame_size == (48, 64)
    np.testing.assert_array_equal(arrays["labels"][1, :7], [1, 2, 20, 0.6, 0, -0.8, 0])
    assert arrays["labels"][1, -1] == 1
    assert (arrays["coordinates"][1] == 9).all()
    (camera,) = asked
    # The camera of the window, its pixels two by two.
    assert (camera.width, camera.height) == (SIDE // 2, SIDE // 2)
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy], arrays["labels"][1, 7:11] / 2
    )
    for name in arrays:
        assert not arrays[name][[0, 2]].any()


def test_nearest_pixels_are_those_that_a_resize_and_a_crop_take(generator):
    picture = generator.integers(0, 256, (192, 256, 4), dtype=np.uint8)
    other = CAMERA.cropped(-7, 20, 300, 100)
    expected = np.zeros((100, 300, 4), np.uint8)
    expected[:, 7:263] = picture[20:120]
    np.testing.assert_array_equal(nearest_pixels(picture, CAMERA, other), expected)
    twice = np.repeat(np.repeat(picture, 2, axis=0), 2, axis=1)
    np.testing.assert_array_equal(nearest_pixels(picture, CAMERA, CAMERA.resized(512, 384)), twice)


def test_refused_views(generator):
    behind = Pose((0, 0, -5), UNTURNED)
    with pytest.raises(ValueError, match="translation: expected z > 0, got"):
        extract_patches(pixels(generator, 192, 256), behind, SPEC)
    ahead = Pose((0, 0, 5), UNTURNED)
    with pytest.raises(ValueError, match=r"image: expected shape \(192, 256, 3\), got \(193, 256"):
        extract_patches(pixels(generator, 193, 256), ahead, SPEC)


def test_arrays_on_disk(generator, tmp_path):
    arrays = empty_arrays(SPEC, 2)
    extract_patches(pixels(generator, 192, 256), Pose((1, 2, 20), UNTURNED), SPEC).store(arrays, 1)
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    opened = open_patches(tmp_path)
    assert opened.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(opened[name], array)
        assert not opened[name].flags.writeable
