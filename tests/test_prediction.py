from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera, Pose, PoseUncertainty
from ffpose.images import read_rgb
from ffpose.models import FilterformerPose
from ffpose.prediction import (
    Prediction,
    expect_axes,
    predict,
    standard_deviations,
    write_overlay,
)
from ffpose.predictor import Predictor
from ffpose.preprocessing import Preprocessing
from ffpose.reprojection import reproject
from ffpose.undistortion import undistort

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
    predictor = Predictor.from_weights(weights)
    pose = predictor(read_rgb(picture))
    model = FilterformerPose.from_pretrained(weights)
    with torch.no_grad():
        raw = model(predictor.preprocessing(read_rgb(picture))[None])
    np.testing.assert_allclose(pose.t, raw.translation[0], atol=1e-6)
    assert abs(np.dot(pose.q, raw.orientation[0].numpy())) == pytest.approx(1, abs=1e-6)


def test_images_are_predicted_one_by_one(weights, picture, tmp_path):
    found = predict(weights, [picture, tmp_path / "none.png"])
    assert next(found).image == picture
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        next(found)


def test_pixels_of_more_than_eight_bits_are_refused(weights, tmp_path):
    path = tmp_path / "deep.png"
    Image.fromarray(np.full((96, 128), 40_000, np.uint16)).save(path)
    with pytest.raises(DataError, match=r"deep\.png: expected pixels of mode .*, got I;16"):
        next(predict(weights, [path]))


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
    path = write_overlay(Prediction(picture, AHEAD, URSO_CAMERA), tmp_path / "drawn")
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
    return Predictor.from_weights(weights, **options)(image).vector


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
    with pytest.raises(DataError) as refused:
        next(predict(sighted, [tmp_path / "square.png"]))
    said = str(refused.value)
    assert said.startswith(f"{tmp_path / 'square.png'}: ")
    assert "width=128, height=96, fx=100.0, fy=90.0, cx=60.0, cy=49.5" in said
    for words in ("96x96", "--camera FILE", "--any-camera"):
        assert words in said


def test_any_image_is_resized_where_any_camera_is_asked_for(sighted):
    image = noise_image(96, 96)
    expected = of_the_network(sighted, image.resize((64, 64), Image.Resampling.BILINEAR))
    np.testing.assert_allclose(answer(sighted, image, any_camera=True), expected, atol=1e-6)


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


def test_one_camera_or_any(sighted):
    with pytest.raises(ValueError, match="expected --camera or --any-camera, got both"):
        Predictor.from_weights(sighted, camera=VIEW, any_camera=True)


def test_predictions_know_camera_and_threshold(sighted, weights, picture):
    found = next(predict(sighted, [picture]))
    assert found.camera == Camera(128, 96, 100.0, 90.0, 60.0, 49.5)  # the view's, resized
    assert found.in_view_threshold == 0.5
    given = Camera(128, 96, 70.0, 70.0, 64.0, 48.0)
    assert next(predict(sighted, [picture], camera=given)).camera == given
    assert next(predict(weights, [picture])).camera is None


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


def sure_pose(in_view=0.25, t=(0, 0, 10)):
    uncertainty = PoseUncertainty(TRANSLATION_COVARIANCE, ROTATION_COVARIANCE, in_view)
    return Pose(t, [1, 0, 0, 0], uncertainty)


def test_a_pose_carries_what_the_network_says_of_itself():
    uncertainty = Predictor(Judge(), Preprocessing((8, 8)))(noise_image(8, 8)).uncertainty
    np.testing.assert_allclose(uncertainty.translation_covariance, TRANSLATION_COVARIANCE, 1e-6)
    np.testing.assert_allclose(uncertainty.rotation_covariance, ROTATION_COVARIANCE, 1e-6)
    assert uncertainty.in_view == 0.25


def test_a_network_that_says_nothing_of_itself(weights, picture):
    found = next(predict(weights, [picture]))
    assert found.pose.uncertainty is None
    assert found.flagged is None
    assert set(found.to_dict()) == {
        *("image", "translation_m", "orientation_wxyz", "roll_pitch_yaw_deg"),
    }


def test_the_json_form_holds_the_uncertainty(tmp_path):
    document = Prediction(tmp_path / "a.png", sure_pose(), in_view_threshold=0.2).to_dict()
    assert document["translation_covariance_m2"] == TRANSLATION_COVARIANCE.tolist()
    assert document["rotation_covariance_rad2"] == ROTATION_COVARIANCE.tolist()
    assert document["in_view"] == 0.25
    assert document["flagged"] is False
    unknown = Prediction(tmp_path / "a.png", sure_pose()).to_dict()
    assert unknown == {name: value for name, value in document.items() if name != "flagged"}


