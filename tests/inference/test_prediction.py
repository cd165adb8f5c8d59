import json
import re
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from PIL import Image

from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera, Pose, PoseUncertainty
from ffpose.imaging.images import read_rgb
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import reproject
from ffpose.imaging.undistortion import undistort
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.in_torch import TorchSession
from ffpose.inference.load import load
from ffpose.inference.prediction import (
    Failure,
    Prediction,
    expect_axes,
    expect_distinct_overlays,
    predict,
    write_overlay,
)
from ffpose.models import FilterformerPose, FilterformerPoseConfig, PosePrediction, WeightsMetadata

VIEW = Camera(64, 64, 50.0, 60.0, 30.0, 33.0)
"""Camera of the network's input: 128x96 pixels of the images, squeezed."""
FIELDS = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}


PLAIN = Preprocessing((64, 64))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS).save_pretrained(
        path, preprocessing=PLAIN
    )
    return path


@pytest.fixture(scope="module")
def sighted(tmp_path_factory):
    """Weights that know their camera and the size of the images they were trained on."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "sighted.safetensors"
    camera = (VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)
    model = FilterformerPose.from_config("tiny", backbone_weights="none", camera=camera, **FIELDS)
    model.save_pretrained(
        path, preprocessing=PLAIN, data={"image_size": [96, 128]}, in_view_threshold=0.5
    )
    return path


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "view.png"
    pixels = np.random.default_rng(0).integers(0, 256, (96, 128, 4), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def test_a_pose_is_that_of_the_network(weights, picture):
    estimator = load(weights)
    pose = estimator(read_rgb(picture))
    model = FilterformerPose.from_pretrained(weights)
    with torch.no_grad():
        raw = model(estimator.preprocessing(read_rgb(picture))[None])
    np.testing.assert_allclose(pose.t, raw.translation[0], atol=1e-6)
    assert abs(np.dot(pose.q, raw.orientation[0].numpy())) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("batch", [1, 2, 7])
def test_an_image_that_cannot_be_used_is_among_the_answers(weights, picture, tmp_path, batch):
    """In their order, with the poses of the images beside it as they are without it."""
    deep = tmp_path / "deep.png"
    Image.fromarray(np.full((96, 128), 40_000, np.uint16)).save(deep)
    files = [picture, tmp_path / "none.png", deep, picture]
    estimator = load(weights)
    found = list(predict(estimator, files, batch=batch))
    assert [answer.image for answer in found] == files
    first, missing, refused, last = found
    assert isinstance(missing.error, FileNotFoundError)
    assert isinstance(refused.error, DataError)
    assert re.search(r"deep\.png: expected pixels of mode .*, got I;16", str(refused))
    assert missing.to_dict() == {"image": str(files[1]), "error": str(missing.error)}
    for answer in (first, last):
        np.testing.assert_allclose(answer.pose.vector, estimator(picture).vector, atol=1e-5)


def test_images_are_read_as_their_poses_are_asked_for(weights, picture):
    def files():
        yield picture
        pytest.fail("read ahead")

    assert next(predict(load(weights), files())).image == picture


class Blind(torch.nn.Module):
    """A network that has no answer for a black image."""

    def forward(self, images):
        seen = images.amax((1, 2, 3)) > -1.5
        translation = torch.where(seen[:, None], images.mean((2, 3)), torch.nan)
        return PosePrediction(translation, torch.tensor([[1.0, 0, 0, 0]]).repeat(len(images), 1))


def test_an_answer_that_is_none_is_that_of_its_image_alone(tmp_path):
    files = [tmp_path / name for name in ("gray.png", "black.png", "white.png")]
    for path, level in zip(files, (90, 0, 255), strict=True):
        Image.new("RGB", (8, 8), (level,) * 3).save(path)
    estimator = PoseEstimator(TorchSession(Blind()), metadata_of(32))
    gray, black, white = predict(estimator, files, batch=3)
    assert isinstance(black, Failure)
    assert re.search(r"black\.png: translation: expected finite numbers", str(black))
    assert (gray.pose.t < white.pose.t).all()


def test_a_batch_holds_an_image():
    with pytest.raises(ValueError, match="batch: expected at least 1, got 0"):
        predict(PoseEstimator(TorchSession(Judge()), metadata_of(32)), [], batch=0)


def test_the_json_form_holds_meters_quaternion_and_degrees(tmp_path):
    turn = Pose([1, 2, 10], [np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)])  # 45 degrees about z
    document = Prediction(tmp_path / "a.png", turn).to_dict()
    assert document["image"] == str(tmp_path / "a.png")
    assert document["translation_m"] == [1, 2, 10]
    assert document["orientation_wxyz"] == turn.q.tolist()
    np.testing.assert_allclose(document["roll_pitch_yaw_deg"], [0, 0, 45], atol=1e-12)


def test_in_words():
    words = str(Prediction(__file__, Pose([1, 2, 10], [1, 0, 0, 0])))
    assert words.endswith("t = (1.00, 2.00, 10.00) m, roll 0.0°, pitch 0.0°, yaw 0.0°")


AHEAD = Pose([0, 0, 10], [1, 0, 0, 0])


def test_an_overlay_draws_at_the_projected_origin(picture, tmp_path):
    path = write_overlay(Prediction(picture, AHEAD, URSO_CAMERA, axis_m=2.0), tmp_path / "drawn")
    assert path == tmp_path / "drawn/view_pose.png"
    drawn, plain = np.asarray(Image.open(path), int), np.asarray(read_rgb(picture), int)
    changed = np.argwhere(np.abs(drawn - plain).sum(axis=2) > 0)
    assert drawn.shape == plain.shape
    assert np.abs(changed - [48, 64]).sum(axis=1).min() <= 1
    # x and y have a length of 2 m at 10 m: 2 / 10 of a focal length of 64 pixels.
    assert changed[:, 1].max() == pytest.approx(64 + 12.8, abs=2)
    assert changed[:, 0].max() == pytest.approx(48 + 12.8, abs=2)


def test_an_overlay_is_drawn_with_the_images_camera(picture, tmp_path):
    """Its principal point is where an object straight ahead stands: (96, 24) of 128x96."""
    camera = Camera(64, 48, 32.0, 32.0, 48.0, 12.0)
    path = write_overlay(Prediction(picture, AHEAD, camera), tmp_path)
    changed = np.argwhere(np.asarray(Image.open(path)) != np.asarray(read_rgb(picture)))
    assert np.abs(changed[:, :2] - [24, 96]).sum(axis=1).min() <= 1
    assert np.abs(changed[:, :2] - [24, 96]).max() < 20  # 2 m at 10 m, focal length 64


def answer(weights, image, **options):
    return load(weights, **options)(image).vector


def of_the_network(weights, image):
    """What the network says of an image of its input's size."""
    inputs = PLAIN(image)[None]
    with torch.inference_mode():
        pose = FilterformerPose.from_pretrained(weights)(inputs)
    return Pose(pose.translation[0].double(), pose.orientation[0].double()).vector


