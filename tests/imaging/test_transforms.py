"""Preprocessing against torchvision; augmentation against projection: labels move with pixels."""

import json
import math
from dataclasses import astuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation
from torchvision.transforms import v2

from ffpose.geometry import URSO_CAMERA, Camera, Pose
from ffpose.imaging.preprocessing import Preprocessing, Window
from ffpose.imaging.transforms import (
    Augmentation,
    _blur,
    _sensor_noise,
    camera_turn,
    crop_turn,
    random_window,
    turn_camera,
)
from ffpose.render import find_scene, object_coordinates
from ffpose.render.shading.sensor import Sensor, expose

STILL = {"brightness": 0, "contrast": 0, "saturation": 0, "noise": 0, "blur": 0}


def noise_image(width, height, seed=0):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    return Image.fromarray(pixels)


def blob(width, height, u, v, sigma):
    """A round spot whose center of mass is (u, v); pixel centers lie at halves."""
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    return np.exp(-((x - u) ** 2 + (y[:, None] - v) ** 2) / (2 * sigma**2))


def center_of_mass(image):
    """(u, v) of a plane (h, w)."""
    height, width = image.shape
    mass = image.sum()
    u = (image.sum(0) * (torch.arange(width) + 0.5)).sum() / mass
    v = (image.sum(1) * (torch.arange(height) + 0.5)).sum() / mass
    return float(u), float(v)


def test_the_numbers_are_standardised_pixels():
    color = (51, 102, 204)
    tensor = Preprocessing((4, 6))(Image.new("RGB", (64, 48), color))
    assert tensor.dtype == torch.float32
    assert tensor.shape == (3, 4, 6)
    expected = [(0.2 - 0.485) / 0.229, (0.4 - 0.456) / 0.224, (0.8 - 0.406) / 0.225]
    for plane, value in zip(tensor, expected, strict=True):
        np.testing.assert_allclose(plane, value, rtol=1e-6)


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_resize_keeps_the_frame_and_is_antialiased(interpolation):
    image = noise_image(160, 120)
    preprocessing = Preprocessing(
        (30, 30), mean=(0, 0, 0), std=(1, 1, 1), interpolation=interpolation
    )
    pixels = torch.from_numpy(np.array(image)).permute(2, 0, 1).float() / 255
    mode = v2.InterpolationMode(interpolation)
    expected = v2.functional.resize(pixels, [30, 30], mode, antialias=True)
    # Pillow rounds to whole grey levels after each axis.
    torch.testing.assert_close(preprocessing(image), expected, rtol=0, atol=1.01 / 255)


def test_center_crop_is_torchvisions_256_to_224():
    image = noise_image(1280, 960)
    steps = [v2.Resize(256), v2.CenterCrop(224), v2.PILToTensor()]
    expected = v2.Compose([*steps, v2.ToDtype(torch.float32, scale=True)])(image)
    preprocessing = Preprocessing(mode="center_crop", mean=(0, 0, 0), std=(1, 1, 1))
    torch.testing.assert_close(preprocessing(image), expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("mode", ["resize", "center_crop"])
@pytest.mark.parametrize("size", [(120, 120), (96, 160), (150, 100)])
def test_the_camera_goes_with_the_image(mode, size):
    camera = URSO_CAMERA.resized(640, 480)
    point = [0.3, -0.2, 8.0]
    spot = blob(640, 480, *camera.project(point), sigma=12)
    image = Image.fromarray((spot * 255).round().astype(np.uint8)).convert("RGB")
    preprocessing = Preprocessing(size, mode, mean=(0, 0, 0), std=(1, 1, 1))
    found = center_of_mass(preprocessing(image)[0])
    seen = preprocessing.camera(camera)
    assert (seen.height, seen.width) == size
    np.testing.assert_allclose(found, seen.project(point), atol=0.05)
    back = preprocessing.image_camera(seen, 640, 480)
    np.testing.assert_allclose(astuple(back), astuple(camera), rtol=1e-12)


def test_windows_lie_in_the_frame_and_reach_its_edges():
    preprocessing = Preprocessing((4, 6), "center_crop")
    torch.manual_seed(0)
    drawn = [random_window(preprocessing, (6, 7)) for _ in range(100)]
    assert set(drawn) == {(top, left) for top in range(3) for left in range(2)}
    assert preprocessing.center_window((6, 10)) == (1, 2)


def test_fields_survive_json():
    preprocessing = Preprocessing(
        (96, 128), "center_crop", (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), "bicubic"
    )
    fields = json.loads(json.dumps(preprocessing.to_dict()))
    assert Preprocessing.from_dict(fields) == preprocessing


def test_fields_without_interpolation_are_of_a_bilinear_resize():
    fields = {"size": [8, 9], "mode": "resize", "mean": [0.1, 0.2, 0.3], "std": [1, 1, 1]}
    assert Preprocessing.from_dict(fields) == Preprocessing(
        (8, 9), mean=(0.1, 0.2, 0.3), std=(1,) * 3
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size": [224]}, "size: expected"),
        ({"size": [0, 224]}, "size: expected .*each at least 1"),
        ({"mode": "pad"}, "mode: expected one of resize, center_crop, got 'pad'"),
        ({"mean": [0.5, 0.5]}, "mean: expected three"),
        ({"std": [0.2, 0.2, 0.0]}, "std: expected three finite numbers above 0"),
        ({"interpolation": "sharp"}, "expected one of bilinear, bicubic, got 'sharp'"),
        ({"crop": 1}, "expected size, mode, mean, std"),
    ],
)
def test_bad_preprocessing_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        Preprocessing.from_dict(Preprocessing().to_dict() | change)


