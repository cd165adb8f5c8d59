import csv
import json

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ffpose.evaluation import Evaluation, evaluate, format_table, mean_pose, write_results
from ffpose.geometry import URSO_CAMERA, Camera
from ffpose.models import FilterformerPose
from ffpose.reprojection import reproject
from ffpose.transforms import Preprocessing
from tiny_runs import SIZE, write_set


@pytest.fixture(scope="module")
def image_set(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("evaluation") / "set")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}
    FilterformerPose.from_config("tiny", backbone_weights="none", **fields).save_pretrained(path)
    return path


@pytest.fixture(scope="module")
def evaluation(weights, image_set):
    return evaluate(weights, "urso", image_set, batch_size=4)


def test_predictions_are_the_models_on_each_image(evaluation, weights):
    model = FilterformerPose.from_pretrained(weights)
    preprocessing = Preprocessing(size=(64, 64))
    for index in range(len(evaluation.dataset)):
        image = evaluation.dataset.load_image(index)
        assert image.size == SIZE
        with torch.no_grad():
            pose = model(preprocessing(image)[None])
        expected = torch.cat([pose.translation[0], pose.orientation[0]])
        np.testing.assert_allclose(evaluation.predicted[index], expected, rtol=0, atol=1e-5)


def test_figures_against_numpy_and_scipy(evaluation):
    truth, predicted = evaluation.dataset.poses, evaluation.predicted
    distance = np.linalg.norm(truth[:, :3] - predicted[:, :3], axis=1)
    turn = Rotation.from_quat(truth[:, 3:], scalar_first=True).inv() * Rotation.from_quat(
        predicted[:, 3:], scalar_first=True
    )
    angle = np.degrees(turn.magnitude())
    summary = evaluation.summary()
    assert summary["images"] == 6
    assert summary["mean_translation_error_m"] == pytest.approx(distance.mean())
    assert summary["median_translation_error_m"] == pytest.approx(np.median(distance))
    assert summary["mean_rotation_error_deg"] == pytest.approx(angle.mean())
    assert summary["median_rotation_error_deg"] == pytest.approx(np.median(angle))
    esa = (distance / np.linalg.norm(truth[:, :3], axis=1) + np.radians(angle)).mean()
    assert summary["esa_score"] == pytest.approx(esa)


def test_the_baseline_comes_from_the_training_split(evaluation, image_set):
    with (image_set / "train_poses_gt.csv").open() as file:
        rows = list(csv.DictReader(file))
    mean_x = np.mean([float(row["x"]) for row in rows])
    mean_up = np.mean([float(row["y"]) for row in rows])
    assert evaluation.baseline[0] == pytest.approx(mean_x)
    assert evaluation.baseline[1] == pytest.approx(-mean_up)
    distance = np.linalg.norm(evaluation.dataset.poses[:, :3] - evaluation.baseline[:3], axis=1)
    baseline = evaluation.summary()["mean_pose_baseline"]
    assert baseline["median_translation_error_m"] == pytest.approx(np.median(distance))


def test_mean_pose_agrees_with_scipy_whatever_the_signs():
    generator = np.random.default_rng(3)
    poses = generator.standard_normal((50, 7)) + np.array([0, 0, 9, 2, 0, 0, 0])
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    expected = Rotation.from_quat(poses[:, 3:], scalar_first=True).mean()
    poses[::2, 3:] *= -1
    mean = mean_pose(poses)
    np.testing.assert_allclose(mean[:3], poses[:, :3].mean(axis=0))
    np.testing.assert_allclose(mean[3:], expected.as_quat(canonical=True, scalar_first=True))


def test_mean_of_one_pose_is_that_pose():
    pose = np.array([1.0, 2, 3, 0.6, 0, 0.8, 0])
    np.testing.assert_allclose(mean_pose(pose[None]), pose, atol=1e-12)


def test_mean_of_no_poses_is_refused():
    with pytest.raises(ValueError, match="expected at least one pose"):
        mean_pose(np.zeros((0, 7)))


