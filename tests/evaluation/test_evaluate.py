import csv
import json
import shutil
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ffpose import load
from ffpose.datasets import Conditions, Decoding, read_conditions
from ffpose.errors import DataError
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.evaluate import Evaluation, evaluate
from ffpose.evaluation.report.results import format_table, write_results
from ffpose.evaluation.report.tables import figures_table, uncertainty_table
from ffpose.geometry import URSO_CAMERA, Camera, DistortedCamera
from ffpose.geometry.symmetry import IDENTITY, Axis, SymmetryGroup
from ffpose.imaging.reprojection import reproject
from ffpose.models import FilterformerPose, PosePrediction, build_network, read_metadata
from tiny_runs import SIZE, write_set

HALF_TURN = SymmetryGroup((Axis((0, 0, 1), 2),))
"""The group of an object that looks the same after half a turn about its z."""


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
    preprocessing = read_metadata(weights).preprocessing
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


def test_errors_are_modulo_the_symmetry_and_the_others_are_told(evaluation, tmp_path):
    """Predictions that are off by half a turn about the object's z, and 5 degrees about its x."""
    truth = Rotation.from_quat(evaluation.dataset.poses[:, 3:], scalar_first=True)
    off = truth * Rotation.from_rotvec((0, 0, np.pi)) * Rotation.from_euler("x", 5, degrees=True)
    predicted = evaluation.dataset.poses.copy()
    predicted[:, 3:] = off.as_quat(scalar_first=True)
    folded = Evaluation(evaluation.dataset, predicted, evaluation.baseline, 0.0, symmetry=HALF_TURN)
    summary = folded.summary()
    assert summary["median_rotation_error_deg"] == pytest.approx(5)
    assert summary["mean_rotation_error_deg"] == pytest.approx(5)
    plain = np.degrees((truth.inv() * off).magnitude()).mean()
    assert summary["without_symmetry"]["mean_rotation_error_deg"] == pytest.approx(plain)
    assert summary["without_symmetry"]["axes"] == [{"axis": [0, 0, 1], "fold": 2}]
    constant = Rotation.from_quat(evaluation.baseline[3:], scalar_first=True)
    turns = [Rotation.identity(), Rotation.from_rotvec((0, 0, np.pi))]
    least = np.min([np.degrees(((truth * g).inv() * constant).magnitude()) for g in turns], axis=0)
    baseline = summary["mean_pose_baseline"]
    assert baseline["mean_rotation_error_deg"] == pytest.approx(least.mean())
    lines = format_table(summary).splitlines()
    assert any(line.startswith("mean_rotation_error_deg, no symmetry") for line in lines)
    ends = {line.index(".", 30) for line in lines[1:-1]}
    assert len(ends) == 1  # in one column, however long the names are
    assert "without_symmetry" not in evaluation.summary()
    # The same where it nearly leaves the look: the errors themselves stay as they are.
    apart = Evaluation(
        evaluation.dataset, predicted, evaluation.baseline, 0.0, unfolded=(HALF_TURN,)
    ).summary()
    assert apart["mean_rotation_error_deg"] == pytest.approx(plain)
    (near,) = apart["modulo_unfolded"]
    assert near["axes"] == [{"axis": [0, 0, 1], "fold": 2}]
    assert near["median_rotation_error_deg"] == pytest.approx(5)
    assert near["mean_pose_baseline"]["mean_rotation_error_deg"] == pytest.approx(least.mean())
    assert "modulo 2-fold about (0, 0, 1), which is not folded" in figures_table(apart)
    assert "modulo_unfolded" not in evaluation.summary()