def test_only_rgb_is_taken():
    with pytest.raises(ValueError, match="expected mode RGB, got 'L'"):
        Preprocessing()(Image.new("L", (8, 8)))


def tensors(pose):
    return torch.from_numpy(pose.vector).float().split([3, 4])


def test_a_roll_to_half_a_turn_gives_the_label_of_canonical_sign():
    """Half a turn about x, and the camera by half a turn about z, are half a turn about y."""
    camera = URSO_CAMERA.resized(16, 12)
    for sign in (1.0, -1.0):
        label = torch.tensor([0.0, 0.0, 5.0]), torch.tensor([0.0, sign, 0.0, 0.0])
        _, _, q = turn_camera(torch.zeros(3, 12, 16), *label, camera, camera_turn(0, 0, 180))
        np.testing.assert_allclose(q, [0, 0, 1, 0], atol=1e-7)


def rotation_of(*angles):
    """The same turn by SciPy: pan about y first, then tilt about x, then roll about z."""
    return Rotation.from_euler("yxz", angles, degrees=True)


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (20, 0, 0), (0, -15, 0), (10, -20, 130), (0, 0, 180)]
)
def test_a_turn_is_pan_then_tilt_then_roll(angles):
    np.testing.assert_allclose(camera_turn(*angles), rotation_of(*angles).as_matrix(), atol=1e-12)


def test_a_positive_turn_moves_the_scene_as_documented():
    ahead = np.array([0.0, 0.0, 1.0])
    assert (camera_turn(10, 0, 0) @ ahead)[0] > 0.1  # right
    assert (camera_turn(0, 10, 0) @ ahead)[1] < -0.1  # up
    assert (camera_turn(0, 0, 10) @ [1, 0, 0])[1] > 0.1  # from right to down


angle = st.floats(-30, 30)


