"""Views that are rendered as such are those that would be cut out of the whole image."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ffpose.render import SCENES, Sensor, render_layers, renderer
from ffpose.render.layers import coordinates_limit
from ffpose.render.renderer import shoot
from ffpose.render.shading.sensor import expose
from ffpose.render.views import averaging, in_window, render_view, render_views
from ffpose.views import WINDOW, ViewSpec, cut_pieces, in_frame

SILENT = Sensor(vignette=0, bloom=0, full_well=1e12, read_noise=0, exposure_spread=0)
SCENE = replace(SCENES["soyuz_easy"], sensor=SILENT)
SEED = 5
STRIDE = 4


def spec_of(width):
    camera = SCENE.camera.resized(width, width * 3 // 4)
    return ViewSpec(camera, STRIDE, object_width=64, object_radius_m=6.6)


def whole_camera(spec, level):
    return spec.camera.resized(spec.camera.width >> level, spec.camera.height >> level)


@pytest.fixture
def one_sampling(monkeypatch):
    """A pixel of a window is lit by as many rays as the pixels that it is the mean of together."""
    by_width = {WINDOW: 4, 256: 2, 128: 4}
    monkeypatch.setattr(renderer, "_sample_count", lambda _, camera: by_width.get(camera.width, 4))
    monkeypatch.setattr(renderer, "choose_gain", lambda *_: 2.0)


@pytest.mark.parametrize(
    ("width", "index", "level"), [(128, 1, 0), (128, 3, 0), (256, 2, 1), (256, 6, 1)]
)
def test_the_window_is_the_crop_of_the_whole_image(one_sampling, width, index, level):
    """Equal up to the nonlinear response curve; a shift by one pixel differs far more."""
    spec = spec_of(width)
    view = render_view(SCENE, SEED, index, spec)
    assert view.level == level
    image = shoot(SCENE, SEED, index, spec.camera, SILENT).image
    cut = cut_pieces(image, view.pose, spec)
    np.testing.assert_array_equal(cut.camera.matrix, view.camera.matrix)
    on_craft = np.kron(view.coordinates[..., 3] > 0, np.ones((2, 2))) > 0
    got, expected = (window[on_craft].astype(int) for window in (view.window, cut.window))
    off = np.abs(got - expected).mean()
    moved = np.roll(view.window, 1, axis=1)[on_craft].astype(int)
    assert off < (0.5 if level == 0 else 5)
    assert np.abs(moved - expected).mean() > 3 * off
    assert np.abs(view.window.astype(int) - cut.window).mean() < 0.5
    assert np.abs(view.frame.astype(int) - cut.frame).mean() < 5


@pytest.mark.parametrize("index", range(4))
def test_coordinates_are_of_the_surface_that_their_place_shows(index):
    view = render_view(SCENE, SEED, index, spec_of(128))
    rows, columns = np.nonzero(view.coordinates[..., 3])
    assert len(rows) > 30
    codes = view.coordinates[rows, columns, :3].astype(float)
    points = (2 * codes / 255 - 1) * coordinates_limit(SCENE.build())
    half = view.camera.resized(WINDOW // 2, WINDOW // 2)
    found = half.project(view.pose.transform(points))
    np.testing.assert_allclose(found, np.stack([columns, rows], axis=1) + 0.5, atol=0.5)


@pytest.mark.parametrize("index", range(4))
def test_the_silhouette_is_that_of_the_whole_image(index):
    spec = spec_of(128)
    view = render_view(SCENE, SEED, index, spec)
    mask = render_layers(SCENE, SEED, index, (1024, 768)).mask
    share = mask.reshape(96, 8, 128, 8).mean(axis=(1, 3))
    share = np.repeat(share[..., None], 3, axis=2)
    covered = cut_pieces((share * 255).astype(np.uint8), view.pose, spec).window[..., 0] / 255
    covered = covered.reshape(72, 2, 72, 2).mean(axis=(1, 3))
    shown = view.coordinates[..., 3] > 0
    assert shown[covered == 1].all()
    assert not shown[covered == 0].any()
    assert (shown & (covered > 0.5)).sum() > 0.75 * (shown | (covered > 0.5)).sum()


def test_beyond_the_frames_edge_a_view_shows_nothing():
    spec = spec_of(128)
    cut_off = 0
    for index in range(4):
        view = render_view(SCENE, SEED, index, spec)
        outside = ~in_frame(view.camera, whole_camera(spec, view.level))
        assert not view.window[outside].any()
        assert not view.coordinates[outside[::2, ::2]].any()
        assert not view.coordinates[outside[1::2, 1::2]].any()
        cut_off += render_layers(SCENE, SEED, index, (128, 96)).mask[:, [0, -1]].any()
    assert cut_off  # the spacecraft reaches the edge


def test_an_empty_view_lacks_the_spacecraft_alone(one_sampling):
    spec = spec_of(128)
    view, empty = (render_view(SCENE, SEED, 1, spec, content) for content in ("object", "empty"))
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


def test_the_window_has_the_frames_exposure(monkeypatch):
    gains = itertools.count(1)
    monkeypatch.setattr(renderer, "choose_gain", lambda *_: float(next(gains)))
    view = render_view(SCENE, SEED, 1, spec_of(128))
    monkeypatch.setattr(renderer, "choose_gain", lambda *_: 1.0)
    np.testing.assert_array_equal(view.window, render_view(SCENE, SEED, 1, spec_of(128)).window)


@pytest.mark.parametrize("motion_px", [0.0, 12.0])
def test_a_part_of_a_picture_is_as_blurred_as_the_whole(motion_px):
    """Away from the edges, beyond which each repeats its own border."""
    width, left, top, margin = 400, 130, 20, 12
    light = np.random.default_rng(0).random((200, width, 3), dtype=np.float32)
    sensor = replace(SILENT, blur_px=3.0, motion_px=motion_px)
    whole = expose(light, 0.5, sensor, np.random.default_rng(1))
    part = np.ascontiguousarray(light[top : top + WINDOW, left : left + WINDOW])
    got = expose(part, 0.5, in_window(sensor, width), np.random.default_rng(1))
    inner = slice(margin, WINDOW - margin)
    expected = whole[top : top + WINDOW, left : left + WINDOW]
    np.testing.assert_allclose(
        got[inner, inner].astype(int), expected[inner, inner].astype(int), atol=1
    )


def test_the_noise_of_a_mean_of_pixels_is_that_of_its_sensor():
    """In both: shot noise and read noise fall with the number of pixels, as variances add."""
    sensor = replace(SILENT, blur_px=0.0, full_well=2000.0, read_noise=60.0)
    light = np.full((384, 384, 3), 0.3, np.float32)

    def linear(codes):
        return ((codes / 255 + 0.055) / 1.055) ** 2.4

    fine = linear(expose(light, 1.0, sensor, np.random.default_rng(0)).astype(float))
    means = fine.reshape(96, 4, 96, 4, 3).mean(axis=(1, 3))
    coarse = expose(light[:96, :96], 1.0, averaging(sensor, 4), np.random.default_rng(1))
    expected = np.sqrt(0.3 / 2000 + (60 / 2000) ** 2) / 4
    assert means.std() == pytest.approx(expected, rel=0.05)
    assert linear(coarse.astype(float)).std() == pytest.approx(expected, rel=0.05)


def test_processes_give_the_views_of_one():
    spec = spec_of(128)
    alone, shared = (
        list(render_views(SCENE, SEED, range(16), spec, "empty", workers)) for workers in (1, 2)
    )
    for index, (one, other) in enumerate(zip(alone, shared, strict=True)):
        np.testing.assert_array_equal(one.window, other.window)
        np.testing.assert_array_equal(one.frame, other.frame)
        assert one.pose == other.pose == renderer.label(SCENE, SEED, index)
