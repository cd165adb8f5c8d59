import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from cambridge_sets import write_landmarks
from ffpose._internal.figures import save_figure
from ffpose.datasets import open_dataset
from ffpose.evaluation.evaluate import Evaluation
from ffpose.evaluation.report import plots
from ffpose.evaluation.report.plots import (
    GALLERY_TILE,
    draw_prediction,
    error_cdf,
    error_histograms,
    errors_by_distance,
    errors_by_view,
    gallery,
    predicted_angles,
    reliability_diagram,
    training_curves,
    write_evaluation_figures,
)
from ffpose.evaluation.report.results import format_table, write_results
from ffpose.geometry.symmetry import Axis, SymmetryGroup
from ffpose.imaging.preprocessing import Preprocessing
from tiny_runs import write_set

OFFSETS = np.array([0.5, 3.0, 1.0, 2.0])
"""Error of each image's predicted translation, meters."""


@pytest.fixture
def evaluation(tmp_path):
    root = write_set(tmp_path / "set", test=len(OFFSETS))
    dataset = open_dataset("urso", root, "test", Preprocessing())
    predicted = dataset.poses.copy()
    predicted[:, 0] += OFFSETS
    return Evaluation(dataset, predicted, dataset.poses.mean(axis=0), 0.0)


def test_a_camera_at_the_origin_of_its_world_is_evaluated(tmp_path):
    write_landmarks(tmp_path / "set")
    dataset = open_dataset("cambridge", tmp_path / "set", "test", Preprocessing())
    dataset.poses[0] = (0, 0, 0, 1, 0, 0, 0)
    predicted = dataset.poses.copy()
    predicted[:, 0] += OFFSETS
    evaluation = Evaluation(dataset, predicted, dataset.poses[1], 0.0)
    write_evaluation_figures(evaluation, tmp_path)
    write_results(evaluation, tmp_path)
    told = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)
    assert told["mean_translation_error_m"] == pytest.approx(OFFSETS.mean())
    assert "esa_score" not in told
    assert "in_plane" not in (tmp_path / "predictions.csv").read_text()
    assert "relative" not in format_table(told)
    assert told["groups"] == {}
    assert not (tmp_path / "errors_by_distance.png").exists()


def history(epochs):
    names = ("train_loss", "val_median_translation_error_m", "val_median_rotation_error_deg")
    return [{"epoch": n, **dict.fromkeys(names, 1 / n)} for n in range(1, epochs + 1)]


def test_cdf_is_that_of_the_errors(evaluation):
    axes = error_cdf(evaluation).axes[0]
    line = next(line for line in axes.lines if line.get_label() == "model")
    np.testing.assert_allclose(line.get_xdata(), np.sort(OFFSETS))
    np.testing.assert_allclose(line.get_ydata(), [0.25, 0.5, 0.75, 1.0])


def test_histograms_hold_every_image(evaluation):
    for axes in error_histograms(evaluation).axes:
        model, baseline = (sum(bar.get_height() for bar in group) for group in axes.containers)
        assert model == baseline == len(OFFSETS)


def test_the_map_has_the_median_of_each_direction(evaluation):
    """Cameras on +x and, twice, on −y, by hand; all other cells are empty."""
    at = {(1, 0, 0): [4.0], (0, -1, 0): [10.0, 60.0, 20.0]}
    truth, predicted = [], []
    for direction, errors in at.items():
        turn, _ = Rotation.align_vectors([[0, 0, -1]], [direction])
        for error in errors:
            found = turn * Rotation.from_euler("x", error, degrees=True)
            for poses, each in ((truth, turn), (predicted, found)):
                poses.append([0, 0, 9, *each.as_quat(scalar_first=True)])
    dataset = copy.copy(evaluation.dataset)
    dataset.poses = np.array(truth)
    figure = errors_by_view(replace(evaluation, dataset=dataset, predicted=np.array(predicted)))
    axes = figure.axes[0]
    assert axes.name == "mollweide"  # which is of equal area
    mesh, dots, crosses = axes.collections
    cells = mesh.get_array()
    assert sorted(cells.compressed()) == pytest.approx([4.0, 20.0])
    assert cells.size == 6 * 12
    assert len(crosses.get_offsets()) == 1
    places = np.concatenate([np.asarray(each.get_offsets()) for each in (dots, crosses)])
    np.testing.assert_allclose(places, [[0, 0], *[[-np.pi / 2, 0]] * 3], atol=1e-6)
    height = np.sin(np.asarray(mesh.get_coordinates())[:, 0, 1])
    np.testing.assert_allclose(np.diff(height), 1 / 3)  # cells of one area


