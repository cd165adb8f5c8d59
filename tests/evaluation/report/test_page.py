"""What the page says of models that are better, worse, perfect, and of a baseline that is."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ffpose.datasets import open_dataset
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.evaluate import Evaluation
from ffpose.evaluation.report.page import write_report
from ffpose.evaluation.report.tables import comparison, conditions_table, figures_table, headline
from ffpose.imaging.preprocessing import Preprocessing
from tiny_runs import write_set

HISTORY = [
    {
        "epoch": 1,
        "train_loss": 1.0,
        "val_median_translation_error_m": 1.0,
        "val_median_rotation_error_deg": 1.0,
    }
]


@pytest.fixture(autouse=True)
def _unwritten(monkeypatch):
    """Figures are drawn, but not written, which takes seconds and which `test_plots` does."""
    monkeypatch.setattr(Figure, "savefig", lambda _, file, **options: file.write(b"<svg/>"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = write_set(tmp_path_factory.mktemp("report") / "set", test=5)
    return open_dataset("urso", root, "test", Preprocessing())


def moved(dataset, meters, baseline):
    """An evaluation whose translations are all off by so many meters."""
    predicted = dataset.poses + np.array([meters, 0, 0, 0, 0, 0, 0])
    return Evaluation(dataset, predicted, baseline, 0.0)


def page(evaluation, path):
    told = {"title": "title", "subtitle": "subtitle", "command": "command"}
    write_report(path, evaluation, history=HISTORY, facts={}, **told)
    return path.read_text()


@pytest.mark.parametrize(
    ("model", "baseline", "words"),
    [
        (1.0, 4.0, "4 times smaller than that of the mean pose"),
        (4.0, 1.0, "4 times that of the mean pose"),
        (1.0, 1.0, "the same as that of the mean pose"),
        (0.0, 1.0, "smaller than that of the mean pose"),
        (1.0, 0.0, "larger than that of the mean pose"),
        (0.0, 0.0, "the same as that of the mean pose"),
    ],
)
def test_words_say_which_is_better(model, baseline, words):
    assert comparison(model, baseline) == words


def test_a_model_worse_than_the_mean_pose_is_not_called_better(dataset):
    far = 50.0
    summary = moved(dataset, far, mean_pose(dataset.poses)).summary()
    card = headline(summary).split('<div class="card">')[1]
    baseline = summary["mean_pose_baseline"]["median_translation_error_m"]
    assert far > baseline
    assert f"{far / baseline:.3g} times that of the mean pose, {baseline:.2f} m" in card
    assert "smaller" not in card


def test_a_baseline_without_error_divides_nothing(dataset, tmp_path):
    """All images show one pose, so that the mean pose is right on all."""
    poses = np.tile(dataset.poses[:1], (5, 1))
    one = open_dataset("urso", dataset.records[0].source.parent, "test", Preprocessing())
    one.poses = poses
    for meters, words in ((2.0, "larger than that of"), (0.0, "the same as that of")):
        evaluation = moved(one, meters, poses[0])
        summary = evaluation.summary()
        assert summary["mean_pose_baseline"]["median_translation_error_m"] == 0
        assert words in headline(summary)
        row = next(
            r for r in figures_table(summary).split("<tr>") if "median translation error<" in r
        )
        assert "<td>–</td>" in row
        text = re.sub(r"base64,[^\"]*", "", page(evaluation, tmp_path / "report.html"))
        assert "nan" not in text


def test_the_page_shows_parts_conditions_and_uncertainty(dataset, tmp_path):
    evaluation = moved(dataset, 0.1, mean_pose(dataset.poses))
    plain = page(evaluation, tmp_path / "plain.html")
    assert "oracle: in-plane known" in plain
    assert "the mean of the weights' training;" in html.unescape(plain)
    assert "Predicted uncertainty" not in plain
    sure = replace(
        evaluation,
        translation_covariance=np.tile(np.eye(3), (5, 1, 1)),
        rotation_covariance=np.tile(np.eye(3), (5, 1, 1)),
        in_view=np.linspace(0.2, 1, 5),
        in_view_empty=np.array([0.1]),
        in_view_threshold=0.5,
    )
    told = page(sure, tmp_path / "told.html")
    assert "Predicted uncertainty" in told
    assert "<td>truths in the 90 % region of translation</td><td>100.0 %</td>" in told
    assert "truths in the 90 % region of rotation" in told
    assert "<td>images with it that are flagged</td><td>40.0 %</td>" in told
    assert "<td>area under the ROC curve</td><td>1.0000</td>" in told
    assert told.count("<img ") == plain.count("<img ") + 1


def test_every_group_has_a_row(dataset):
    summary = moved(dataset, 0.1, mean_pose(dataset.poses)).summary()
    table = conditions_table(summary)
    assert table.count("<tr>") == 1 + len(summary["groups"]["distance"])
    assert table.count("<td>0.1 m</td>") == len(summary["groups"]["distance"])
