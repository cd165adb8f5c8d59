import csv
import json
import os
import re
import shlex
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from ffpose._internal import zoo
from ffpose._internal.seeds import CHOICES
from ffpose.demo import config as demo_config
from ffpose.demo.config import DemoConfig
from ffpose.demo.record import FOLDERS
from ffpose.demo.run import _resumable, run
from ffpose.geometry import URSO_CAMERA, Pose
from ffpose.imaging.patches import LABELS
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import build_network
from ffpose.render.renderer import label
from ffpose.training.checkpoint import RunFolder, TrainState
from figures import blank_figures

pytestmark = pytest.mark.slow

SIZE = (64, 48)
FIELDS = {
    "image_size": [48, 64],  # as YAML gives it back
    "first_stride": 4,
    "first_reduction": 4,
    "object_size": [16, 48],
    "directions": 50,
    "latent": 16,
}
POSE = DemoConfig(images=12, size=SIZE)
TRAIN = DemoConfig(
    images=12,
    size=SIZE,
    train=True,
    views=32,
    validation=2,
    calibration=4,
    epochs=2,
    model_fields=tuple(FIELDS.items()),
)


@pytest.fixture(scope="module", autouse=True)
def shelf(tmp_path_factory):
    """Random weights, in place of those that come with the package."""
    folder = tmp_path_factory.mktemp("shelf")
    camera = URSO_CAMERA.resized(*SIZE)
    fields = {**FIELDS, "camera": (camera.fx, camera.fy, camera.cx, camera.cy)}
    torch.manual_seed(0)
    model = build_network("polar", backbone_weights="none", **fields)
    preprocessing = Preprocessing((48, 64), mean=(0.0, 0.0, 0.0), std=(0.25, 0.25, 0.25))
    model.save_pretrained(folder / "soyuz.safetensors", preprocessing=preprocessing)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zoo, "FOLDER", folder)
        yield folder


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    out = tmp_path_factory.mktemp("posed")
    run(out, POSE)
    return out


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        blank_figures(patch)
        run(out, TRAIN)
    return out


@pytest.fixture(params=["posed", "trained"])
def folder(request):
    return request.getfixturevalue(request.param)


def read(folder):
    return json.loads((folder / "report.json").read_text())


def test_report_json_holds_figures_baseline_and_range(folder):
    document = read(folder)
    for figures in (document, document["mean_pose_baseline"]):
        assert figures["median_translation_error_m"] > 0
        assert 0 < figures["median_rotation_error_deg"] <= 180
    assert document["images"] == document["test_images"] == 12
    assert document["seconds_per_step"]["render"] > 0
    assert document["attitude_range_deg"] == {
        "roll": [-180, 180],
        "pitch": [-90, 90],
        "yaw": [-180, 180],
    }
    assert document["distance_range_m"] == [8, 22]
    assert document["versions"]["ffpose"]


def test_times_and_epochs_of_a_training_are_numbers_with_and_without_one(posed, trained):
    without, with_one = read(posed), read(trained)
    assert without.keys() == with_one.keys()
    assert without["seconds_per_step"].keys() == with_one["seconds_per_step"].keys()
    for name in ("train_seconds", "epochs", "best_epoch"):
        assert without[name] == 0
        assert with_one[name] > 0
        assert type(without[name]) is type(with_one[name])
    for step in ("views", "train"):
        assert without["seconds_per_step"][step] == 0 < with_one["seconds_per_step"][step]