def noise_image(width, height):
    pixels = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return Image.fromarray(pixels)


@pytest.mark.parametrize("size", [(128, 96), (64, 48), (500, 375)])
def test_an_image_of_the_weights_shape_is_their_cameras(sighted, size):
    image = noise_image(*size)
    expected = of_the_network(sighted, image.resize((64, 64), Image.Resampling.BILINEAR))
    np.testing.assert_allclose(answer(sighted, image), expected, atol=1e-6)


def test_an_image_of_another_shape_is_refused_with_the_way_out(sighted, tmp_path):
    noise_image(96, 96).save(tmp_path / "square.png")
    (refused,) = predict(load(sighted), [tmp_path / "square.png"])
    assert isinstance(refused.error, DataError)
    said = str(refused)
    assert said.startswith(f"{tmp_path / 'square.png'}: ")
    assert "width=128, height=96, fx=100.0, fy=90.0, cx=60.0, cy=49.5" in said
    for words in ("96x96", "--camera FILE", "--resize"):
        assert words in said


def test_any_image_is_resized_where_that_is_asked_for(sighted):
    image = noise_image(96, 96)
    expected = of_the_network(sighted, image.resize((64, 64), Image.Resampling.BILINEAR))
    np.testing.assert_allclose(answer(sighted, image, resize=True), expected, atol=1e-6)


