"""Sets that differ from one in a single thing, held against single renderings and arithmetic."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from beacons import beacon_scene
from ffpose.render import SCENES, render, render_empty
from ffpose.render.processes import ahead
from ffpose.render.shading.sensor import Sensor, expose
from ffpose.render.variations import (
    Variation,
    finished,
    noisier,
    render_variations,
    variations,
    without_object,
)

SIZE = (64, 48)
SEED = 1_000_000
EASY = SCENES["soyuz_easy"]


def rendered(chosen, count=2, workers=1):
    frames = {variation.name: [] for variation in chosen}
    for variation, frame in render_variations(chosen, SEED, count, SIZE, workers):
        frames[variation.name].append(frame)
    return frames


@pytest.fixture(scope="module")
def tried():
    chosen = variations(beacon_scene(), 16.0)
    return {v.name: v for v in chosen}, rendered(chosen)


def test_pictures_that_are_rendered_together_are_those_of_each_set_alone(tried):
    chosen, frames = tried
    alike = ("as trained", "noise doubled", "JPEG 50", "randomize 0.5", "beyond range")
    for name in alike:
        for index, frame in enumerate(frames[name]):
            alone = render(chosen[name].scene, SEED, index, SIZE)
            np.testing.assert_array_equal(frame.image, alone.image)
            np.testing.assert_array_equal(frame.pose.vector, alone.pose.vector)
    pictures = {frames[name][0].image.tobytes() for name in alike}
    assert len(pictures) == len(alike)


def test_kept_pictures_are_those_that_were_rendered_and_are_not_rendered_again(
    tried, tmp_path, monkeypatch
):
    chosen, frames = tried
    some = [chosen[name] for name in ("as trained", "blur", "monochrome", "JPEG 50")]
    some.append(without_object(chosen["as trained"].scene)[0])
    first = [f.image for _, f in render_variations(some, SEED, 2, SIZE, 1, tmp_path)]
    monkeypatch.setattr("ffpose.render.variations.shoot_each", None)
    again = list(render_variations(some, SEED, 2, SIZE, 1, tmp_path))
    for image, (variation, frame) in zip(first, again, strict=True):
        np.testing.assert_array_equal(frame.image, image)
        if not variation.empty:
            expected = frames[variation.name]
            assert any(frame.pose == each.pose for each in expected)
    with pytest.raises(TypeError):  # of another seed there are none
        next(render_variations(some, SEED + 1, 2, SIZE, 1, tmp_path))
    monkeypatch.setattr("ffpose.render.variations.__version__", "0.0.1")
    with pytest.raises(TypeError):  # nor of another version
        next(render_variations(some, SEED, 2, SIZE, 1, tmp_path))


def test_poses_are_shared_wherever_the_variation_leaves_them(tried):
    _, frames = tried
    poses = {name: np.stack([f.pose.vector for f in found]) for name, found in frames.items()}
    for name in ("noise doubled", "blur", "monochrome", "JPEG 50", "randomize 0.5"):
        np.testing.assert_array_equal(poses[name], poses["as trained"])
    distance = np.linalg.norm(poses["beyond range"][:, :3], axis=1)
    assert ((distance >= 16.0) & (distance <= 1.3 * 16.0)).all()


def test_a_monochrome_picture_has_the_luma_of_the_colored_one(tried):
    """By the weights of ITU-R BT.601, within a rounding."""
    _, frames = tried
    for gray, colored in zip(frames["monochrome"], frames["as trained"], strict=True):
        luma = colored.image @ [0.299, 0.587, 0.114]
        np.testing.assert_allclose(gray.image, np.stack([luma] * 3, axis=-1), atol=0.51)


def test_attitudes_are_those_of_the_set(tried):
    chosen, _ = tried
    attitudes = beacon_scene().attitude_range_deg
    assert {v.scene.attitude_range_deg for v in chosen.values()} == {attitudes}


def test_the_border_cuts_the_spacecraft_as_it_says(tried):
    """Counted by the pinhole's equation over the points that stand for its extent."""
    _, frames = tried
    camera, points = EASY.camera, beacon_scene().build().outline
    for frame in frames["cut by the border"]:
        x, y, z = frame.pose.rotation @ points.T + frame.pose.t[:, None]
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
        assert 0.3 <= inside.mean() <= 0.6


@pytest.mark.parametrize(
    "sensor", [Sensor(full_well=1e3, read_noise=0), Sensor(full_well=1e6, read_noise=2e4)]
)
def test_noise_has_twice_the_standard_deviation(sensor):
    plain = replace(sensor, blur_px=0, vignette=0, bloom=0)
    grey = np.full((128, 128, 3), 0.3, np.float32)
    before, after = (
        expose(grey, 1.0, s, np.random.default_rng(0)).std() for s in (plain, noisier(plain))
    )
    assert after / before == pytest.approx(2, rel=0.03)


@pytest.mark.parametrize("width", [320, 640])
def test_a_blur_has_the_standard_deviation_it_names(width):
    """The second moment of what becomes of one bright column."""
    image = np.zeros((33, width, 3), np.uint8)
    image[:, width // 2] = 255
    row = finished(image, Variation("", "", EASY, blur_px=1.5))[16, :, 0].astype(float)
    place = np.arange(width) - width // 2
    sigma = np.sqrt((row * place**2).sum() / row.sum())
    assert sigma == pytest.approx(1.5 * width / 640, rel=0.1)


def test_without_the_object_its_place_is_empty_or_taken_by_another():
    chosen = without_object(EASY)
    frames = rendered(chosen, 1)
    alone = render_empty(chosen[0].scene, SEED, 0, SIZE)
    np.testing.assert_array_equal(frames["empty scenes"][0].image, alone)
    assert chosen[1].scene.craft == "dragon"
    assert without_object(SCENES["dragon_hard"])[1].scene.craft == "soyuz"
    assert not np.array_equal(frames["another spacecraft"][0].image, alone)


def test_any_number_of_processes_makes_the_same_pictures():
    chosen = [Variation("small", "", EASY)]
    one, two = (rendered(chosen, 4, workers)["small"] for workers in (1, 2))
    for first, second in zip(one, two, strict=True):
        np.testing.assert_array_equal(first.image, second.image)


def test_no_more_is_rendered_ahead_than_stated():
    """Results wait in memory until they are taken, and a picture is a megabyte."""
    started = []
    with ThreadPoolExecutor(2) as pool:
        results = ahead(lambda n: pool.submit(lambda: started.append(n) or [n]), range(20), 3)
        for taken in range(1, 6):
            assert next(results) == [taken - 1]
            pool.submit(lambda: None).result()
            assert len(started) <= taken + 2
        assert list(results) == [[n] for n in range(5, 20)]