def test_angles_are_drawn_over_the_true_ones(evaluation):
    truth = Rotation.from_quat(evaluation.dataset.poses[:, 3:], scalar_first=True)
    for axes, angle in zip(
        predicted_angles(evaluation).axes, truth.as_euler("ZYX", degrees=True).T[::-1], strict=True
    ):
        points = axes.collections[0].get_offsets()
        np.testing.assert_allclose(points, np.stack([angle, angle], axis=1), atol=1e-9)


def test_the_reliability_diagram_shows_the_share_within_each_region(evaluation):
    # Squared distances of 0.5² / 4, 3² / 4, 1 / 4 and 2² / 4 deviations along x.
    covariance = np.tile(4 * np.eye(3), (4, 1, 1))
    told = replace(evaluation, translation_covariance=covariance, rotation_covariance=covariance)
    line = next(
        n for n in reliability_diagram(told).axes[0].lines if n.get_label() == "translation"
    )
    within = chi2.cdf(OFFSETS**2 / 4, 3)
    expected = [(within <= level).mean() for level in line.get_xdata()]
    np.testing.assert_allclose(line.get_ydata(), expected)
    assert 0 < np.mean(expected) < 1


def test_distances_are_true_distances(evaluation):
    points = errors_by_distance(evaluation).axes[0].collections[0].get_offsets()
    distance = np.linalg.norm(evaluation.dataset.poses[:, :3], axis=1)
    np.testing.assert_allclose(np.sort(points[:, 0]), np.sort(distance))


def test_the_gallery_begins_with_the_worst(evaluation):
    names = evaluation.dataset.names
    order = np.argsort(-evaluation.errors.esa_score.numpy())
    drawn = gallery(evaluation, evaluation.ranking[::-1][:3].tolist())
    titles = [axes.get_title().splitlines()[0] for axes in drawn.axes[:3]]
    assert titles == [names[index] for index in order[:3]]


def test_a_drawn_prediction_is_of_the_gallerys_size_and_shows_axes(evaluation):
    drawn = draw_prediction(evaluation, 0)
    plain = evaluation.dataset.load_image(0).resize(drawn.size)
    assert drawn.width == GALLERY_TILE[0]
    assert np.abs(np.asarray(drawn, int) - np.asarray(plain, int)).max() > 100


def test_the_true_axes_are_those_that_errors_are_to(evaluation, monkeypatch):
    """Half a turn that leaves the look as it is makes no difference in a picture either."""
    drawn = []
    monkeypatch.setattr(
        plots, "draw_axes", lambda image, pose, *_, **__: drawn.append(pose) or image
    )
    predicted = evaluation.dataset.poses.copy()
    turned = Rotation.from_quat(predicted[:, 3:], scalar_first=True) * Rotation.from_rotvec(
        [0, 0, np.pi]
    )
    predicted[:, 3:] = turned.as_quat(scalar_first=True)
    group = SymmetryGroup((Axis((0, 0, 1), 2),))
    draw_prediction(replace(evaluation, predicted=predicted, symmetry=group), 0)
    true, found = drawn
    np.testing.assert_allclose(true.rotation, found.rotation, atol=1e-6)


def test_curves_show_each_epoch():
    for axes in training_curves(history(5)).axes:
        np.testing.assert_array_equal(axes.lines[0].get_xdata(), [1, 2, 3, 4, 5])


def test_figures_are_written_as_pictures(evaluation, tmp_path):
    unit = np.tile(np.eye(3), (4, 1, 1))
    told = replace(evaluation, translation_covariance=unit, rotation_covariance=unit)
    out = tmp_path / "out"
    out.mkdir()
    write_evaluation_figures(told, out)
    for path in out.iterdir():
        with Image.open(path) as image:
            assert image.width > 300
    names = "error_cdf error_histograms errors_by_distance predicted_angles typical worst"
    assert {path.stem for path in out.iterdir()} == {*names.split(), "reliability"}
    save_figure(training_curves(history(2)), tmp_path / "curves.svg")
    assert "<svg" in (tmp_path / "curves.svg").read_text()