def test_all_images_are_judged_against_labels_of_the_seed(posed):
    with (posed / "evaluation/predictions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sorted(row["image"] for row in rows) == sorted(f"{n}_rgb.png" for n in range(12))
    for row in rows:
        index = int(row["image"].removesuffix("_rgb.png"))
        truth = Pose.from_vector(
            [float(row[n]) for n in ("tx", "ty", "tz", "qw", "qx", "qy", "qz")]
        )
        expected = label(POSE.scene, POSE.seed, index)
        np.testing.assert_allclose(truth.t, expected.t, atol=1e-9)
        np.testing.assert_allclose(truth.rotation, expected.rotation, atol=1e-9)


def test_images_are_of_seeds_that_no_training_uses():
    config = DemoConfig(train=True)
    assert config.training(Path("x")).data.seed < CHOICES.start <= config.seed


@pytest.mark.parametrize(("device", "processes"), [("cpu", 2), ("cuda", 1)])
def test_one_process_trains_on_a_gpu(monkeypatch, device, processes):
    """A second one would have no GPU of its own."""
    monkeypatch.setattr(demo_config, "find_device", lambda name: torch.device(device))
    training = DemoConfig(train=True).training(Path("x"))
    assert training.processes == processes
    assert training.batch_size * processes == 32


@pytest.mark.parametrize(
    ("began", "now", "goes_on"), [("cpu", "cuda", "cpu"), ("cuda", "cpu", "auto")]
)
def test_a_training_goes_on_with_a_gpu_or_without_as_it_began(
    monkeypatch, tmp_path, began, now, goes_on
):
    def training_on(device):
        monkeypatch.setattr(demo_config, "find_device", lambda name: torch.device(device))
        return DemoConfig(train=True).training(tmp_path)

    first = training_on(began)
    folder = RunFolder(first.out)
    folder.begin(first)
    folder.save_state(TrainState())
    resumed = _resumable(training_on(now))
    assert folder.open(resumed, resume=True).history == []
    assert resumed.device == goes_on


def test_the_views_rendered_are_those_that_the_settings_name(trained):
    """32 of the Soyuz, three without any spacecraft and three of other spacecraft."""
    labels = [np.load(path) for path in (trained / "views").glob("views-*/labels.npy")]
    shows_soyuz = np.concatenate([each[:, LABELS.index("object")] for each in labels])
    assert sorted(map(len, labels)) == [3, 3, 32]
    assert shows_soyuz.sum() == TRAIN.views == 32
    assert len(shows_soyuz) == TRAIN.rendered_views
    assert (
        "on 38 views of other scenes, 6 of them without a Soyuz"
        in (trained / "report.html").read_text()
    )


def test_every_file_named_is_there(folder):
    files = read(folder)["files"]
    assert {"report.html", "report.json", "evaluation/results.json"} <= set(files)
    assert all((folder / name).is_file() for name in files)
    assert not any(name.startswith(("images/", "views/")) for name in files)
    assert ("training/best.safetensors" in files) == (folder / "training").exists()


@pytest.mark.parametrize(("name", "charts"), [("posed", 4), ("trained", 5)])
def test_the_page_stands_alone(name, charts, request):
    page = (request.getfixturevalue(name) / "report.html").read_text()
    assert "data:image/jpeg;base64," in page
    assert "data:image/svg+xml;base64," in page
    for outside in ('src="http', "src='", "<script", "<link", "@import", 'src="/'):
        assert outside not in page
    texts = re.findall(r'<img [^>]*alt="([^"]*)"', page)
    assert len(texts) == page.count("<img ")
    assert sum("error" in text for text in texts) == charts  # an image shows its figures
    assert ("<h2>Training</h2>" in page) == (name == "trained")


def test_the_command_runs_without_an_activated_environment(folder):
    words = shlex.split(read(folder)["command"])
    assert ("--train" in words) == (folder / "training").exists()
    environment = {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ}
    done = subprocess.run(
        [*words, "--help"], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_demo_run_again_reports_the_work_that_was_done(trained, capsys):
    before = read(trained)
    again = run(trained, TRAIN)
    said = capsys.readouterr().err
    assert "render: all images exist already" in said
    assert "views:" not in said
    assert "train: all 2 epochs are done already" in said
    for same in ("median_rotation_error_deg", "train_seconds", "images_rendered"):
        assert again[same] == before[same]
    for step in ("render", "views", "train"):
        assert again["seconds_per_step"][step] == before["seconds_per_step"][step]
    page = (trained / "report.html").read_text()
    rows = dict(re.findall(r"<td>(seconds to [^<]+)</td><td>([^<]+)</td>", page))
    assert rows["seconds to render 12 images"] == f"{before['seconds_per_step']['render']:.1f}"
    assert rows["seconds to render 38 views"] == f"{before['seconds_per_step']['views']:.1f}"
    with (trained / "training/results.csv").open() as file:
        seconds = sum(float(row["seconds"]) for row in csv.DictReader(file))
    assert rows["seconds to train"] == f"{seconds:.1f}"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"images": 40}, "expected images 12 as the demo there, got 40"),
        ({"train": True}, "expected train False as the demo there, got True"),
    ],
)
def test_a_demo_of_other_settings_is_not_mixed_in(posed, change, said):
    before = (posed / "report.json").read_bytes()
    with pytest.raises(ValueError, match=said):
        run(posed, replace(POSE, **change))
    assert (posed / "report.json").read_bytes() == before


@pytest.mark.parametrize("name", FOLDERS)
def test_work_of_unknown_settings_is_not_reported(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ValueError, match=rf"got {name}/ without demo\.json"):
        run(tmp_path, POSE)


def test_without_the_weights_nothing_is_rendered(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path / "none")
    with pytest.raises(FileNotFoundError, match="none is installed by name"):
        run(tmp_path / "out", POSE)
    assert not (tmp_path / "out").exists()