@settings(max_examples=50, deadline=None)
@given(angle, angle, st.floats(-180, 180), st.integers(0, 99))
def test_keypoints_go_one_way_through_label_and_homography(pan, tilt, roll, seed):
    """Projected with the turned label, or projected first and moved by K R K^-1: the same pixel."""
    generator = np.random.default_rng(seed)
    camera = URSO_CAMERA.resized(128, 96)
    pose = Pose([*generator.uniform(-1, 1, 2), 12], Rotation.random(rng=generator).as_quat())
    points = generator.uniform(-2, 2, (10, 3))
    rotation = camera_turn(pan, tilt, roll)
    label = torch.from_numpy(pose.vector).split([3, 4])

    _, t, q = turn_camera(torch.zeros(3, 96, 128), *label, camera, rotation)

    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    homography = matrix @ rotation @ np.linalg.inv(matrix)
    moved = np.column_stack([pose.project(points, camera), np.ones(10)]) @ homography.T
    turned = Rotation.from_quat(q, scalar_first=True).apply(points) + t.numpy()
    assert (turned[:, 2] > 1).all()
    seen = turned @ matrix.T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], moved[:, :2] / moved[:, 2:], atol=1e-9)
    assert q[0] >= 0


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 36), st.integers(0, 27), st.integers(0, 99))
def test_a_turned_crop_is_seen_by_the_camera_of_the_center_crop(left, top, seed):
    """Points go one way through the turned label, and by pixels through the homography."""
    generator = np.random.default_rng(seed)
    preprocessing = Preprocessing((192, 256), "center_crop")
    image_camera = Camera(1280, 960, 640.0, 655.0, 600.0, 500.0)
    whole, view = preprocessing.frame_camera(image_camera), preprocessing.camera(image_camera)
    crop = preprocessing.window_camera(image_camera, Window(top, left))
    rotation = crop_turn(crop, view)
    pose = Pose([*generator.uniform(-1, 1, 2), 12], Rotation.random(rng=generator).as_quat())
    points = generator.uniform(-2, 2, (10, 3))
    label = torch.from_numpy(pose.vector).split([3, 4])
    image = torch.zeros(3, whole.height, whole.width)

    image, t, q = turn_camera(image, *label, whole, rotation, view)

    assert image.shape == (3, 192, 256)
    # By the crop: a crop only shifts pixels, and the turn of its camera is a homography.
    cropped = pose.project(points, whole) - (left, top)
    np.testing.assert_allclose(cropped, pose.project(points, crop), atol=1e-9)
    homography = view.matrix @ rotation @ np.linalg.inv(crop.matrix)
    moved = np.column_stack([cropped, np.ones(10)]) @ homography.T
    turned = Rotation.from_quat(q, scalar_first=True).apply(points) + t.numpy()
    seen = turned @ view.matrix.T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], moved[:, :2] / moved[:, 2:], atol=1e-9)
    # The crop's center becomes the view's, by the least rotation.
    center = homography @ [128, 96, 1]
    np.testing.assert_allclose(center[:2] / center[2], [128, 96], atol=1e-9)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    rays = [np.linalg.inv(each.matrix) @ [128, 96, 1] for each in (crop, view)]
    cosine = np.dot(*rays) / np.prod(np.linalg.norm(rays, axis=1))
    assert np.trace(rotation) == pytest.approx(1 + 2 * cosine, abs=1e-12)


def test_the_center_crop_turns_nothing():
    preprocessing = Preprocessing((192, 256), "center_crop")
    view = preprocessing.camera(URSO_CAMERA)
    np.testing.assert_allclose(crop_turn(view, view), np.eye(3), atol=1e-15)


def test_there_is_one_crop():
    with pytest.raises(ValueError, match="turned_crop: expected one crop, got random_crop too"):
        Augmentation(random_crop=True, turned_crop=True)


@pytest.mark.parametrize(
    "angles",
    [(0, 0, 0), (0, 0, 17), (0, 0, -90), (0, 0, 180), (12, 0, 0), (0, 9, 0), (-15, 8, 123.4)],
)
def test_a_turn_moves_pixels_and_label_together(angles):
    camera = URSO_CAMERA.resized(128, 128)  # squeezed: fx is not fy
    pose = Pose([1.0, -0.7, 6.0], Rotation.from_euler("xyz", [1, 2, 3]).as_quat(scalar_first=True))
    feature = np.array([0.4, 0.6, -0.3])
    spots = [blob(128, 128, *pose.project(p, camera), 2.5) for p in (np.zeros(3), feature)]
    image = torch.from_numpy(np.stack([*spots, np.ones((128, 128))])).float()

    turned, t, q = turn_camera(image, *tensors(pose), camera, camera_turn(*angles))

    turn = rotation_of(*angles)
    new = Pose(t.double(), q.double())
    np.testing.assert_allclose(new.t, turn.apply(pose.t.copy()), atol=1e-5)
    np.testing.assert_allclose(new.rotation, turn.as_matrix() @ pose.rotation, atol=1e-6)
    assert q[0] >= 0
    for plane, point in zip(turned, (np.zeros(3), feature), strict=False):
        # Perspective stretches a spot, the more the farther from the axis: its mass moves a little.
        np.testing.assert_allclose(center_of_mass(plane), new.project(point, camera), atol=0.15)


def test_a_turned_mask_is_the_mask_of_the_turned_label():
    """The renderer, asked for the turned pose, draws what the turn makes of its picture."""
    camera, craft = URSO_CAMERA.resized(256, 192), find_scene("soyuz_easy").build()
    pose = Pose([1.5, -1.0, 9.0], Rotation.from_euler("xyz", [1, 2, 3]).as_quat(scalar_first=True))
    before = torch.from_numpy(object_coordinates(craft, pose, camera)).permute(2, 0, 1) / 255
    image, t, q = turn_camera(before[1:], *tensors(pose), camera, camera_turn(-14, 10, 75))
    after = object_coordinates(craft, Pose(t.double(), q.double()), camera)[..., 3] > 0
    moved = image[2].numpy() > 0.5
    assert after.sum() > 2000
    assert (after & moved).sum() > 0.96 * (after | moved).sum()


