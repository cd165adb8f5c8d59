"""Images are pure functions of their arguments, and look lit as physics says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from beacons import beacon_scene
from earth import Earth
from ffpose.render import (
    SCENES,
    Randomization,
    label,
    render,
    render_empty,
    render_layers,
    renderer,
)
from ffpose.render.shading.rays import find_window
from ffpose.render.shading.sensor import Sensor, expose
from ffpose.render.shading.vectors import unit

SIZE = (128, 96)


@pytest.mark.parametrize("name", SCENES)
def test_render_is_pure(name):
    first = render(name, 3, 1, SIZE)
    render(name, 3, 2, SIZE)
    again = render(name, 3, 1, SIZE)
    np.testing.assert_array_equal(first.image, again.image)
    assert first.image.shape == (96, 128, 3)
    assert first.image.dtype == np.uint8
    assert first.image.std() > 1


def test_seed_and_index_matter_and_size_does_not_move_the_pose():
    base = label("soyuz_easy", 0, 0).vector
    assert not np.array_equal(base, label("soyuz_easy", 0, 1).vector)
    assert not np.array_equal(base, label("soyuz_easy", 1, 0).vector)
    np.testing.assert_array_equal(render("soyuz_easy", 0, 0, (64, 48)).pose.vector, base)
    np.testing.assert_array_equal(render("soyuz_easy", 0, 0, (96, 96)).pose.vector, base)


def test_default_size_is_that_of_the_camera():
    frame = render(beacon_scene(), 0, 0)
    assert frame.image.shape == (960, 1280, 3)
    assert frame.camera == SCENES["soyuz_easy"].camera


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1)])
@pytest.mark.parametrize("draw", [render, render_empty])
def test_negative_seed_or_index_is_refused(draw, seed, index):
    with pytest.raises(ValueError, match="seed and index"):
        draw("soyuz_easy", seed, index, SIZE)


@pytest.mark.parametrize("clouds", [0.0, 1.0])
def test_an_empty_frame_lacks_the_spacecraft_and_nothing_else(monkeypatch, clouds):
    """With one exposure, and a sensor that mixes no pixels, all beside the spacecraft is equal."""
    choose = renderer.choose_gain

    def fixed_gain(*arguments):
        choose(*arguments)  # its random draw is taken
        return 1.0

    monkeypatch.setattr(renderer, "choose_gain", fixed_gain)
    scene = replace(
        SCENES["soyuz_easy"],
        sensor=Sensor(blur_px=0, bloom=0),
        randomization=Randomization(light=0.5, background=clouds, materials=0.5),
    )
    for index in range(3):
        frame, empty = render(scene, 3, index, SIZE), render_empty(scene, 3, index, SIZE)
        window = find_window(scene.build().mesh.vertices, frame.pose, frame.camera)
        inside = np.zeros(empty.shape[:2], dtype=bool)
        inside[window.top : window.bottom, window.left : window.right] = True
        assert 0.01 < inside.mean() < 0.9
        np.testing.assert_array_equal(empty[~inside], frame.image[~inside])
        mask = render_layers(scene, 3, index, SIZE).mask
        assert np.abs(empty[mask].astype(int) - frame.image[mask]).mean() > 5


def test_an_empty_frame_is_pure_and_exposed_for_itself():
    """A brighter or darker spacecraft changes nothing."""
    scene = SCENES["soyuz_easy"]
    for index in range(3):
        empty = render_empty(scene, 3, index, SIZE)
        assert empty.shape == (96, 128, 3)
        assert empty.dtype == np.uint8
        np.testing.assert_array_equal(render_empty(scene, 3, index, SIZE), empty)
        other = replace(scene, craft="dragon")
        np.testing.assert_array_equal(render_empty(other, 3, index, SIZE), empty)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_exposure_neither_hides_nor_burns_the_spacecraft(name, rate):
    """In sunlight, and in eclipse by the lamp alone."""
    scene = replace(SCENES[name], eclipse_rate=rate)
    for index in range(4):
        seen = render(scene, 3, index, SIZE).image[render_layers(scene, 3, index, SIZE).mask]
        assert np.median(seen.mean(axis=1)) > 20
        assert (seen.min(axis=1) > 250).mean() < 0.1


def rays_from_nadir(degrees):
    angle = np.radians(np.atleast_1d(degrees))
    return np.stack([np.sin(angle), 0 * angle, np.cos(angle)]).astype(np.float32)


def earth(sun):
    return Earth(np.array([0.0, 0.0, 1.0]), 0.0628, np.asarray(sun, dtype=float), np.eye(3))


def test_earth_ends_at_the_horizon():
    # asin(1 / 1.0628) = 70.21 degrees from nadir; the air ends within two degrees above.
    light, behind = earth((0, 0, -1)).shade(rays_from_nadir([0, 40, 69.9, 75, 120]), 1e-3)
    assert (behind[:3] == 0).all()
    assert (behind[3:] == 1).all()
    assert (light[:, :3].min(axis=0) > 0.01).all()
    assert (light[:, 3:] == 0).all()


def test_air_glows_blue_above_the_limb():
    light, behind = earth((0, 0, -1)).shade(rays_from_nadir([70.6]), 1e-4)
    assert 0 < behind[0] < 1
    assert light[2, 0] > light[1, 0] > light[0, 0] > 0


def test_night_side_is_dark():
    rays = unit(np.random.default_rng(0).normal((0, 0, 3), 1, (400, 3)).T.astype(np.float32))
    by_day, _ = earth((0, 0, -1)).shade(rays, 1e-3)
    by_night, _ = earth((0, 0, 1)).shade(rays, 1e-3)
    assert by_night.mean() < 0.02 * by_day.mean()


def test_sensor_is_linear_in_the_dark_and_never_wraps():
    silent = Sensor(0, 0, 0, 1e9, 0, 0)
    level = np.linspace(0, 100, 64 * 48, dtype=np.float32).reshape(48, 64, 1).repeat(3, axis=2)
    image = expose(level, 0.02, silent, np.random.default_rng(0))
    assert (np.diff(image.reshape(-1, 3).astype(int), axis=0) >= 0).all()
    # sRGB: 18 % gray is 118.
    gray = expose(np.full((16, 16, 3), 0.18, np.float32), 1.0, silent, np.random.default_rng(0))
    assert np.abs(gray.astype(int) - 118).max() <= 1


def test_shot_noise_grows_with_the_root_of_the_signal():
    sensor = Sensor(0, 0, 0, full_well=400, read_noise=0, exposure_spread=0)
    spread = []
    for level in (0.1, 0.4):
        flat = np.full((128, 128, 3), level, np.float32)
        codes = expose(flat, 1.0, sensor, np.random.default_rng(1)) / 255
        linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
        assert linear.mean() == pytest.approx(level, rel=0.03)
        spread.append(linear.std())
    assert spread[0] == pytest.approx(np.sqrt(0.1 / 400), rel=0.1)
    assert spread[1] / spread[0] == pytest.approx(2, rel=0.1)


def test_blur_and_bloom_keep_their_place():
    point = np.zeros((65, 65, 3), np.float32)
    point[32, 32] = 40
    image = expose(point, 1.0, Sensor(20.0, 0, 0.5, 1e9, 0, 0), np.random.default_rng(0))
    np.testing.assert_array_equal(image[32, 31], image[32, 33])
    np.testing.assert_array_equal(image[31, 32], image[33, 32])
    assert image[32, 31].min() > 0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"blur_px": -1}, "blur_px"),
        ({"full_well": 0}, "full_well"),
        ({"full_well": math.inf}, "full_well"),
        ({"vignette": 1.0}, "vignette"),
        ({"bloom": math.nan}, "bloom"),
        ({"read_noise": math.nan}, "read_noise"),
    ],
)
def test_absurd_sensor_is_refused(wrong, said):
    with pytest.raises(ValueError, match=f"^{said}: expected"):
        Sensor(**wrong)