def test_weights_without_camera_take_any_image(weights):
    image = noise_image(96, 96)
    expected = of_the_network(weights, image.resize((64, 64), Image.Resampling.BILINEAR))
    np.testing.assert_allclose(answer(weights, image), expected, atol=1e-6)


def test_an_image_of_another_camera_is_turned_into_the_view(sighted):
    camera = Camera(48, 48, 60.0, 60.0, 22.0, 25.0)
    image = noise_image(96, 96)
    view = reproject(image, camera.resized(96, 96), VIEW)
    expected = of_the_network(sighted, view)
    np.testing.assert_allclose(answer(sighted, image, camera=camera), expected, atol=1e-6)
    stretched = image.resize((64, 64), Image.Resampling.BILINEAR)
    assert np.abs(expected - of_the_network(sighted, stretched)).max() > 1e-4


def test_a_camera_of_another_shape_than_its_image_is_refused(sighted):
    with pytest.raises(ValueError, match=r"of its camera, .*width=1280.* got 96x96"):
        answer(sighted, noise_image(96, 96), camera=Camera(1280, 960, 640, 640, 640, 480))


def test_one_camera_or_a_resize(sighted):
    with pytest.raises(ValueError, match=r"camera: expected one .*, or resize; got both"):
        load(sighted, camera=VIEW, resize=True)


def test_to_name_the_camera_of_training_changes_nothing(tmp_path):
    """Also where an image is cropped, whose reprojection differs by a fraction of a pixel."""
    crop, path = Preprocessing((64, 64), "center_crop"), tmp_path / "cropped.safetensors"
    fields = FIELDS | {"camera": (VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)}
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields)
    model.save_pretrained(path, preprocessing=crop, data={"image_size": [96, 128]})
    image = noise_image(128, 96)
    named = answer(path, image, camera=load(path).camera)
    np.testing.assert_array_equal(named, answer(path, image))
    with pytest.raises(ValueError, match="aspect ratio"):
        answer(path, noise_image(96, 96), camera=load(path).camera)


def test_predictions_know_their_camera(sighted, weights, picture):
    found = next(predict(load(sighted), [picture]))
    assert found.camera == Camera(128, 96, 100.0, 90.0, 60.0, 49.5)  # the view's, resized
    given = Camera(128, 96, 70.0, 70.0, 64.0, 48.0)
    assert next(predict(load(sighted, camera=given), [picture])).camera == given
    assert next(predict(load(weights), [picture])).camera is None


class UncertainPose(NamedTuple):
    translation: torch.Tensor
    orientation: torch.Tensor
    translation_covariance: torch.Tensor
    rotation_covariance: torch.Tensor
    in_view: torch.Tensor


TRANSLATION_COVARIANCE = np.diag([0.01, 0.04, 0.25])
ROTATION_COVARIANCE = np.diag([1.0, 4.0, 4.0]) * np.radians(1) ** 2


class Judge(torch.nn.Module):
    """A network that says how sure it is, whatever it sees."""

    def forward(self, images):
        return UncertainPose(
            torch.tensor([[0.0, 0.0, 10.0]]),
            torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
            torch.tensor(TRANSLATION_COVARIANCE, dtype=torch.float32)[None],
            torch.tensor(ROTATION_COVARIANCE, dtype=torch.float32)[None],
            torch.tensor([0.25]),
        )