def test_images_are_decoded_as_in_training(image_set, tmp_path):
    root = shutil.copytree(image_set, tmp_path / "bent")
    camera = {"width": SIZE[0], "height": SIZE[1], "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
    (root / "camera.json").write_text(json.dumps(camera | {"distortion": [0.3, 0, 0, 0, 0]}))
    fields = {"image_size": (48, 64), "depth": 1, "dim": 16, "heads": 2}
    model = FilterformerPose.from_config("tiny", backbone_weights="none", **fields)
    lenses = {}
    for undistort in (False, True):
        path = tmp_path / f"{undistort}.safetensors"
        model.save_pretrained(path, recipe={"data": {"undistort": undistort, "white": None}})
        lenses[undistort] = evaluate(path, "urso", root).dataset.records[0].lens
    assert lenses[False] is None
    assert lenses[True].distortion == (0.3, 0, 0, 0, 0)


def test_one_part_of_the_decoding_leaves_the_other_as_in_training(image_set, tmp_path):
    model = FilterformerPose.from_config("tiny", backbone_weights="none", image_size=(48, 64))
    said = {"data": {"undistort": True, "white": 4095}}
    model.save_pretrained(tmp_path / "w.safetensors", recipe=said)
    root = shutil.copytree(image_set, tmp_path / "bent")
    camera = {"width": SIZE[0], "height": SIZE[1], "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
    (root / "camera.json").write_text(json.dumps(camera | {"distortion": [0.3, 0, 0, 0, 0]}))
    for path in root.glob("*.png"):
        Image.fromarray(np.full((SIZE[1], SIZE[0]), 1000, np.uint16)).save(path)
    for given, white in ((Decoding(undistort=True), 4095), (Decoding(white=1023), 1023)):
        found = evaluate(tmp_path / "w.safetensors", "urso", root, decoding=given)
        assert all(record.lens is not None for record in found.dataset.records)
        assert {record.white for record in found.dataset.records} == {white}


BENT = DistortedCamera(*SIZE, 50.0, 50.0, 32.0, 24.0, distortion=(-0.3, 0.05, 0, 0, 0))


def set_of(camera, image_set, folder):
    root = shutil.copytree(image_set, folder)
    (root / "camera.json").write_text(json.dumps(asdict(camera)))
    return root


def test_a_network_of_the_frame_sees_distortion_as_in_training(image_set, tmp_path):
    """Images as the lens made them, where those of the training were such; else undistorted."""
    root = set_of(BENT, image_set, tmp_path / "bent")
    straight = set_of(BENT.pinhole, image_set, tmp_path / "straight")
    fields = {"camera": (50.0, 50.0, 32.0, 24.0)}
    torch.manual_seed(0)
    model = FilterformerPose.from_config(
        "tiny", backbone_weights="none", image_size=(48, 64), depth=1, dim=16, heads=2, **fields
    )
    paths = {}
    for distorted, data in ((True, {"distortion": list(BENT.distortion)}), (False, {})):
        paths[distorted] = tmp_path / f"{distorted}.safetensors"
        model.save_pretrained(paths[distorted], data=data)
    as_they_are = evaluate(paths[False], "urso", straight)
    found = evaluate(paths[True], "urso", root)
    np.testing.assert_array_equal(found.predicted, as_they_are.predicted)
    with pytest.raises(ValueError, match=r"without distortion, got .*; --data.undistort takes it"):
        evaluate(paths[False], "urso", root)
    with pytest.raises(ValueError, match=r"with the distortion \(-0.3, 0.05, .*, got a set of"):
        evaluate(paths[True], "urso", straight, reproject=True)
    with pytest.raises(ValueError, match=r"with the distortion \(-0.3, 0.05, .*; --resize takes"):
        load(paths[True], camera=replace(BENT, distortion=(0.1, 0, 0, 0, 0)), device="cpu")
    undistorted = evaluate(paths[False], "urso", root, decoding=Decoding(True))
    assert np.abs(undistorted.predicted - found.predicted).max() > 1e-4
    image = found.dataset.records[0].image
    for distorted, of_the_set in ((True, found), (False, undistorted)):
        pose = load(paths[distorted], camera=BENT, device="cpu")(image)
        np.testing.assert_allclose(pose.t, of_the_set.predicted[0, :3], rtol=0, atol=1e-4)


def test_labels_that_locate_the_camera_are_no_objects(tmp_path):
    pose = np.eye(4)
    pose[2, 3] = 5
    for split in ("Train", "Test"):
        folder = tmp_path / "rooms/seq-01"
        folder.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"rooms/{split}Split.txt").write_text("sequence1\n")
    Image.new("RGB", (64, 48)).save(folder / "frame-000000.color.png")
    np.savetxt(folder / "frame-000000.pose.txt", pose)
    model = FilterformerPose.from_config("tiny", backbone_weights="none", image_size=(48, 64))
    model.save_pretrained(tmp_path / "w.safetensors")
    with pytest.raises(ValueError, match=r"locate the object, as .*, which locate the camera"):
        evaluate(tmp_path / "w.safetensors", "sevenscenes", tmp_path / "rooms")


def test_a_second_look_refuses_distortion_that_is_not_taken_out(image_set, tmp_path):
    """The pinhole part of the camera is the weights': the lens bends the images alone."""
    root = set_of(BENT, image_set, tmp_path / "bent")
    fields = {
        "image_size": (48, 64),
        "camera": (50.0, 50.0, 32.0, 24.0),
        "first_stride": 4,
        "object_size": (16, 32),
        "object_width": 32,
    }
    torch.manual_seed(0)
    model = build_network("polar", backbone_weights="none", **fields)
    model.save_pretrained(tmp_path / "w.safetensors")
    with pytest.raises(ValueError, match=r"without distortion, got .*; --data.undistort takes it"):
        evaluate(tmp_path / "w.safetensors", "urso", root)
    taken_out = evaluate(tmp_path / "w.safetensors", "urso", root, decoding=Decoding(True))
    turned = evaluate(tmp_path / "w.safetensors", "urso", root, reproject=True)
    straight = evaluate(tmp_path / "w.safetensors", "urso", image_set, reproject=True)
    np.testing.assert_allclose(turned.predicted, taken_out.predicted, rtol=0, atol=1e-4)
    assert np.abs(straight.predicted - taken_out.predicted).max() > 1e-3
    empty = tmp_path / "empty"
    empty.mkdir()
    for number, record in enumerate(taken_out.dataset.records):
        shutil.copy(record.image, empty / f"{number}.png")
    same = evaluate(tmp_path / "w.safetensors", "urso", root, decoding=Decoding(True), empty=empty)
    np.testing.assert_allclose(same.in_view_empty, same.in_view, rtol=1e-5)
    Image.new("RGB", (10, 10)).save(empty / "a.png")
    with pytest.raises(DataError, match=r"a\.png: expected 64x48 pixels, as images of"):
        evaluate(tmp_path / "w.safetensors", "urso", root, decoding=Decoding(True), empty=empty)


def test_the_baseline_is_of_the_set_or_the_training_or_the_images_themselves(image_set, tmp_path):
    """A set's own training split tells its constant, whatever the weights were trained on."""
    alone = shutil.copytree(image_set, tmp_path / "alone")
    (alone / "train_images.csv").unlink()
    elsewhere = [1.0, 2.0, 30.0, 1.0, 0.0, 0.0, 0.0]
    model = FilterformerPose.from_config("tiny", backbone_weights="none", image_size=(48, 64))
    model.save_pretrained(tmp_path / "w.safetensors")
    model.save_pretrained(tmp_path / "told.safetensors", data={"mean_pose": elsewhere})
    own = evaluate(tmp_path / "told.safetensors", "urso", image_set)
    assert own.summary()["mean_pose_baseline"]["of"] == f"the split train of {image_set.name}"
    told = evaluate(tmp_path / "told.safetensors", "urso", alone)
    np.testing.assert_array_equal(told.baseline, elsewhere)
    assert format_table(told.summary()).endswith("mean pose: of the weights' training")
    away = shutil.copytree(image_set, tmp_path / "away")  # of the training the table alone is there
    (name, *_) = (away / "train_images.csv").read_text().split()[1:]
    next(away.glob(name)).unlink()
    for weights, of in (("told", "the weights' training"), ("w", "the images themselves")):
        path = tmp_path / f"{weights}.safetensors"
        assert evaluate(path, "urso", away, split="test").baseline_of == of
    themselves = evaluate(tmp_path / "w.safetensors", "urso", alone)
    np.testing.assert_array_equal(themselves.baseline, mean_pose(themselves.dataset.poses))
    assert themselves.baseline_of == "the images themselves"


def test_a_training_split_that_cannot_be_read_is_told(weights, image_set, tmp_path, caplog):
    """The constant pose is then another's; an absent split is nothing to tell."""
    root = shutil.copytree(image_set, tmp_path / "broken")
    labels = root / "train_poses_gt.csv"
    header, first, *others = labels.read_text().splitlines()
    labels.write_text("\n".join([header, "nan," + first.partition(",")[2], *others]))
    assert evaluate(weights, "urso", root).baseline_of == "the images themselves"
    (told,) = caplog.messages
    assert told.startswith("the baseline is not of the split train, which gives no mean pose: ")
    assert f"{labels}:2: " in told
    caplog.clear()
    (root / "train_images.csv").unlink()
    assert evaluate(weights, "urso", root).baseline_of == "the images themselves"
    assert not caplog.messages


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


def rotations(poses):
    return Rotation.from_quat(poses[:, 3:], scalar_first=True)


def degrees_between(one, other):
    return np.degrees((one * other.inv()).magnitude())


def test_the_parts_and_the_relative_error_are_medians_of_each_image(evaluation):
    truth, predicted = evaluation.dataset.poses, evaluation.predicted
    distance = np.linalg.norm(truth[:, :3], axis=1)
    ray = truth[:, :3] / distance[:, None]
    seen, shown = (rotations(p).inv().apply(ray) for p in (truth, predicted))
    out_of_plane = np.degrees(np.arccos((seen * shown).sum(axis=1)))
    summary = evaluation.summary()
    assert summary["median_out_of_plane_error_deg"] == pytest.approx(np.median(out_of_plane))
    assert summary["mean_out_of_plane_error_deg"] == pytest.approx(out_of_plane.mean())
    relative = np.linalg.norm(truth[:, :3] - predicted[:, :3], axis=1) / distance
    assert summary["mean_relative_translation_error"] == pytest.approx(relative.mean())
    low, high = summary["median_intervals_95"]["median_relative_translation_error"]
    assert relative.min() <= low < np.median(relative) < high <= relative.max()
    assert set(summary["mean_pose_baseline"]) - {"pose", "of"} < set(summary)


def test_oracles_know_one_part_and_have_the_constants_error_in_the_other(evaluation):
    truth = evaluation.dataset.poses
    ray = truth[:, :3] / np.linalg.norm(truth[:, :3], axis=1, keepdims=True)
    mean = rotations(np.broadcast_to(evaluation.baseline, truth.shape))
    # Of all attitudes with the constant's viewing direction, the nearest to the truth.
    turns = [Rotation.from_rotvec(angle * ray) for angle in np.linspace(-np.pi, np.pi, 3601)]
    nearest = np.min([degrees_between(turn * mean, rotations(truth)) for turn in turns], axis=0)
    # The true viewing direction, turned as far about it as the constant is.
    cosine = (mean.inv().apply(ray) * rotations(truth).inv().apply(ray)).sum(axis=1)
    swing = np.degrees(np.arccos(cosine))
    told = evaluation.summary()["oracles"]
    in_plane_known, out_of_plane_known = told["in_plane_known"], told["out_of_plane_known"]
    assert in_plane_known["mean_rotation_error_deg"] == pytest.approx(nearest.mean(), abs=1e-2)
    assert in_plane_known["mean_in_plane_error_deg"] == 0
    assert in_plane_known["mean_out_of_plane_error_deg"] == pytest.approx(swing.mean())
    assert out_of_plane_known["mean_out_of_plane_error_deg"] == 0
    whole = degrees_between(mean, rotations(truth))
    # Swing and twist: cos(E / 2) = cos(S / 2) cos(T / 2).
    twist = 2 * np.arccos(np.cos(np.radians(whole) / 2) / np.cos(np.radians(swing) / 2))
    for part in ("rotation", "in_plane"):
        found = out_of_plane_known[f"median_{part}_error_deg"]
        assert found == pytest.approx(np.median(np.degrees(twist)))


def test_correlations_tell_a_learned_angle_from_a_constant_one(image_set, evaluation):
    truth = evaluation.dataset.poses
    roll, _, yaw = rotations(truth).as_euler("ZYX").T[::-1]
    answer = Rotation.from_euler("ZYX", np.stack([yaw, np.full(6, 0.2), roll + 0.5], axis=1))
    predicted = np.concatenate([truth[:, :3], answer.as_quat(scalar_first=True)], axis=1)
    found = Evaluation(evaluation.dataset, predicted, evaluation.baseline, 0.0).summary()
    assert found["correlation"] == {
        "roll": pytest.approx(1),
        "pitch": None,
        "yaw": pytest.approx(1),
    }


def test_perfect_predictions_have_no_error(evaluation):
    truth = evaluation.dataset.poses
    perfect = Evaluation(evaluation.dataset, truth, evaluation.baseline, 0.0).summary()
    assert perfect["mean_translation_error_m"] == 0
    assert perfect["mean_rotation_error_deg"] == pytest.approx(0, abs=1e-6)
    assert perfect["speed_plus_score"] == 0


def test_the_share_of_large_errors_has_all_digits_of_float64(evaluation):
    predicted = evaluation.dataset.poses.copy()
    off = rotations(predicted[:1]) * Rotation.from_euler("x", 40, degrees=True)
    predicted[:1, 3:] = off.as_quat(scalar_first=True)
    found = Evaluation(evaluation.dataset, predicted, evaluation.baseline, 0.0).summary()
    assert found["share_over_30_deg"] == 1 / 6


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
    for column, errors in (
        ("translation_error_m", evaluation.errors.translation_m),
        ("in_plane_error_deg", evaluation.errors.in_plane_deg),
        ("out_of_plane_error_deg", evaluation.errors.out_of_plane_deg),
    ):
        np.testing.assert_array_equal([float(row[column]) for row in rows], errors)


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
    with pytest.raises(ValueError, match="--reproject") as refused:
        evaluate(tmp_path / "w.safetensors", "urso", image_set)
    assert "a set of Camera(width=64, height=48, fx=32.0, fy=32.02315" in str(refused.value)
    assert f"fx={camera[0]}" in str(refused.value)


def test_images_of_another_camera_are_reprojected_to_the_view(image_set, tmp_path):
    model = sighted(tmp_path / "w.safetensors", (40.0, 30.0, 30.0, 35.0))
    found = evaluate(tmp_path / "w.safetensors", "urso", image_set, reproject=True)
    view = Camera(64, 64, 40.0, 30.0, 30.0, 35.0)
    preprocessing = read_metadata(tmp_path / "w.safetensors").preprocessing
    for index in range(len(found.dataset)):
        shown, source = found.dataset.load_image(index), URSO_CAMERA.resized(*SIZE)
        image = reproject(shown, source, view, preprocessing.interpolation)
        with torch.no_grad():
            pose = model(preprocessing(image)[None])
        expected = torch.cat([pose.translation[0], pose.orientation[0]])
        np.testing.assert_allclose(found.predicted[index], expected, rtol=0, atol=1e-5)


def test_groups_hold_every_image_once_in_each_partition(evaluation):
    eclipsed = np.array([True, False, False, False, True, False])
    angle = np.array([10.0, 20, 89.9, 90, 150, 170])
    earth = np.array([True, True, True, True, True, False])
    share = np.array([1.0, 1, 0.95, 0.9, 0.6, 0.2])
    conditions = Conditions(eclipsed, angle, earth, share)
    fields = (evaluation.dataset, evaluation.predicted, evaluation.baseline, 0.0, conditions)
    groups = Evaluation(*fields).summary()["groups"]
    counts = {name: {g["group"]: g["images"] for g in found} for name, found in groups.items()}
    assert [*counts["distance"].values()] == [2, 2, 2]
    assert counts["lighting"] == {"sunlit": 4, "front-lit": 2, "back-lit": 2, "eclipse": 2}
    assert counts["background"] == {"Earth behind": 5, "space behind": 1}
    assert counts["in_frame"] == {
        "whole": 2, "90 % or more": 2, "50 to 90 %": 1, "less than 50 %": 1,
    }  # fmt: skip
    error = evaluation.errors.translation_m.numpy()
    back_lit = next(g for g in groups["lighting"] if g["group"] == "back-lit")
    assert back_lit["median_translation_error_m"] == pytest.approx(error[[1, 2]].mean())
    distance = np.linalg.norm(evaluation.dataset.poses[:, :3], axis=1)
    far = error[np.argsort(distance)[4:]]
    assert groups["distance"][2]["median_translation_error_m"] == pytest.approx(far.mean())


def test_a_set_without_conditions_has_groups_of_distance_alone(evaluation, image_set):
    assert read_conditions(image_set, evaluation.dataset.names) is None
    assert list(evaluation.summary()["groups"]) == ["distance"]


class Uncertain(NamedTuple):
    translation: torch.Tensor
    orientation: torch.Tensor
    translation_covariance: torch.Tensor
    rotation_covariance: torch.Tensor
    in_view: torch.Tensor


def test_what_a_network_says_of_its_errors_is_kept_image_by_image(
    evaluation, weights, image_set, monkeypatch, tmp_path
):
    def forward(self, images):
        count = len(images)
        level = images.mean((1, 2, 3)).sigmoid()
        pose = PosePrediction(torch.ones(count, 3), torch.tensor([[1.0, 0, 0, 0]] * count))
        matrix = level[:, None, None] * torch.eye(3)
        return Uncertain(*pose, 4 * matrix, 0.01 * matrix, level)

    monkeypatch.setattr(FilterformerPose, "forward", forward)
    random = np.random.default_rng(0)
    for name in ("a.png", "b.JPG"):
        Image.fromarray(random.integers(0, 256, (96, 128, 3), np.uint8)).save(tmp_path / name)
    found = evaluate(weights, "urso", image_set, batch_size=4, empty=tmp_path)
    preprocessing = evaluation.dataset.preprocessing
    files = (tmp_path / "a.png", tmp_path / "b.JPG")
    levels = [float(preprocessing(Image.open(file)).mean().sigmoid()) for file in files]
    np.testing.assert_allclose(found.in_view_empty, levels, rtol=1e-5)
    assert 0 <= found.summary()["uncertainty"]["in_view"]["auroc"] <= 1
    level = [float(found.dataset[i].image.mean().sigmoid()) for i in range(6)]
    np.testing.assert_allclose(found.in_view, level, rtol=1e-5)
    np.testing.assert_allclose(found.translation_covariance[:, 1, 1], 4 * found.in_view, rtol=1e-6)
    np.testing.assert_allclose(found.rotation_covariance[:, 2, 2], found.in_view / 100, rtol=1e-6)


def test_empty_images_need_a_folder_and_a_network_that_knows(weights, image_set, tmp_path):
    with pytest.raises(FileNotFoundError, match="empty: expected PNG, JPEG or PGM files in"):
        evaluate(weights, "urso", image_set, empty=tmp_path)
    root = shutil.copytree(image_set, tmp_path / "set")
    last = (root / "test_images.csv").read_text().split()[-1]
    (root / last).write_bytes(b"")  # it is told before the images are posed
    with pytest.raises(ValueError, match="empty: expected weights that predict whether"):
        evaluate(weights, "urso", root, empty=next(image_set.rglob("*.png")).parent)


@pytest.fixture
def uncertain(evaluation):
    """Predictions of the truth, moved and turned by known multiples of known deviations."""
    truth = evaluation.dataset.poses
    steps = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 4.0])[:, None]
    axis = np.array([[0.0, 0.6, 0.8]])
    turned = Rotation.from_rotvec(-0.01 * steps * axis) * rotations(truth)
    moved = truth[:, :3] + 0.2 * steps * axis
    predicted = np.concatenate([moved, turned.as_quat(scalar_first=True)], axis=1)
    return Evaluation(
        evaluation.dataset,
        predicted,
        evaluation.baseline,
        0.0,
        translation_covariance=np.tile(0.04 * np.eye(3), (6, 1, 1)),
        rotation_covariance=np.tile(0.0001 * np.eye(3), (6, 1, 1)),
        in_view=np.array([0.4, 0.9, 0.9, 0.95, 0.99, 1.0]),
        in_view_empty=np.array([0.1, 0.9, 0.3, 0.2]),
        in_view_threshold=0.5,
    )


