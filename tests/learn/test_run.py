"""`ffpose learn`: from a mesh to weights, graph, report and card; resumed; bad input."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import ffpose
from ffpose.cli import main
from ffpose.learn import run
from ffpose.learn.plan import (
    DEFAULT_CAMERA,
    KINDS,
    MOST_EPOCHS,
    MOST_VIEWS,
    Speed,
    Stage,
    image_size,
    stages,
    training,
)
from ffpose.learn.run import LearnConfig, learn, verdict
from ffpose.models import read_metadata
from ffpose.render import find_scene


@pytest.fixture
def mesh(tmp_path):
    """A bus of 2 x 1 x 1 m with one wing, so that no two sides look alike."""
    bus = trimesh.creation.box((2.0, 1.0, 1.0))
    wing = trimesh.creation.box((0.6, 3.0, 0.05))
    wing.apply_translation((0.3, 1.5, 0.2))
    path = tmp_path / "craft.stl"
    trimesh.util.concatenate([bus, wing]).export(path)
    return path


def test_a_budget_is_spent_on_rendering_and_training_by_the_speed_of_both():
    first, second = stages(60, Speed(views=10, samples=300))
    for stage, minutes in ((first, 60 * 0.88 / 6), (second, 60 * 0.88 * 5 / 6)):
        seconds = stage.views / 10 + stage.epochs * stage.views / 300
        assert 0.9 * 60 * minutes < seconds <= 60 * minutes + 1e-6
    faster = stages(60, Speed(views=1e6, samples=1e9))
    assert faster[1] == Stage("second", MOST_VIEWS, MOST_EPOCHS)


def test_shares_of_the_views_are_all_of_them():
    assert sum(KINDS.values()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("size", "expected"),
    [((512, 384), (384, 512)), ((1920, 1200), (320, 512)), ((8, 1), (64, 512))],
)
def test_the_network_sees_the_shape_of_the_camera(size, expected):
    camera = DEFAULT_CAMERA.resized(*size)
    assert image_size(camera) == expected


def test_the_virtual_camera_holds_the_whole_spacecraft(tmp_path):
    config = training(
        tmp_path,
        tmp_path / "scene.json",
        3.0,
        (9.0, 40.0),
        DEFAULT_CAMERA,
        Stage("first", 1000, 5),
        attitude_range_deg=(180.0, 90.0, 180.0),
        seed=3,
        processes=2,
        device="cpu",
        init=None,
    )
    assert config.model_fields["object_radius_m"] > 3.0
    assert config.model_fields["distance_m"] == [9.0, 40.0]
    assert config.batch_size * config.processes == 32


def test_from_a_mesh_to_a_pose(tmp_path, mesh, monkeypatch):
    """In small: what it writes is what `ffpose.load` opens; a second run repeats nothing."""
    monkeypatch.setattr(run, "measure_speed", lambda config, scene: (Speed(9.0, 99.0), "none"))
    monkeypatch.setattr(
        run, "stages", lambda minutes, speed: (Stage("first", 40, 1), Stage("second", 40, 1))
    )
    out = tmp_path / "out"
    config = LearnConfig(mesh, out, processes=1, test_images=6, card_images=0)
    said = []
    summary = learn(config, said.append)
    assert summary["images"] == 6
    assert "craft.stl, within" in said[1]
    assert {"best.safetensors", "model.onnx", "report.html", "results.json", "scene.json"} <= {
        path.name for path in out.iterdir()
    }
    furthest = np.linalg.norm(trimesh.load(mesh).vertices, axis=1).max()
    scene = find_scene(str(out / "scene.json"))
    assert scene.distance_m == pytest.approx((3 * furthest, 16 * furthest), rel=1e-6)
    header = read_metadata(out / "best.safetensors")
    assert header.config.distance_m == pytest.approx(scene.distance_m)
    assert header.recipe["data"]["scene"] == "craft"
    assert str(tmp_path) not in json.dumps(header.recipe)
    image = next((out / "test-images").glob("*_rgb.png"))
    for backend in ("torch", "onnxruntime"):
        pose = ffpose.load(out, backend=backend)(image)
        assert pose.uncertainty is not None
    before = (out / "second" / "results.csv").read_text()
    learn(config, said.append)
    assert (out / "second" / "results.csv").read_text() == before
    with pytest.raises(ValueError, match=r"out: expected minutes 60.0 as the run in .* got 9"):
        learn(LearnConfig(mesh, out, 9, processes=1, test_images=6, card_images=0))


def test_a_poor_result_is_called_so():
    """A tenth of the constant's error is the border."""
    summary = {"median_translation_error_m": 0.5, "images": 10}
    constant = {"mean_pose_baseline": {"median_rotation_error_deg": 130.0}}
    assert verdict(summary | constant | {"median_rotation_error_deg": 12.0}).startswith("median")
    assert verdict(summary | constant | {"median_rotation_error_deg": 14.0}).startswith("POOR")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["none.stl"], "none.stl"),
        (["craft.txt"], "mesh: expected a file of"),
        (["craft.stl", "--minutes", "0"], "minutes: expected more than 0, got 0"),
        (["craft.stl", "--distance", "9", "3"], "distance: expected 0 < near < far"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path, mesh, monkeypatch, capsys, words, text
):
    monkeypatch.chdir(tmp_path)
    Path("craft.txt").write_text("no mesh")
    assert main(["learn", *words, "--out", "out"]) in (1, 2)
    error = capsys.readouterr().err.strip()
    assert text in error
    assert "\n" not in error
    assert not Path("out").exists()