def test_standard_deviations_against_samples():
    generator = np.random.default_rng(0)
    half = generator.standard_normal((2, 3, 3)) * np.array([0.3, 0.01])[:, None, None]
    translation, rotation = half @ half.transpose(0, 2, 1)
    t = np.array([1.0, -2.0, 9.0])
    uncertainty = PoseUncertainty(translation, rotation, 1.0)
    distance, in_plane, out_of_plane = standard_deviations(t, uncertainty)
    moved = t + 1e-3 * generator.multivariate_normal(np.zeros(3), translation, 200_000)
    lengths = np.linalg.norm(moved, axis=1)  # a small step, for which length is linear
    assert distance == pytest.approx(lengths.std() / 1e-3, rel=0.01)
    vectors = generator.multivariate_normal(np.zeros(3), rotation, 200_000)
    turns = np.degrees(Rotation.from_rotvec(vectors).as_rotvec())
    along = turns @ (t / np.linalg.norm(t))
    assert in_plane == pytest.approx(np.sqrt((along**2).mean()), rel=0.01)
    across = (turns**2).sum(axis=1) - along**2
    assert out_of_plane == pytest.approx(np.sqrt(across.mean()), rel=0.01)


def test_in_words_with_uncertainty():
    words = str(Prediction("a.png", sure_pose(), in_view_threshold=0.2))
    assert words == (
        "a.png: t = (0.00, 0.00, 10.00) m ± 0.50 m along the ray, "
        "roll 0.0°, pitch 0.0°, yaw 0.0° ± 2.0° in plane, ± 2.2° out of plane"
    )


def test_what_is_not_in_view_is_said_and_not_drawn(picture, tmp_path):
    prediction = Prediction(picture, sure_pose(in_view=0.0312), URSO_CAMERA, 0.2)
    assert prediction.flagged is True
    assert str(prediction) == f"{picture}: no spacecraft in view (p = 0.031)"
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
    (found,) = predict(locator, [picture])
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
    with pytest.raises(ValueError, match="--camera FILE, whose distortion is taken out"):
        list(predict(trained_undistorted, [picture]))
    (bent,) = predict(trained_undistorted, [picture], camera=LENS)
    flat = undistort(read_rgb(picture), LENS)
    expected = Predictor.from_weights(trained_undistorted, camera=LENS.pinhole)(flat)
    np.testing.assert_array_equal(bent.pose.vector, expected.vector)
    (as_it_is,) = predict(trained_undistorted, [picture], any_camera=True)
    assert as_it_is.pose != bent.pose


def test_levels_are_scaled_as_in_training(tmp_path):
    """Level 1000 of 12 bits, 4095, is gray 62; an image of 8 bits stays as it is."""
    weights = tmp_path / "deep.safetensors"
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **FIELDS)
    recipe = {"data": {"undistort": False, "white": 4095}}
    model.save_pretrained(weights, preprocessing=PLAIN, recipe=recipe)
    deep, plain = tmp_path / "deep.png", tmp_path / "plain.png"
    Image.fromarray(np.full((64, 64), 1000, np.uint16)).save(deep)
    Image.fromarray(np.full((64, 64), 62, np.uint8)).save(plain)
    one, other = predict(weights, [deep, plain])
    assert one.pose == other.pose
    shown = replace(one, camera=URSO_CAMERA)
    drawn = np.asarray(Image.open(write_overlay(shown, tmp_path / "drawn")))
    assert (drawn == 62).all(axis=-1).any()


def test_an_object_is_described_as_ever(weights, picture):
    (found,) = predict(weights, [picture])
    assert list(found.to_dict()) == [
        *("image", "translation_m", "orientation_wxyz", "roll_pitch_yaw_deg"),
    ]


def test_axes_are_drawn_on_objects_alone(locator, weights):
    expect_axes(weights, URSO_CAMERA)
    with pytest.raises(ValueError, match="overlay: expected weights that locate an object"):
        expect_axes(locator, URSO_CAMERA)


def test_axes_are_drawn_where_the_camera_is_known(weights, picture, tmp_path):
    with pytest.raises(ValueError, match="overlay: expected --camera FILE, as these weights"):
        expect_axes(weights, None)
    with pytest.raises(ValueError, match="expected one with a camera, got camera None"):
        write_overlay(Prediction(picture, AHEAD), tmp_path)


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
    (found,) = predict(path, [picture])
    np.testing.assert_allclose(found.pose.t, raw.translation[0], atol=1e-6)