def test_coverage_and_flag_by_hand(uncertain):
    """Radii of the 50, 90 and 99 % regions in three dimensions: 1.538, 2.500, 3.368 deviations."""
    told = uncertain.summary()["uncertainty"]
    for name in ("translation", "rotation"):
        assert [told[name][f"coverage_{n}"] for n in (50, 90, 99)] == [3 / 6, 5 / 6, 5 / 6]
    assert told["translation"]["median_sigma_m"] == pytest.approx(0.2)
    assert told["rotation"]["median_sigma_deg"] == pytest.approx(np.degrees(0.01))
    assert told["in_view"] == {
        "threshold": 0.5,
        "false_alarm_rate": pytest.approx(1 / 6),
        "miss_rate": 0.25,
        "auroc": pytest.approx((3 + 2 * 3.5 + 3 * 4) / 24),
    }


def test_without_a_threshold_nothing_is_flagged(uncertain):
    told = replace(uncertain, in_view_threshold=None).summary()
    assert told["uncertainty"]["in_view"] == {"auroc": pytest.approx(22 / 24)}
    assert "flagged" not in uncertainty_table(told)
    alone = replace(uncertain, in_view_threshold=None, in_view_empty=None).summary()
    assert "in_view" not in alone["uncertainty"]


@pytest.mark.parametrize("symmetric", [False, True])
def test_regions_are_of_both_modes(uncertain, symmetric, tmp_path):
    """What is half a turn off, with the second mode where `uncertain` has its only one.

    Gaussian densities of 0.6 and 0.4 times one are the same where d² differs by 2 log 1.5. After
    half a turn that leaves the look as it is the first mode is as good as the second.
    """
    half = Rotation.from_rotvec([0, 0, np.pi])
    off = uncertain.predicted.copy()
    off[:, 3:] = (rotations(off) * half).as_quat(scalar_first=True)
    group = SymmetryGroup((Axis((0, 0, 1), 2),)) if symmetric else IDENTITY
    both = replace(
        uncertain,
        predicted=off,
        alternative=uncertain.predicted[:, 3:],
        probabilities=np.tile([0.6, 0.4], (6, 1)),
        symmetry=group,
    )
    d2, apart = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 4.0]) ** 2, 2 * np.log(1.5)
    first, second = (d2, d2 - apart) if symmetric else (d2 + apart, d2)
    expected = 0.6 * chi2.cdf(first, 3) + 0.4 * chi2.cdf(second, 3)
    np.testing.assert_allclose(both.region_probabilities["rotation"], expected, atol=1e-6)
    modes = both.summary()["uncertainty"]["modes"]
    assert modes == {"share_over_30_deg": 0 if symmetric else 1, "share_over_30_deg_of_both": 0}
    write_results(both, tmp_path)
    with (tmp_path / "predictions.csv").open() as file:
        row = list(csv.DictReader(file))[5]
    assert float(row["alternative_rotation_error_deg"]) == pytest.approx(np.degrees(0.04))
    assert [float(row[f"{name}probability"]) for name in ("", "alternative_")] == [0.6, 0.4]
    assert "the second most likely one too</td><td>0.0 %" in uncertainty_table(both.summary())
    alone = replace(both, alternative=None, probabilities=None, symmetry=IDENTITY)
    assert (alone.region_probabilities["rotation"] == 1).all()


