import csv
import json
import os
import re
import shlex
import subprocess
from dataclasses import replace

import pytest

from ffpose.demo import DemoConfig, run

pytestmark = pytest.mark.slow

SMALL = DemoConfig(
    images=30, size=(64, 48), epochs=1, model_fields=(("depth", 1), ("head_hidden", 16))
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    run(out, SMALL, quiet=True)
    return out


@pytest.fixture
def document(folder):
    return json.loads((folder / "report.json").read_text())


def test_report_json_holds_figures_baseline_and_range(document):
    for figures in (document, document["mean_pose_baseline"]):
        assert figures["median_translation_error_m"] > 0
        assert 0 < figures["median_rotation_error_deg"] <= 180
    assert document["images"] == 30
    assert document["train_seconds"] > 0
    assert document["seconds_per_step"]["render"] > 0
    assert document["attitude_range_deg"]["roll"] == [-20, 20]
    assert document["versions"]["ffpose"]


def test_every_file_named_is_there(document, folder):
    assert {"report.html", "report.json", "training/best.safetensors"} <= set(document["files"])
    assert all((folder / name).is_file() for name in document["files"])


def test_the_page_stands_alone(folder):
    page = (folder / "report.html").read_text()
    assert "data:image/jpeg;base64," in page
    assert "data:image/svg+xml;base64," in page
    for outside in ('src="http', "src='", "<script", "<link", "@import", 'src="/'):
        assert outside not in page
    texts = re.findall(r'<img [^>]*alt="([^"]*)"', page)
    assert len(texts) == page.count("<img ")
    assert sum("error" in text for text in texts) == 4  # the charts; an image shows its figures
    assert sum("roll, pitch and yaw" in text for text in texts) == 1
    for heading in ("Attitude, in two parts", "By condition"):
        assert f"<h2>{heading}</h2>" in page
    assert "<td>sunlit</td>" in page or "<td>eclipse</td>" in page


def test_the_command_runs_without_an_activated_environment(document):
    call = [*shlex.split(document["command"]), "--help"]
    environment = {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ}
    done = subprocess.run(call, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr


def test_a_demo_run_again_reports_the_work_that_was_done(folder, document, capsys):
    again = run(folder, SMALL)
    said = capsys.readouterr().err
    assert "render: all images were there already" in said
    assert "train: all 1 epochs were done already" in said
    for same in ("median_rotation_error_deg", "train_seconds", "images_rendered"):
        assert again[same] == document[same]
    for step in ("render", "train"):
        assert again["seconds_per_step"][step] == document["seconds_per_step"][step]
    page = (folder / "report.html").read_text()
    rows = dict(re.findall(r"<td>(seconds to [^<]+)</td><td>([^<]+)</td>", page))
    assert rows["seconds to render 30 images"] == f"{document['seconds_per_step']['render']:.1f}"
    with (folder / "training/results.csv").open() as file:
        trained = sum(float(row["seconds"]) for row in csv.DictReader(file))
    assert rows["seconds to train"] == f"{trained:.1f}"


def test_weights_of_other_settings_are_not_reported(folder):
    before = (folder / "report.json").read_bytes()
    with pytest.raises(ValueError, match="expected images 30 as the demo there, got 40"):
        run(folder, replace(SMALL, images=40), quiet=True)
    assert (folder / "report.json").read_bytes() == before


def test_a_training_of_unknown_settings_is_not_reported(tmp_path):
    (tmp_path / "training").mkdir()
    with pytest.raises(ValueError, match=r"got training/ without demo\.json"):
        run(tmp_path, SMALL, quiet=True)