def test_what_the_camera_did_not_see_is_black():
    camera = URSO_CAMERA.resized(64, 48)
    image, label = torch.ones(3, 48, 64), tensors(Pose([0, 0, 5], [1, 0, 0, 0]))
    rolled, *_ = turn_camera(image, *label, camera, camera_turn(0, 0, 90))
    assert rolled[0, 24, 32] == pytest.approx(1)
    assert rolled[0, 24, 1] == 0
    panned, *_ = turn_camera(image, *label, camera, camera_turn(30, 0, 0))
    assert panned[0, 24, 1] == 0
    assert panned[0, 24, 62] == pytest.approx(1)


@pytest.mark.parametrize("pan", [90, 135, 180])
@pytest.mark.parametrize("side", [47, 48])
def test_behind_the_camera_there_is_nothing(pan, side):
    """The plane through the center has homogeneous places too, which mirror what is ahead."""
    camera = URSO_CAMERA.resized(side, side)
    label = tensors(Pose([0, 0, 5], [1, 0, 0, 0]))
    image, t, _ = turn_camera(torch.ones(3, side, side), *label, camera, camera_turn(pan, 0, 0))
    assert not image[:, :, : side // 2].any()
    assert image.isfinite().all()
    if pan == 180:
        assert not image.any()
        np.testing.assert_allclose(t, [0, 0, -5], atol=1e-6)


@pytest.mark.parametrize(
    "rotation", [np.diag([1.0, 1.0, -1.0]), 1.01 * np.eye(3), np.eye(4), np.full((3, 3), np.nan)]
)
def test_a_turn_is_a_rotation(rotation):
    with pytest.raises(ValueError, match="expected a rotation matrix"):
        turn_camera(IMAGE, *POSE, CAMERA, rotation)


def test_a_turn_needs_the_image_of_its_camera():
    label = tensors(Pose([0, 0, 5], [1, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"\(height, width\) \(960, 1280\), got \(48, 64\)"):
        turn_camera(torch.ones(3, 48, 64), *label, URSO_CAMERA, np.eye(3))


CAMERA = URSO_CAMERA.resized(40, 32)
IMAGE = torch.rand(3, 32, 40, generator=torch.Generator().manual_seed(0))
POSE = tensors(Pose([2.0, 1.0, 10.0], [0.5, 0.5, 0.5, 0.5]))


def test_nothing_asked_is_nothing_changed():
    image, t, q = Augmentation(**STILL)(IMAGE, *POSE, CAMERA)
    torch.testing.assert_close(image, IMAGE, rtol=0, atol=1e-6)
    assert torch.equal(t, POSE[0])
    assert torch.equal(q, POSE[1])


@pytest.mark.parametrize(
    "change",
    [
        {"brightness": 0.5},
        {"contrast": 0.5},
        {"saturation": 0.5},
        {"noise": 0.1},
        {"shot_noise": 0.1},
        {"read_noise": 0.1},
        {"blur": 2},
    ],
)
def test_each_photometric_change_leaves_the_label_and_the_input(change):
    before = IMAGE.clone()
    torch.manual_seed(1)
    image, t, q = Augmentation(**(STILL | change))(IMAGE, *POSE, CAMERA)
    assert (image - IMAGE).abs().max() > 0.01
    assert 0 <= image.min() <= image.max() <= 1
    assert torch.equal(t, POSE[0])
    assert torch.equal(q, POSE[1])
    assert torch.equal(IMAGE, before)


def test_a_seed_repeats_the_changes():
    augmentation = Augmentation(pan=10, tilt=10, roll=180, shot_noise=0.02)
    torch.manual_seed(3)
    first = augmentation(IMAGE, *POSE, CAMERA)
    torch.manual_seed(3)
    for one, other in zip(first, augmentation(IMAGE, *POSE, CAMERA), strict=True):
        assert torch.equal(one, other)


@settings(max_examples=30)
@given(st.floats(0, 1), st.floats(0, 1), st.floats(2, 40), st.integers(0, 99))
def test_the_origin_stays_in_a_turned_image(u, v, depth, seed):
    origin = [
        (u * 40 - CAMERA.cx) / CAMERA.fx * depth,
        (v * 32 - CAMERA.cy) / CAMERA.fy * depth,
        depth,
    ]
    torch.manual_seed(seed)
    pose = tensors(Pose(origin, [1, 0, 0, 0]))
    _, t, _ = Augmentation(**STILL, pan=30, tilt=30, roll=180)(IMAGE, *pose, CAMERA)
    column, row = CAMERA.project(t.double())
    assert -1e-4 <= column <= 40 + 1e-4
    assert -1e-4 <= row <= 32 + 1e-4


@pytest.mark.parametrize(("name", "axis"), [("tilt", 1), ("pan", 2), ("roll", 3)])
def test_a_turn_covers_its_range(name, axis):
    torch.manual_seed(0)
    pose = tensors(Pose([0, 0, 10], [1, 0, 0, 0]))
    turns = []
    for _ in range(200):
        _, _, q = Augmentation(**STILL, **{name: 30})(IMAGE, *pose, CAMERA)
        turns.append(math.degrees(2 * math.atan2(float(q[axis]), float(q[0]))))
        assert np.abs(np.delete(q[1:].numpy(), axis - 1)).max() < 1e-6
    # The frame ends at 36.9° to the side and 36.9° up: no angle is refused.
    assert -30 <= min(turns) < -25
    assert 25 < max(turns) <= 30


def test_where_no_turn_keeps_the_origin_the_image_stays():
    outside = tensors(Pose([0, 90, 1], [1, 0, 0, 0]))
    image, t, q = Augmentation(**STILL, pan=1)(IMAGE, *outside, CAMERA)
    torch.testing.assert_close(image, IMAGE, rtol=0, atol=1e-6)
    assert torch.equal(t, outside[0])
    assert torch.equal(q, outside[1])


@pytest.mark.parametrize("sigma", [0.1, 0.35, 0.5, 2.0])
def test_a_blur_is_torchvisions(sigma):
    size = 2 * math.ceil(3 * sigma) + 1
    expected = v2.functional.gaussian_blur(IMAGE, [size, size], [sigma, sigma])
    torch.testing.assert_close(_blur(IMAGE, sigma), expected, rtol=0, atol=1e-6)
    assert torch.equal(_blur(IMAGE, 0.09), IMAGE)


def linear(values):
    """The light that sRGB values stand for (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def test_a_blur_wider_than_the_image_leaves_its_mean_light():
    blurred = _blur(IMAGE, 200.0)
    assert blurred.std() < 0.1 * IMAGE.std()
    torch.testing.assert_close(blurred.mean(), IMAGE.mean(), rtol=0.02, atol=0)


@pytest.mark.parametrize("value", [0.05, 0.2, 0.5, 0.8])
def test_sensor_noise_has_the_variance_of_its_light(value):
    torch.manual_seed(0)
    seen = linear(_sensor_noise(torch.full((3, 200, 200), value), 0.02, 0.0003).double().numpy())
    light = linear(np.float64(value))
    assert seen.mean() == pytest.approx(light, rel=0.01)
    # 120,000 samples: the standard deviation is known to 0.2 %; in the dark the clip at 0 is far.
    assert seen.std() == pytest.approx(np.sqrt(0.02**2 * light + 0.0003**2), rel=0.02)


def test_sensor_noise_is_the_renderers():
    """With the renderer's electrons the same spread comes out of its sensor, curve and all."""
    torch.manual_seed(0)
    sensor = Sensor(blur_px=0, vignette=0, bloom=0, full_well=900, read_noise=12)
    flat = np.full((200, 200, 3), linear(np.float64(0.6)), np.float32)
    rendered = expose(flat, 1.0, sensor, np.random.default_rng(0)) / 255
    ours = _sensor_noise(torch.full((3, 200, 200), 0.6), 900**-0.5, 12 / 900)
    assert ours.mean() == pytest.approx(rendered.mean(), abs=0.003)
    assert ours.std() == pytest.approx(rendered.std(), rel=0.02)


@pytest.mark.parametrize(
    "change",
    [
        {"brightness": 1.5},
        {"contrast": -0.1},
        {"saturation": math.nan},
        {"noise": 2},
        {"blur": -1},
        {"roll": 181},
        {"pan": 91},
        {"tilt": -1},
        {"shot_noise": 2},
    ],
)
def test_bad_augmentation_is_refused(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))}: expected a number from 0 to"):
        Augmentation(**change)
