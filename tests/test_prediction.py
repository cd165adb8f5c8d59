import numpy as np
import pytest
import torch
from PIL import Image

from ffpose.errors import DataError
from ffpose.geometry import Pose
from ffpose.images import read_rgb
from ffpose.models import FilterformerPose
from ffpose.prediction import Prediction, Predictor, predict, write_overlay


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}
    FilterformerPose.from_config("tiny", backbone_weights="none", **fields).save_pretrained(path)
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


def test_the_json_form_holds_metres_quaternion_and_degrees(tmp_path):
    turn = Pose([1, 2, 10], [np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)])  # 45 degrees about z
    document = Prediction(tmp_path / "a.png", turn).to_dict()
    assert document["image"] == str(tmp_path / "a.png")
    assert document["translation_m"] == [1, 2, 10]
    assert document["orientation_wxyz"] == turn.q.tolist()
    np.testing.assert_allclose(document["roll_pitch_yaw_deg"], [0, 0, 45], atol=1e-12)


def test_in_words():
    words = str(Prediction(__file__, Pose([1, 2, 10], [1, 0, 0, 0])))
    assert words.endswith("t = (1.00, 2.00, 10.00) m, roll 0.0°, pitch 0.0°, yaw 0.0°")


def test_an_overlay_draws_at_the_projected_origin(picture, tmp_path):
    path = write_overlay(Prediction(picture, Pose([0, 0, 10], [1, 0, 0, 0])), tmp_path / "drawn")
    assert path == tmp_path / "drawn/view_pose.png"
    drawn, plain = np.asarray(Image.open(path), int), np.asarray(read_rgb(picture), int)
    changed = np.argwhere(np.abs(drawn - plain).sum(axis=2) > 0)
    assert drawn.shape == plain.shape
    assert np.abs(changed - [48, 64]).sum(axis=1).min() <= 1
    # x and y have a length of 2 m at 10 m: 2 / 10 of a focal length of 64 pixels.
    assert changed[:, 1].max() == pytest.approx(64 + 12.8, abs=2)
    assert changed[:, 0].max() == pytest.approx(48 + 12.8, abs=2)