def test_uncertainty_stands_in_the_files(uncertain, evaluation, tmp_path):
    write_results(uncertain, tmp_path)
    with (tmp_path / "predictions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[1]["sigma_tz_m"]) == pytest.approx(0.2)
    assert float(rows[1]["sigma_rx_deg"]) == pytest.approx(np.degrees(0.01))
    assert float(rows[1]["in_view"]) == 0.9
    assert "uncertainty" in json.loads((tmp_path / "results.json").read_text())
    write_results(evaluation, tmp_path / "plain")
    assert "in_view" not in (tmp_path / "plain/predictions.csv").read_text()
    assert "uncertainty" not in evaluation.summary()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"translation_covariance": np.zeros((6, 3, 3))}, "translation_covariance: .* in row 0"),
        ({"rotation_covariance": np.ones((5, 3, 3))}, r"rotation_cov.*expected shape \(6, 3, 3\)"),
        ({"rotation_covariance": None}, "expected both or none, got one"),
        ({"in_view": np.full(6, 1.5)}, "in_view: expected probabilities, got 1.5"),
        ({"in_view": np.ones(5)}, r"in_view: expected shape \(6,\), got \(5,\)"),
        ({"in_view_empty": np.array([])}, r"in_view_empty: expected shape \(M,\)"),
    ],
)
def test_an_uncertainty_that_is_none_is_refused(evaluation, wrong, message):
    fields = (evaluation.dataset, evaluation.predicted, evaluation.baseline, 0.0)
    unit = np.tile(np.eye(3), (6, 1, 1))
    right = {"translation_covariance": unit, "rotation_covariance": unit}
    with pytest.raises(ValueError, match=message):
        Evaluation(*fields, **(right | wrong)).summary()


def test_a_split_of_one_image_is_evaluated(weights, tmp_path):
    root = write_set(tmp_path / "set", test=1)
    assert evaluate(weights, "urso", root).summary()["images"] == 1


def test_missing_weights_are_named(image_set, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors"):
        evaluate(tmp_path / "none.safetensors", "urso", image_set)