def metadata_of(size, threshold=None):
    """What the weights of a network say of itself whose input are square images."""
    config = FilterformerPoseConfig(image_size=(size, size))
    return WeightsMetadata(config, Preprocessing((size, size)), in_view_threshold=threshold)


def sure_pose(in_view=0.25, threshold=None):
    uncertainty = PoseUncertainty(TRANSLATION_COVARIANCE, ROTATION_COVARIANCE, in_view, threshold)
    return Pose([0, 0, 10], [1, 0, 0, 0], uncertainty)


def test_a_pose_carries_what_the_network_says_of_itself():
    pose = PoseEstimator(TorchSession(Judge()), metadata_of(32, 0.3))(noise_image(8, 8))
    assert pose.flagged is True  # 0.25 is below 0.3
    uncertainty = pose.uncertainty
    np.testing.assert_allclose(uncertainty.translation_covariance, TRANSLATION_COVARIANCE, 1e-6)
    np.testing.assert_allclose(uncertainty.rotation_covariance, ROTATION_COVARIANCE, 1e-6)
    assert uncertainty.in_view == 0.25


def test_a_network_that_says_nothing_of_itself(weights, picture):
    found = next(predict(load(weights), [picture]))
    assert found.pose.uncertainty is None
    assert found.pose.flagged is None
    assert set(found.to_dict()) == {
        *("image", "translation_m", "orientation_wxyz", "roll_pitch_yaw_deg"),
    }


def test_the_json_form_holds_the_uncertainty(tmp_path):
    document = Prediction(tmp_path / "a.png", sure_pose(threshold=0.2)).to_dict()
    assert document["translation_covariance_m2"] == TRANSLATION_COVARIANCE.tolist()
    assert document["rotation_covariance_rad2"] == ROTATION_COVARIANCE.tolist()
    assert document["degrees_of_freedom"] is None
    assert document["probabilities"] == [1.0, 0.0]
    assert document["in_view"] == 0.25
    assert document["flagged"] is False
    unknown = Prediction(tmp_path / "a.png", sure_pose()).to_dict()
    assert unknown == {name: value for name, value in document.items() if name != "flagged"}


def test_the_json_form_holds_tails_and_the_second_mode(tmp_path):
    said = PoseUncertainty(
        *(TRANSLATION_COVARIANCE, ROTATION_COVARIANCE, 0.25),
        degrees_of_freedom=(4.5, 3.0),
        alternative=[0.0, -0.6, 0.0, 0.8],
        probabilities=(0.75, 0.125),
    )
    document = Prediction(tmp_path / "a.png", Pose([0, 0, 10], [1, 0, 0, 0], said)).to_dict()
    assert json.loads(json.dumps(document))["degrees_of_freedom"] == [4.5, 3.0]
    assert document["alternative_wxyz"] == [0.0, 0.6, 0.0, -0.8]
    assert document["probabilities"] == [0.75, 0.125]


def test_in_words_with_a_second_mode():
    """Half a turn about z, where it is likely enough to matter."""
    for p, told in ((0.3, ", or roll 0.0°, pitch 0.0°, yaw 180.0° (p = 0.30)"), (0.05, "")):
        said = PoseUncertainty(
            *(TRANSLATION_COVARIANCE, ROTATION_COVARIANCE, 0.25),
            alternative=[0.0, 0.0, 0.0, 1.0],
            probabilities=(0.6, p),
        )
        words = str(Prediction("a.png", Pose([0, 0, 10], [1, 0, 0, 0], said)))
        assert words.endswith(f"out of plane{told}")


def test_in_words_with_uncertainty():
    words = str(Prediction("a.png", sure_pose(threshold=0.2)))
    assert words == (
        "a.png: t = (0.00, 0.00, 10.00) m ± 0.50 m along the ray, "
        "roll 0.0°, pitch 0.0°, yaw 0.0° ± 2.0° in plane, ± 2.2° out of plane"
    )


