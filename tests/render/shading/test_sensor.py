"""Options that change the picture: they leave the label where it is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from ffpose.render import SCENES, Randomization, Sensor, render, render_layers
from ffpose.render.shading.sensor import expose

SILENT = Sensor(0, 0, 0, 1e9, 0, 0)
SIZE = (128, 96)


def centroid(image):
    weight = image[..., 0].astype(float)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


def linear(image):
    codes = (image - image.min()) / 255
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("seed", range(4))
def test_motion_blur_spreads_light_about_its_place(seed):
    point = np.zeros((65, 1280, 3), np.float32)
    point[31:34, 639:642] = 0.6
    sensor = replace(SILENT, motion_px=20.0)
    still = linear(expose(point, 1.0, SILENT, np.random.default_rng(seed)))
    moved = linear(expose(point, 1.0, sensor, np.random.default_rng(seed)))
    assert (moved > 1e-3).sum() > (still > 1e-3).sum()
    assert moved.sum() == pytest.approx(still.sum(), rel=0.05)
    np.testing.assert_allclose(centroid(moved), (640, 32), atol=0.05)


@pytest.mark.parametrize(("blur_px", "width"), [(0.9, 1280), (3.0, 1280), (0.7, 2560)])
def test_blur_of_any_width_is_scipys_gaussian(blur_px, width):
    """Blur acts on linear light, with the border replicated."""
    picture = np.repeat(np.random.default_rng(0).random((8, width // 4, 3), np.float32), 4, axis=0)
    picture = np.repeat(picture, 4, axis=1)
    sigma = blur_px * width / 1280
    bell = ndimage.gaussian_filter(picture, (sigma, sigma, 0), mode="nearest", truncate=6.0)
    expected, got, sharp = (
        expose(light, 1.0, sensor, np.random.default_rng(0)).astype(int)
        for light, sensor in [
            (bell, SILENT),
            (picture, replace(SILENT, blur_px=blur_px)),
            (picture, SILENT),
        ]
    )
    assert np.abs(got - expected).max() <= 1
    assert np.abs(sharp - expected).max() > 20


@pytest.mark.parametrize("blur_px", [0.3, 0.8])
def test_the_variance_of_a_blur_below_a_pixel_is_its_own(blur_px):
    point = np.zeros((33, 1280, 3), np.float32)
    point[16, 640] = 0.6
    image = linear(expose(point, 1.0, replace(SILENT, blur_px=blur_px), np.random.default_rng(0)))
    weight = image[..., 0] / image[..., 0].sum()
    v, u = np.mgrid[:33, :1280]
    for spread in ((v - 16) ** 2, (u - 640) ** 2):
        assert (weight * spread).sum() == pytest.approx(blur_px**2, rel=0.06)  # eight bits


def test_jpeg_is_close_and_lower_quality_is_farther():
    picture = render("soyuz_easy", 2, 0, (256, 192)).image.astype(float)
    misses = []
    for quality in (95, 20):
        sensor = Sensor(jpeg_quality=quality)
        scene = replace(SCENES["soyuz_easy"], sensor=sensor)
        misses.append(np.abs(render(scene, 2, 0, (256, 192)).image - picture).mean())
    assert 0 < misses[0] < misses[1] < 10


@pytest.mark.parametrize(
    "changed",
    [
        {"sensor": Sensor(motion_px=8.0, jpeg_quality=50)},
        {"randomization": Randomization.of_strength(1.0)},
        {"randomization": Randomization(materials=0.5)},
        {"randomization": Randomization(light=0.5, exposure=0.5)},
    ],
    ids=["sensor", "all", "materials", "light"],
)
def test_options_change_pixels_and_no_label(changed):
    scene = replace(SCENES["soyuz_easy"], **changed)
    plain, other = render("soyuz_easy", 4, 1, SIZE), render(scene, 4, 1, SIZE)
    again = render(scene, 4, 1, SIZE)
    np.testing.assert_array_equal(other.image, again.image)
    assert (plain.image != other.image).any()
    np.testing.assert_array_equal(plain.pose.vector, other.pose.vector)
    mask = render_layers("soyuz_easy", 4, 1, SIZE).mask
    np.testing.assert_array_equal(render_layers(scene, 4, 1, SIZE).mask, mask)


def test_background_is_replaced_at_the_stated_rate():
    scene = replace(SCENES["soyuz_easy"], randomization=Randomization(background=0.5))
    same = sum(
        np.array_equal(render(scene, 0, index, (32, 24)).image[0], plain.image[0])
        for index in range(24)
        for plain in [render("soyuz_easy", 0, index, (32, 24))]
    )
    assert 4 <= same <= 20


@pytest.mark.parametrize(
    "wrong",
    [
        {"blur_px": -0.1},
        {"blur_px": 21.0},
        {"blur_px": np.nan},
        {"motion_px": -1.0},
        {"motion_px": 1e4},
        {"jpeg_quality": 101},
        {"jpeg_quality": -1},
    ],
)
def test_absurd_options_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Sensor(**wrong)


@pytest.mark.parametrize("wrong", [{"light": -0.1}, {"background": 1.5}, {"materials": np.inf}])
def test_absurd_randomization_is_refused(wrong):
    with pytest.raises(ValueError, match="randomization"):
        Randomization(**wrong)