def test_perfect_predictions_have_no_error(evaluation):
    truth = evaluation.dataset.poses
    perfect = Evaluation(evaluation.dataset, truth, evaluation.baseline, 0.0).summary()
    assert perfect["mean_translation_error_m"] == 0
    assert perfect["mean_rotation_error_deg"] == pytest.approx(0, abs=1e-6)
    assert perfect["speed_plus_score"] == 0


def test_ranking_goes_from_best_to_worst(evaluation):
    scores = evaluation.errors.esa_score.numpy()[evaluation.ranking]
    assert (np.diff(scores) >= 0).all()


def test_typical_images_stand_about_the_median(evaluation):
    scores = evaluation.errors.esa_score.numpy()
    for count in (1, 2, len(scores), len(scores) + 1):
        chosen = evaluation.typical(count)
        assert len(set(chosen)) == min(count, len(scores))
        better = int((scores < scores[chosen].min()).sum())
        worse = int((scores > scores[chosen].max()).sum())
        assert abs(better - worse) <= 1


def test_files_hold_the_figures(evaluation, tmp_path):
    write_results(evaluation, tmp_path / "new")
    assert json.loads((tmp_path / "new/results.json").read_text()) == evaluation.summary()
    with (tmp_path / "new/predictions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == evaluation.dataset.names
    written = [float(row["translation_error_m"]) for row in rows]
    np.testing.assert_array_equal(written, evaluation.errors.translation_m)


def test_the_table_holds_model_and_baseline(evaluation):
    summary = evaluation.summary()
    line = next(s for s in format_table(summary).splitlines() if s.startswith("median_rot"))
    baseline = summary["mean_pose_baseline"]["median_rotation_error_deg"]
    assert line.split()[1:] == [f"{summary['median_rotation_error_deg']:.4f}", f"{baseline:.4f}"]


FX, FY = 32.0, 64 / 48 * 32.02315
"""URSO's focal lengths, of 64x48 pixels resized to 64x64."""


def sighted(path, camera):
    """Write weights that know the camera of their input, 64x64 pixels; return the network too."""
    fields = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2, "camera": camera}
    torch.manual_seed(0)
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields).eval()
    model.save_pretrained(path)
    return model


def test_the_sets_camera_is_the_weights(evaluation, image_set, tmp_path):
    """URSO's, within a part in a thousand."""
    sighted(tmp_path / "w.safetensors", (FX * 1.0009, FY, 32.0, 32.0 * 0.9991))
    found = evaluate(tmp_path / "w.safetensors", "urso", image_set)
    np.testing.assert_allclose(found.predicted, evaluation.predicted, atol=1e-5)


@pytest.mark.parametrize("place", range(4))
def test_images_of_another_camera_are_refused_with_both(image_set, tmp_path, place):
    camera = [FX, FY, 32.0, 32.0]
    camera[place] *= 1.0011
    sighted(tmp_path / "w.safetensors", camera)
    with pytest.raises(ValueError, match="--any-camera") as refused:
        evaluate(tmp_path / "w.safetensors", "urso", image_set)
    assert "a set of Camera(width=64, height=48, fx=32.0, fy=32.02315" in str(refused.value)
    assert f"fx={camera[0]}" in str(refused.value)


def test_any_camera_turns_images_into_the_view(image_set, tmp_path):
    model = sighted(tmp_path / "w.safetensors", (40.0, 30.0, 30.0, 35.0))
    found = evaluate(tmp_path / "w.safetensors", "urso", image_set, any_camera=True)
    view = Camera(64, 64, 40.0, 30.0, 30.0, 35.0)
    for index in range(len(found.dataset)):
        image = reproject(found.dataset.load_image(index), URSO_CAMERA.resized(*SIZE), view)
        with torch.no_grad():
            pose = model(Preprocessing(size=(64, 64))(image)[None])
        expected = torch.cat([pose.translation[0], pose.orientation[0]])
        np.testing.assert_allclose(found.predicted[index], expected, rtol=0, atol=1e-5)


def test_missing_weights_are_named(image_set, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors"):
        evaluate(tmp_path / "none.safetensors", "urso", image_set)