def test_what_is_not_in_view_is_said_and_not_drawn(picture, tmp_path):
    prediction = Prediction(picture, sure_pose(0.0312, threshold=0.2), URSO_CAMERA)
    assert prediction.pose.flagged is True
    assert str(prediction) == f"{picture}: no spacecraft in view (p = 0.0312, threshold 0.2000)"
    drawn = Image.open(write_overlay(prediction, tmp_path / "drawn"))
    np.testing.assert_array_equal(np.asarray(drawn), np.asarray(read_rgb(picture)))


@pytest.fixture
def locator(tmp_path):
    """Weights that locate the camera in the world."""
    path = tmp_path / "scene.safetensors"
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    model.save_pretrained(path, preprocessing=PLAIN, data={"locates": "camera"})
    return path


def test_a_located_camera_is_said_to_be_one(locator, picture):
    """Center and rotation are the network's; the pose takes the center to the camera's origin."""
    (found,) = predict(load(locator), [picture])
    with torch.no_grad():
        raw = FilterformerPose.from_pretrained(locator)(PLAIN(read_rgb(picture))[None])
    center = raw.translation[0].double().numpy()
    np.testing.assert_allclose(found.pose.transform(center), np.zeros(3), atol=1e-6)
    document = found.to_dict()
    assert document["locates"] == "camera"
    np.testing.assert_allclose(document["camera_center_m"], center, atol=1e-6)
    assert document["translation_m"] == found.pose.t.tolist()
    assert abs(np.dot(document["orientation_wxyz"], raw.orientation[0].numpy())) == pytest.approx(1)
    x, y, z = center
    assert f"camera at ({x:.2f}, {y:.2f}, {z:.2f}) m in the world" in str(found)


