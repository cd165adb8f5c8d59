"""Views that are rendered as such are those that would be cut out of the whole image."""

from dataclasses import replace

import numpy as np
import pytest

from ffpose.geometry import URSO_CAMERA
from ffpose.imaging.patches import PatchSpec, averaged, extract_patches, in_frame
from ffpose.render import SCENES, Sensor, render_layers, renderer
from ffpose.render.layers import coordinates_limit
from ffpose.render.patches import render_all_patches, render_patches
from ffpose.render.renderer import shoot
from ffpose.render.shading.rays import pixel_rays
from ffpose.render.shading.sensor import expose
from ffpose.render.shading.sky import draw_stars, sun_disk

SILENT = Sensor(vignette=0, bloom=0, full_well=1e12, read_noise=0, exposure_spread=0)
SCENE = replace(SCENES["soyuz_easy"], sensor=SILENT)
SEED = 5
STRIDE = 4


def spec_of(width):
    camera = SCENE.camera.resized(width, width * 3 // 4)
    return PatchSpec(camera, STRIDE, object_width=64, object_radius_m=6.6)


def cut_from_the_whole(scene, index, spec):
    """The pieces of the whole image, whose windows reach over its edge."""
    shot = shoot(scene, SEED, index, spec.camera)
    return extract_patches(shot.image, shot.pose, spec)


@pytest.mark.parametrize(
    ("name", "width", "index", "visible"),
    [
        ("soyuz_easy", 128, 1, 0.42),  # the rest of the window is beyond the frame's edge
        ("soyuz_easy", 128, 4, 0.59),
        ("soyuz_easy", 128, 8, 0.48),
        ("soyuz_easy", 128, 22, 0.46),
        ("soyuz_hard", 512, 17, 1.0),
    ],
)
def test_a_window_of_the_finest_level_is_the_crop_of_the_whole_image(name, width, index, visible):
    """Bit for bit, noise included; glare and vignette are in the window, as there they are seen."""
    scene, spec = SCENES[name], spec_of(width)
    view, whole = render_patches(scene, SEED, index, spec), cut_from_the_whole(scene, index, spec)
    assert view.level == 0
    np.testing.assert_array_equal(view.window, whole.window)
    np.testing.assert_array_equal(view.frame, whole.frame)
    np.testing.assert_array_equal(view.camera.matrix, whole.camera.matrix)
    assert view.pose == whole.pose
    assert in_frame(view.camera, spec.camera).mean() == pytest.approx(visible, abs=0.005)
    for without in ({"bloom": 0.0}, {"vignette": 0.0}):
        other = replace(scene, sensor=replace(scene.sensor, **without))
        assert (cut_from_the_whole(other, index, spec).window != whole.window).any()


@pytest.mark.parametrize(
    ("name", "index", "level"),
    [
        ("soyuz_hard", 1, 1),  # the vignette changes its window by 4.6 codes in the mean
        ("soyuz_hard", 8, 1),  # glare by 1.0
        ("soyuz_hard", 22, 1),  # glare by 2.3
        ("soyuz_hard", 5, 2),
        ("soyuz_hard", 12, 2),
        ("soyuz_hard", 23, 2),
        ("soyuz_easy", 15, 3),
        ("soyuz_easy", 18, 3),
    ],
)
def test_a_coarser_window_is_nearly_the_crop_of_the_whole_image(name, index, level):
    """Within 1.5 codes in the mean, without noise.

    A pixel of twice the width sees edges and highlights otherwise, and a twentieth of the light of
    highlights beyond full scale is glare.
    """
    sensor = replace(SCENES[name].sensor, full_well=1e12, read_noise=0)
    scene, spec = replace(SCENES[name], sensor=sensor), spec_of(512)
    view, whole = render_patches(scene, SEED, index, spec), cut_from_the_whole(scene, index, spec)
    assert view.level == whole.level == level
    np.testing.assert_array_equal(view.camera.matrix, whole.camera.matrix)
    inside = in_frame(view.camera, spec.level_camera(level))
    got, expected = (piece.window[inside].astype(int) for piece in (view, whole))
    moved = np.roll(view.window, 1, axis=1)[inside].astype(int)
    off = np.abs(got - expected).mean()
    assert off < 1.5
    assert np.abs(moved - expected).mean() > 2 * off
    assert np.abs(view.frame.astype(int) - whole.frame).mean() < 1.5


def test_a_stride_that_cannot_be_halved_is_cut_from_the_whole_image():
    spec = replace(spec_of(512), first_stride=3)
    view, whole = (
        render_patches(SCENE, SEED, 12, spec),
        cut_from_the_whole(SCENE, 12, spec),
    )
    np.testing.assert_array_equal(view.frame, whole.frame)
    np.testing.assert_array_equal(view.window, whole.window)


@pytest.mark.parametrize("index", range(4))
def test_coordinates_are_of_the_surface_that_their_place_shows(index):
    view = render_patches(SCENE, SEED, index, spec_of(128))
    rows, columns = np.nonzero(view.coordinates[..., 3])
    assert len(rows) > 30
    codes = view.coordinates[rows, columns, :3].astype(float)
    points = (2 * codes / 255 - 1) * coordinates_limit(SCENE.build())
    half = view.camera.resized(view.window.shape[0] // 2, view.window.shape[1] // 2)
    found = half.project(view.pose.transform(points))
    np.testing.assert_allclose(found, np.stack([columns, rows], axis=1) + 0.5, atol=0.5)


@pytest.mark.parametrize("index", range(4))
def test_the_silhouette_is_that_of_the_whole_image(index):
    spec = spec_of(128)
    view = render_patches(SCENE, SEED, index, spec)
    mask = render_layers(SCENE, SEED, index, (1024, 768)).mask
    share = mask.reshape(96, 8, 128, 8).mean(axis=(1, 3))
    share = np.repeat(share[..., None], 3, axis=2)
    covered = extract_patches((share * 255).astype(np.uint8), view.pose, spec).window[..., 0] / 255
    covered = covered.reshape(72, 2, 72, 2).mean(axis=(1, 3))
    shown = view.coordinates[..., 3] > 0
    assert shown[covered == 1].all()
    assert not shown[covered == 0].any()
    assert (shown & (covered > 0.5)).sum() > 0.75 * (shown | (covered > 0.5)).sum()


def test_beyond_the_frames_edge_a_view_shows_nothing():
    spec = spec_of(128)
    cut_off = 0
    for index in range(4):
        view = render_patches(SCENE, SEED, index, spec)
        outside = ~in_frame(view.camera, spec.level_camera(view.level))
        assert not view.window[outside].any()
        assert not view.coordinates[outside[::2, ::2]].any()
        assert not view.coordinates[outside[1::2, 1::2]].any()
        cut_off += render_layers(SCENE, SEED, index, (128, 96)).mask[:, [0, -1]].any()
    assert cut_off  # the spacecraft reaches the edge


def test_an_empty_view_lacks_the_spacecraft_alone(monkeypatch):
    monkeypatch.setattr(renderer, "choose_gain", lambda *_: 2.0)
    spec = spec_of(128)
    view, empty = (render_patches(SCENE, SEED, 1, spec, content) for content in ("object", "empty"))
    assert (view.present, empty.present) == (True, False)
    assert not empty.coordinates.any()
    assert view.pose == empty.pose
    differ = (view.window != empty.window).any(axis=2)
    rows, columns = np.nonzero(view.coordinates[..., 3])
    near = np.zeros_like(differ)
    for row, column in zip(2 * rows, 2 * columns, strict=True):
        near[max(0, row - 4) : row + 6, max(0, column - 4) : column + 6] = True
    assert differ.sum() > 100
    assert not differ[~near].any()


def test_the_noise_of_a_mean_of_pixels_is_that_of_its_sensor():
    """In both: shot noise and read noise fall with the number of pixels, as variances add."""
    sensor = replace(SILENT, blur_px=0.0, full_well=2000.0, read_noise=60.0)
    light = np.full((384, 384, 3), 0.3, np.float32)

    def linear(codes):
        return ((codes / 255 + 0.055) / 1.055) ** 2.4

    fine = linear(expose(light, 1.0, sensor, np.random.default_rng(0)).astype(float))
    means = fine.reshape(192, 2, 192, 2, 3).mean(axis=(1, 3))
    coarse = expose(light[::2, ::2], 1.0, sensor, np.random.default_rng(1), 2)
    expected = np.sqrt(0.3 / 2000 + (60 / 2000) ** 2) / 2
    assert means.std() == pytest.approx(expected, rel=0.05)
    assert linear(coarse.astype(float)).std() == pytest.approx(expected, rel=0.05)


def test_glare_and_vignette_of_a_mean_of_pixels_are_those_of_the_pixels():
    """Where light is even over the pixels of each mean, to rounding."""
    light = np.full((192, 256, 3), 0.1, np.float32)
    light[51:75, 161:177] = (30.0, 10.0, 4.0)
    sensor = replace(SILENT, blur_px=0.0, bloom=0.05, vignette=0.4)
    whole = np.kron(light, np.ones((2, 2, 1), np.float32))
    fine = expose(whole, 1.0, sensor, np.random.default_rng(0))
    coarse = expose(light, 1.0, sensor, np.random.default_rng(0), 2).astype(int)
    np.testing.assert_allclose(coarse, averaged(fine, 2), atol=1)
    plain = expose(light, 1.0, replace(sensor, bloom=0), np.random.default_rng(0), 2)
    assert np.abs(coarse - plain)[light[..., 0] < 1].max() > 20


def test_sun_and_stars_of_a_mean_of_pixels_have_as_much_light():
    fine, coarse = (URSO_CAMERA.resized(width, width * 3 // 4) for width in (128, 64))
    rng = np.random.default_rng(0)
    totals = np.zeros((2, 200))
    for number in range(200):
        sun = np.append(rng.uniform(-0.3, 0.3, 2), 1.0)
        sun /= np.linalg.norm(sun)
        for row, (camera, side) in enumerate(((fine, 1), (coarse, 2))):
            disk = sun_disk(sun, pixel_rays(camera), 1 / camera.fx, side)
            totals[row, number] = side**2 * disk.sum()
    assert totals[1].mean() == pytest.approx(totals[0].mean(), rel=0.02)
    stars = [
        draw_stars(camera, np.random.default_rng(3), side)
        for camera, side in ((fine, 1), (coarse, 2))
    ]
    assert 4 * stars[1].sum() == pytest.approx(stars[0].sum(), rel=0.02)  # some at the border


def test_processes_give_the_views_of_one():
    spec = spec_of(128)
    alone, shared = (
        list(render_all_patches(SCENE, SEED, range(16), spec, "empty", workers))
        for workers in (1, 2)
    )
    for index, (one, other) in enumerate(zip(alone, shared, strict=True)):
        np.testing.assert_array_equal(one.window, other.window)
        np.testing.assert_array_equal(one.frame, other.frame)
        assert one.pose == other.pose == renderer.label(SCENE, SEED, index)