LENS = DistortedCamera(128, 96, 100.0, 120.0, 60.0, 49.5, (0.3, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture
def trained_undistorted(tmp_path):
    path = tmp_path / "undistorted.safetensors"
    fields = FIELDS | {"camera": (50.0, 60.0, 30.0, 33.0)}
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields)
    recipe = {"data": {"undistort": True, "white": None}}
    data = {"image_size": [96, 128]}
    model.save_pretrained(path, preprocessing=PLAIN, recipe=recipe, data=data)
    return path


def test_images_are_undistorted_as_in_training(trained_undistorted, picture):
    with pytest.raises(
        ValueError, match=r"camera: expected one \(--camera FILE\), whose distortion is taken out"
    ):
        load(trained_undistorted)
    (bent,) = predict(load(trained_undistorted, camera=LENS), [picture])
    flat = undistort(read_rgb(picture), LENS)
    expected = load(trained_undistorted, camera=LENS.pinhole)(flat)
    np.testing.assert_array_equal(bent.pose.vector, expected.vector)
    (as_it_is,) = predict(load(trained_undistorted, resize=True), [picture])
    assert as_it_is.pose != bent.pose


def test_weights_of_several_cameras_undistort_images_of_the_one_that_is_named(tmp_path, picture):
    path = tmp_path / "several.safetensors"
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    model.save_pretrained(path, preprocessing=PLAIN, recipe={"data": {"undistort": True}})
    (bent,) = predict(load(path, camera=LENS), [picture])
    expected = load(path, camera=LENS.pinhole)(undistort(read_rgb(picture), LENS))
    np.testing.assert_allclose(bent.pose.vector, expected.vector, atol=2e-3)
    (as_it_is,) = predict(load(path, resize=True), [picture])
    assert np.abs(as_it_is.pose.vector - expected.vector).max() > 1e-2


def test_levels_are_scaled_as_in_training(tmp_path):
    """Level 1000 of 12 bits, 4095, is gray 62; an image of 8 bits stays as it is."""
    weights = tmp_path / "deep.safetensors"
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    recipe = {"data": {"undistort": False, "white": 4095}}
    model.save_pretrained(weights, preprocessing=PLAIN, recipe=recipe)
    deep, plain = tmp_path / "deep.png", tmp_path / "plain.png"
    Image.fromarray(np.full((64, 64), 1000, np.uint16)).save(deep)
    Image.fromarray(np.full((64, 64), 62, np.uint8)).save(plain)
    one, other = predict(load(weights), [deep, plain])
    assert one.pose == other.pose
    shown = replace(one, camera=URSO_CAMERA)
    drawn = np.asarray(Image.open(write_overlay(shown, tmp_path / "drawn")))
    assert (drawn == 62).all(axis=-1).any()


def test_white_is_stated_for_weights_that_know_none(weights, tmp_path):
    deep, plain = tmp_path / "deep.png", tmp_path / "plain.png"
    Image.fromarray(np.full((64, 64), 1000, np.uint16)).save(deep)
    Image.fromarray(np.full((64, 64), 62, np.uint8)).save(plain)
    one, other = predict(load(weights, white=4095), [deep, plain])
    assert one.pose == other.pose
    (refused,) = predict(load(weights), [deep])
    assert str(refused).endswith("got I;16, and no white level (white)")
    with pytest.raises(ValueError, match=r"white: expected a positive level, .* got 0"):
        load(weights, white=0)


def test_an_object_is_described_as_ever(weights, picture):
    (found,) = predict(load(weights), [picture])
    assert list(found.to_dict()) == [
        *("image", "translation_m", "orientation_wxyz", "roll_pitch_yaw_deg"),
    ]


def test_axes_are_drawn_on_objects_alone(locator, weights):
    expect_axes(load(weights, camera=URSO_CAMERA))
    with pytest.raises(ValueError, match="overlay: expected weights that locate an object"):
        expect_axes(load(locator, camera=URSO_CAMERA))


def test_axes_are_drawn_where_the_camera_is_known(weights, picture, tmp_path):
    with pytest.raises(ValueError, match="overlay: expected --camera FILE, as these weights"):
        expect_axes(load(weights))
    with pytest.raises(ValueError, match="expected one with a camera, got camera None"):
        write_overlay(Prediction(picture, AHEAD), tmp_path)


def test_a_link_to_itself_is_a_failure_of_its_own(weights, picture, tmp_path):
    circle = tmp_path / "circle.png"
    circle.symlink_to(circle.name)
    expect_distinct_overlays([circle, picture], tmp_path / "drawn")
    failure, prediction = predict(load(weights), [circle, picture])
    assert isinstance(failure, Failure)
    assert isinstance(prediction, Prediction)
    link = tmp_path / "link.png"
    link.symlink_to(picture)
    with pytest.raises(ValueError, match="would overwrite"):
        expect_distinct_overlays([link, tmp_path / "link_pose.png"], tmp_path)


def test_weights_locate_an_object_or_the_camera(tmp_path):
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    with pytest.raises(ValueError, match="expected locates object or camera, got 'ship'"):
        model.save_pretrained(tmp_path / "w", preprocessing=PLAIN, data={"locates": "ship"})


def test_what_was_cropped_in_training_is_cropped_in_prediction(tmp_path, picture):
    """128x96 to 64x64: resized to 98x73, of which the middle is cut, by Pillow here."""
    crop, path = Preprocessing((64, 64), "center_crop"), tmp_path / "cropped.safetensors"
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    model.save_pretrained(path, preprocessing=crop)
    resized = read_rgb(picture).resize((98, 73), Image.Resampling.BILINEAR)
    middle = resized.crop((17, 4, 81, 68))
    with torch.no_grad():
        raw = model.eval()(PLAIN(middle)[None])
    (found,) = predict(load(path), [picture])
    np.testing.assert_allclose(found.pose.t, raw.translation[0], atol=1e-6)
