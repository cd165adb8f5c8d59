"""`ffpose learn`: from a mesh to weights, graph, report and card; resumed; bad input."""

import errno
import json
import math
import os
import shutil
import subprocess
import sys
from base64 import b64encode
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from safetensors.numpy import save

import ffpose
from ffpose._internal import files
from ffpose._internal.files import sha256
from ffpose._internal.zoo import resolve_initial
from ffpose.cli import main
from ffpose.errors import DataError
from ffpose.geometry import Camera
from ffpose.geometry.symmetry import Axis, SymmetryGroup
from ffpose.learn import plan, run
from ffpose.learn.plan import (
    DEFAULT_CAMERA,
    KINDS,
    LEAST_EPOCHS,
    MOST_EPOCHS,
    MOST_VIEWS,
    Speed,
    TrainingPlan,
    image_size,
    plan_trainings,
    replanned,
    training,
)
from ffpose.learn.run import LearnConfig, learn, verdict
from ffpose.models import read_metadata
from ffpose.render import find_scene
from pages import TEXTS

SHOWN = 0.44 + 0.1 + 0.2 + 0.08
"""Share of the views that make an epoch: those with the spacecraft."""


@pytest.fixture
def mesh(tmp_path):
    """A bus of 2 x 1 x 1 m with one wing, so that no two sides look alike."""
    bus = trimesh.creation.box((2.0, 1.0, 1.0))
    wing = trimesh.creation.box((0.6, 3.0, 0.05))
    wing.apply_translation((0.3, 1.5, 0.2))
    path = tmp_path / "craft.stl"
    trimesh.util.concatenate([bus, wing]).export(path)
    return path


@pytest.fixture
def quick(monkeypatch, undrawn):
    """Nothing is measured, little is trained or drawn, and graphs look once, which is sooner."""
    exported = partial(run.export_weights, looks=1, candidates=1)
    monkeypatch.setattr(run, "export_weights", exported)
    monkeypatch.setattr(run, "measure_speed", lambda config, scene: (Speed(9.0, 99.0), "none"))
    monkeypatch.setattr(
        run,
        "plan_trainings",
        lambda *_: (TrainingPlan("first", 40, 1), TrainingPlan("second", 40, 1)),
    )


def test_a_budget_is_spent_on_rendering_and_training_by_the_speed_of_both():
    speed = Speed(views=10, samples=300)
    first, second = plan_trainings(60, speed)
    training = 0.88 * 60 * 60  # seconds; the rest is to calibrate, test and export
    assert second.views > first.views  # which are among the second's
    one, two = (
        (each.views - before) / 10 + each.epochs * SHOWN * each.views / 300
        for each, before in ((first, 0), (second, first.views))
    )
    assert 0.99 * training < one + two <= training + 1e-6
    answered = one + first.seconds_besides(speed)  # with all that its answer takes
    assert 0.95 * training / 6 < answered <= training / 6 + 1e-6
    faster = plan_trainings(60, Speed(views=1e6, samples=1e9))
    assert faster[1] == TrainingPlan("second", MOST_VIEWS, MOST_EPOCHS, rendered=MOST_VIEWS)


def test_a_plan_keeps_its_budget_where_training_is_slow_beside_rendering():
    speed = Speed(views=500, samples=300)
    plans = plan_trainings(10, speed)
    shown = SHOWN * sum(plan.epochs * plan.views for plan in plans)
    rendered = plans[0].views + plans[1].views - plans[1].rendered
    assert rendered / speed.views + shown / speed.samples <= 600


def test_a_small_budget_is_not_held_back_whole():
    first, second = plan_trainings(10, Speed(views=10, samples=300))
    shown = SHOWN * (first.epochs * first.views + second.epochs * second.views)
    assert 0.97 * 600 * 0.88 < second.views / 10 + shown / 300 <= 600 * 0.88
    fast = plan_trainings(60, Speed(views=40, samples=800))
    shown = SHOWN * sum(plan.epochs * plan.views for plan in fast)
    seconds = fast[1].views / 40 + shown / 800
    assert 0.99 * (3600 - 9000 / 40 - 120) < seconds <= 3600 - 9000 / 40 - 120


def test_views_leave_half_of_the_disk_free():
    speed = Speed(views=20, samples=300, view_bytes=200_000)
    first, second = plan_trainings(60, speed, room=10e9)
    assert 4.9e9 < (second.views + second.views) * 200_000 <= 5e9
    assert first.views < second.views
    enough = plan_trainings(60, speed, room=1e12)
    assert enough[1].views > second.views
    assert enough[1].epochs < second.epochs


def test_a_slower_machine_has_a_smaller_second_training_in_the_time_that_is_left():
    speed = Speed(views=10, samples=300)
    first, second = plan_trainings(60, speed)
    planned = first.views / 10 + first.epochs * SHOWN * first.views / 300
    spent = planned + first.seconds_besides(speed)
    assert replanned(second, first, 60, speed, spent) == second
    assert replanned(second, first, 60, speed, spent / 2) == second  # never more
    fewer = replanned(second, first, 60, speed, 2 * spent)
    rendering = (fewer.views - first.views) / 10
    seconds = planned + rendering + fewer.epochs * SHOWN * fewer.views / 300
    held_back = 60 * 60 * 0.12  # which takes twice as long too
    assert 0.99 * 60 * 60 < 2 * (seconds + held_back) <= 60 * 60
    assert replanned(fewer, first, 60, speed, spent) == fewer  # after an interruption
    least = replanned(second, first, 60, speed, 3600)
    assert (least.views, least.epochs) == (first.views, LEAST_EPOCHS)


def test_shares_of_the_views_are_all_of_them():
    assert sum(KINDS.values()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("size", "expected"),
    [((512, 384), (384, 512)), ((1920, 1200), (320, 512)), ((8, 1), (64, 512))],
)
def test_the_network_sees_the_shape_of_the_camera(size, expected):
    camera = DEFAULT_CAMERA.resized(*size)
    assert image_size(camera) == expected


def planned(folder, **fields):
    return training(
        folder,
        folder / "scene.json",
        3.0,
        (9.0, 40.0),
        DEFAULT_CAMERA,
        TrainingPlan("first", 1000, 5),
        **{
            "attitude_range_deg": (180.0, 90.0, 180.0),
            "seed": 3,
            "processes": 2,
            "device": "cpu",
            "init": None,
            **fields,
        },
    )


def test_the_virtual_camera_holds_the_whole_spacecraft(tmp_path):
    config = planned(tmp_path)
    assert config.model_fields["object_radius_m"] > 3.0
    assert config.model_fields["distance_m"] == [9.0, 40.0]
    assert config.batch_size * config.processes == 32


@pytest.mark.parametrize(
    ("device", "gpus", "trained_by"),
    [
        ("cpu", 1, 4),
        ("auto", 0, 4),
        ("auto", 1, 1),
        ("cuda", 2, 2),
        ("cuda", 8, 4),
        ("cuda:1", 2, 1),
    ],
)
def test_at_most_four_train_one_on_each_gpu_and_all_prepare_their_batches(
    tmp_path, monkeypatch, device, gpus, trained_by
):
    found = torch.device("cuda", 0) if gpus and device != "cpu" else torch.device("cpu")
    monkeypatch.setattr(plan, "find_device", lambda name: found)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
    config = planned(tmp_path, device=device, processes=16)
    assert (config.processes, config.data.workers) == (trained_by, 16)
    assert config.batch_size * config.processes == 32


def test_an_interrupted_run_goes_on_with_as_many_that_train(tmp_path, monkeypatch):
    """On other cores, and with other spellings of its paths."""
    monkeypatch.chdir(tmp_path)
    record = run._Record.open(LearnConfig(Path("craft.stl"), tmp_path), "craft of 1 m")
    record.plans, record.speed = (TrainingPlan("first", 40, 1),) * 2, Speed(9.0, 99.0)
    record.world = 2
    record.write(tmp_path)
    config = LearnConfig(tmp_path / "craft.stl", tmp_path, processes=16)
    found = run._Record.open(config, "craft of 1 m")
    made = planned(tmp_path, processes=16, world=found.world)
    assert (made.processes, made.batch_size, made.data.workers) == (2, 16, 16)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    run._Record.open(LearnConfig(Path("../craft.stl"), Path("..")), "craft of 1 m")
    with pytest.raises(ValueError, match=r"expected spacecraft craft of 1 m as .* got .* of 2 m"):
        run._Record.open(config, "craft of 2 m")


@pytest.mark.parametrize("name", [run.WEIGHTS, run.GRAPH])
def test_what_another_command_trained_is_not_replaced(tmp_path, name):
    (tmp_path / name).write_text("another's")
    with pytest.raises(ValueError, match=f"expected a folder of ffpose learn, .* another's {name}"):
        run._Record.open(LearnConfig(Path("craft.stl"), tmp_path), "craft")


@pytest.mark.parametrize("name", ["soyuz_easy.glb", "sat+wing.obj"])
def test_a_set_of_ones_own_has_a_name_of_its_own(tmp_path, name):
    with pytest.raises(ValueError, match=r"without \+ that is no built-in set's, got"):
        LearnConfig(Path(name), tmp_path)


def test_default_distances_show_the_whole_spacecraft_to_any_camera():
    """At the least of them a sphere of that size is in the frame, whatever its angle of view."""
    assert plan.default_distances(2.0, plan.DEFAULT_CAMERA) == (6.0, 32.0)
    for focal in (300.0, 1000.0, 5000.0):
        camera = Camera(640, 480, focal, focal, 300.0, 240.0)
        near, far = plan.default_distances(2.0, camera)
        assert math.asin(2.0 / near) <= math.atan(240 / focal)
        assert far / near == pytest.approx(16 / 3)


def test_the_page_tells_the_shares_of_the_views():
    page = " ".join(TEXTS["docs/own-spacecraft.md"].split())
    for kind, told in {"count": "plain", "randomized": "with randomized", "decoys": "with"}.items():
        assert f"{100 * KINDS[kind]:.0f} % {told}" in page


@pytest.mark.parametrize("name", ["symmetry", "init"])
def test_a_run_does_not_go_on_with_another_file_of_the_same_name(tmp_path, name):
    path = tmp_path / "given"
    path.write_text("one")
    config = LearnConfig(Path("craft.stl"), tmp_path, **{name: str(path)})
    record = run._Record.open(config, "craft")
    record.plans, record.speed = (TrainingPlan("first", 40, 1),) * 2, Speed(9.0, 99.0)
    record.write(tmp_path)
    run._Record.open(config, "craft")
    path.write_text("another")
    with pytest.raises(ValueError, match=f"expected {name}_sha256"):
        run._Record.open(config, "craft")
    record = run._Record.open(replace(config, out=tmp_path / "plain", **{name: "none"}), "craft")
    (tmp_path / "plain").mkdir()
    record.plans, record.speed = (TrainingPlan("first", 40, 1),) * 2, Speed(9.0, 99.0)
    record.write(tmp_path / "plain")
    with pytest.raises(ValueError, match=f"expected {name} none as the run in .*, got"):
        run._Record.open(replace(config, out=tmp_path / "plain"), "craft")


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"camera": DEFAULT_CAMERA.resized(9341, 7000)}, r"camera: .* 16…8192, got \(9341, 7000\)"),
        ({"test_images": 0}, "test_images: expected 1 or more, got 0"),
    ],
)
def test_what_would_fail_after_the_training_is_refused_before(tmp_path, fields, text):
    with pytest.raises(ValueError, match=text):
        LearnConfig(tmp_path / "craft.stl", tmp_path, **fields)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((512, 384), (512, 384)),
        ((9344, 7000), (1168, 875)),
        ((5472, 3648), (912, 608)),
        ((8192, 100), (8192, 100)),
    ],
)
def test_test_images_of_a_large_sensor_are_smaller(tmp_path, monkeypatch, size, expected):
    sizes = []

    def written(*_, size, **__):
        sizes.append(size)
        raise InterruptedError

    monkeypatch.setattr(run, "write_dataset", written)
    camera = DEFAULT_CAMERA.resized(*size)
    config = LearnConfig(Path("craft.stl"), tmp_path, camera=camera)
    with pytest.raises(InterruptedError):
        run._tested(config, SimpleNamespace(scene=lambda: None), (), 1, str)
    assert sizes == [expected]


def test_where_the_origin_lies_far_outside_the_camera_keeps_clear_of_the_spacecraft(tmp_path):
    box = trimesh.creation.box((2.0, 1.0, 1.0))
    box.apply_translation((0.0, 0.0, 30.0))
    box.export(tmp_path / "far.stl")
    config = LearnConfig(tmp_path / "far.stl", tmp_path / "out")
    radius, scene = run._inspected(config)
    assert radius == pytest.approx(np.sqrt(30.5**2 + 1.25))
    # Training goes to 0.7 of the nearest distance.
    assert 0.7 * scene.distance_m[0] - 30 > np.sqrt(1.5)
    assert scene.distance_m[1] / scene.distance_m[0] == pytest.approx(8 / 1.5)


def test_the_test_is_on_the_device_and_modulo_the_groups_that_are_asked_for(tmp_path, monkeypatch):
    on = []
    written = SimpleNamespace(folder=tmp_path)
    monkeypatch.setattr(run, "write_dataset", lambda *_, **__: written)
    monkeypatch.setattr(
        run, "evaluate", lambda *_, device="auto", unfolded=(): on.append((device, unfolded))
    )
    for name in ("write_results", "write_evaluation_figures"):
        monkeypatch.setattr(run, name, lambda *_: None)
    config = LearnConfig(Path("craft.stl"), tmp_path, device="cpu")
    run._tested(config, SimpleNamespace(scene=lambda: None), ("a group",), 1, str)
    assert on == [("cpu", ("a group",))]


def test_the_reports_command_has_all_options(tmp_path):
    words = ["ffpose", "learn", "craft.glb", "--out", "runs/craft", "--minutes", "10"]
    assert run._command(LearnConfig(Path("craft.glb"), Path("runs/craft"), 10)) == words
    changed = LearnConfig(
        Path("craft.glb"),
        Path("runs/craft"),
        10,
        mesh_scale=0.001,
        distance_m=(3.0, 9.5),
        mesh_up="y",
        mesh_center=True,
        symmetry="none",
        init="none",
    )
    mesh = "--mesh-scale 0.001 --mesh-up y --mesh-center"
    options = f"{mesh} --symmetry none --init none --distance 3.0 9.5"
    assert run._command(changed) == [*words, *options.split()]


def test_a_graph_that_is_missing_or_damaged_is_exported(tmp_path):
    (tmp_path / "best.safetensors").write_bytes(b"weights")
    assert not run._exported(tmp_path)
    (tmp_path / "model.onnx").write_bytes(b"a part of a graph")
    assert not run._exported(tmp_path)


def interrupted(config, said):
    """Learn by a run that is interrupted after its first training and before its graph."""
    places = ["exporting", "a first answer"]

    def say(text):
        said.append(text)
        if places and text.startswith(places[-1]):
            places.pop()
            raise KeyboardInterrupt

    while places:
        with suppress(KeyboardInterrupt):
            learn(config, say)
    return learn(config, say)


@pytest.mark.slow
def test_from_a_mesh_to_a_pose(tmp_path, quick):
    """In small, of a plain box, which four attitudes show alike; a last run repeats nothing."""
    mesh, out, said = tmp_path / "box.stl", tmp_path / "out", []
    trimesh.creation.box((2.0, 1.0, 0.5)).export(mesh)
    config = LearnConfig(mesh, out, processes=1, test_images=6, card_images=0)
    summary = interrupted(config, said)
    assert summary["images"] == 6
    assert "box.stl, within" in said[1]
    assert "doubtful" not in said[1]
    written = {path.name for path in out.iterdir()}
    assert {"best.safetensors", "model.onnx", "report.html", "results.json"} <= written
    _is_learned_from_the_mesh(out, mesh)
    _is_folded(out, summary, said)
    image = next((out / "test-images").glob("*_rgb.png"))
    for backend in ("torch", "onnxruntime"):
        pose = ffpose.load(out, backend=backend)(image)
        assert pose.uncertainty is not None
    before = (out / "second" / "results.csv").read_text()
    slow = [
        out / name for name in ("model.onnx", "first/best.safetensors", "second/last.safetensors")
    ]
    written = [path.stat().st_mtime_ns for path in slow]
    learn(config, said.append)
    assert (out / "second" / "results.csv").read_text() == before
    assert [path.stat().st_mtime_ns for path in slow] == written
    with pytest.raises(ValueError, match=r"out: expected minutes 60.0 as the run in .* got 9"):
        learn(LearnConfig(mesh, out, 9, processes=1, test_images=6, card_images=0))
    moved = Path(shutil.move(out, tmp_path / "moved"))
    learn(replace(config, out=moved), said.append)
    assert (moved / "second" / "results.csv").read_text() == before
    command = read_metadata(moved / "best.safetensors").calibration["command"]
    assert str(tmp_path) not in command


LEARNER = """
if __name__ == "__main__":  # what renders imports this file
    import os, sys
    from pathlib import Path
    from ffpose.learn import run
    from ffpose.learn.plan import Speed, TrainingPlan

    run._exported = lambda out: True
    run.measure_speed = lambda config, scene: (Speed(9.0, 99.0), "none")
    run.plan_trainings = lambda *_: (TrainingPlan("first", 40, 1), TrainingPlan("second", 40, 1))
    run.write_evaluation_figures = run.write_report = lambda *_, **__: None
    given = dict(processes=1, test_images=2, card_images=0, symmetry="none")
    config = run.LearnConfig(Path(sys.argv[1]), Path(sys.argv[2]), **given)
    summary = run.learn(config, lambda text: print(text, flush=True))
    Path(sys.argv[2], "rank-" + os.environ["RANK"]).write_text(str(len(summary) > 0))
"""


@pytest.mark.slow
def test_processes_of_torchrun_train_together(tmp_path, mesh):
    """One of them does all the rest."""
    (tmp_path / "learner.py").write_text(LEARNER)
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    words, out = [str(tmp_path / "learner.py"), str(mesh), str(tmp_path / "out")], tmp_path / "out"
    done = subprocess.run(
        [*launch, *words], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("median errors") == 2  # the first answer's and the last
    assert [(out / f"rank-{rank}").read_text() for rank in (0, 1)] == ["True", "False"]
    assert json.loads((out / "learn.json").read_text())["world"] == 2
    for name in ("first", "second"):
        assert "batch_size: 16\n" in (out / name / "config.yaml").read_text()
    assert ffpose.load(out).metadata.config.object_radius_m > 0


def test_the_others_end_with_the_one_that_leads_and_fail_with_a_training(monkeypatch):
    told, config = [], SimpleNamespace(name="first")
    group = SimpleNamespace(world=1, same=told.append)
    monkeypatch.setattr(run, "train", lambda config, resume: config.name)
    with run._leading(group) as train_together:
        assert train_together(config) == "first"
    assert told == [config, None]
    with pytest.raises(DataError), run._leading(group):
        raise DataError("no mesh")
    assert told[2:] == [None]
    with pytest.raises(AttributeError), run._leading(group) as train_together:
        train_together(None)  # which the others have got, and fail at
    assert told[3:] == [None]


def _is_learned_from_the_mesh(out, mesh):
    _, radius = trimesh.nsphere.minimum_nsphere(trimesh.load(mesh))
    scene = find_scene(str(out / "scene.json"))
    assert scene.distance_m == pytest.approx((3 * radius, 16 * radius), rel=2e-3)
    header = read_metadata(out / "best.safetensors")
    assert header.config.distance_m == pytest.approx(scene.distance_m)
    assert header.recipe["data"]["scene"] == "box"
    assert str(mesh.parent) not in json.dumps(header.recipe)
    assert "init: generic\n" in (out / "first" / "config.yaml").read_text()
    of_the_first = header.recipe["init"]
    assert of_the_first["sha256"] == sha256(out / "first" / "best.safetensors")
    assert of_the_first["recipe"]["init"]["sha256"] == sha256(resolve_initial("generic"))


def _is_folded(out, summary, said):
    """What was found is in the weights, the graph, the test and the report."""
    assert "2-fold about" in said[1]
    assert len(json.loads((out / "symmetry.json").read_text())["axes"]) == 2
    for name in ("best.safetensors", "model.onnx"):
        assert len(ffpose.load(out / name).metadata.symmetry) == 4
    plain = summary["without_symmetry"]["mean_rotation_error_deg"]
    assert summary["mean_rotation_error_deg"] < plain
    assert summary["mean_rotation_error_deg"] < 120.1  # the farthest of four, a third of a turn
    assert "modulo symmetry" in said[-1]
    page = (out / "report.html").read_text()
    assert "without regard to symmetry" in page
    assert "viewing directions" in page
    words = ["evaluate", str(out), "--data.kind", "urso", "--data.root", str(out / "test-images")]
    words += ["--data.split", "all", "--out", str(out / "plain"), "--symmetry", "none"]
    assert main(words) == 0
    unfolded = json.loads((out / "plain" / "results.json").read_text())
    assert unfolded["mean_rotation_error_deg"] == pytest.approx(plain)
    assert "without_symmetry" not in unfolded


def test_a_poor_result_is_called_so():
    """A tenth of the constant's error is the border."""
    summary = {"median_translation_error_m": 0.5, "images": 10, "confusion": {"share": 0.0}}
    summary["share_over_30_deg"] = 0.25
    baseline = {"median_rotation_error_deg": 130.0, "confusion": {"share": 0.0}}
    constant = {"mean_pose_baseline": baseline | {"median_translation_error_m": 5.1}}
    good = summary | constant | {"median_rotation_error_deg": 12.0}
    assert verdict(good).startswith("median")
    assert "10 unseen images, of which 25% are more than 30 degrees off" in verdict(good)
    assert "a constant pose has 130 degrees and 5.1 m" in verdict(good)
    assert verdict(good | {"median_rotation_error_deg": 14.0}).startswith("POOR")
    assert verdict(good | {"median_translation_error_m": 0.52}).startswith("POOR")


def test_sides_that_are_taken_for_each_other_are_told():
    summary = {
        "median_translation_error_m": 0.5,
        "median_rotation_error_deg": 3.0,
        "share_over_30_deg": 0.25,
        "images": 10,
        "mean_pose_baseline": {
            "median_rotation_error_deg": 130.0,
            "median_translation_error_m": 10.0,
            "confusion": {"share": 0.02},
        },
    }
    turn = {"rotation_vector_deg": [0.0, -90.0, 0.0]}
    told = verdict(summary | {"confusion": turn | {"share": 0.2}})
    assert "20% are taken for what is seen after a turn by 90 degrees about (0.00, -1.00" in told
    assert "second attitude" not in told
    modes = {"share_over_30_deg": 0.25, "share_over_30_deg_of_both": 0.05}
    told = verdict(summary | {"confusion": turn | {"share": 0.2}, "uncertainty": {"modes": modes}})
    assert "in 80% of those more than 30 degrees off the second attitude" in told
    assert "taken" not in verdict(summary | {"confusion": turn | {"share": 0.05}})
    # of attitudes in a narrow range a constant pose's errors gather as well
    baseline = summary["mean_pose_baseline"] | {"confusion": {"share": 0.2}}
    narrow = summary | {"mean_pose_baseline": baseline, "confusion": turn | {"share": 0.2}}
    assert "taken" not in verdict(narrow)


def test_what_is_not_folded_is_told_beside_the_error(tmp_path):
    """An error modulo a symmetry that is not folded never replaces the error."""
    path, half = tmp_path / "symmetry.json", {"axis": [0, 1, 0], "fold": 2}
    folded = SymmetryGroup((Axis((0, 0, 1), 2),))
    near = [half | {"noise": 9.0}, {"axis": [1, 0, 0], "fold": 2}]  # which complete one group
    folded.write(path, same=folded.to_json(), near=near)
    (group,) = run._unfolded(path, folded)
    assert len(group) == 4
    assert [len(each) for each in run._unfolded(path, SymmetryGroup())] == [2, 2, 2]
    # All that looks the same is one group; an axis that goes with no others in a finite one.
    askew = {"axis": [0.1, 0.2, 1], "fold": 60}
    SymmetryGroup().write(path, same=[half, *folded.to_json()], near=[askew])
    assert [len(each) for each in run._unfolded(path, SymmetryGroup())] == [4, 60]
    assert [len(each) for each in run._unfolded(path, folded)] == [4]
    folded.write(path)  # as written by hand
    assert run._unfolded(path, folded) == ()


def test_an_error_that_a_rotation_explains_is_told_with_it():
    half = {"axis": [0, 1, 0], "fold": 2}
    constant = {"median_rotation_error_deg": 100.0, "mean_rotation_error_deg": 100.0}
    modulo = {"axes": [half], "median_rotation_error_deg": 2.3, "mean_rotation_error_deg": 16.0}
    modulo["mean_pose_baseline"] = constant
    summary = {
        "median_rotation_error_deg": 6.0,
        "mean_rotation_error_deg": 81.0,
        "share_over_30_deg": 0.5,
        "median_translation_error_m": 0.5,
        "images": 10,
        "mean_pose_baseline": {
            "median_rotation_error_deg": 135.0,
            "mean_rotation_error_deg": 125.0,
            "median_translation_error_m": 10.0,
            "confusion": {"share": 0.02},
        },
        "confusion": {"share": 0.02},
        "modulo_unfolded": [modulo],
    }
    told = verdict(summary)
    assert told.startswith("median errors 6.00 degrees and")
    assert "modulo 2-fold about (0, 1, 0), which is not folded, 2.30 degrees" in told
    assert "(a constant pose 100)" in told
    modulo["mean_rotation_error_deg"] = 0.79 * 81  # which a constant pose gains too
    assert "modulo" not in verdict(summary)
    for each in (constant, summary["mean_pose_baseline"]):  # of one attitude alone
        each["mean_rotation_error_deg"] = each["median_rotation_error_deg"] = 0.0
    assert "modulo" not in verdict(summary)


def write_gltf(name, **changes):
    """Write a triangle with a texture."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    places = np.array([[0, 0], [1, 0], [0, 1]], "<f4")
    data = corners.tobytes() + places.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "buffers": [
            {
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + b64encode(data).decode(),
            }
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 24},
        ],
        "accessors": [
            {"bufferView": n, "componentType": 5126, "count": 3, "type": kind}
            for n, kind in enumerate(("VEC3", "VEC2"))
        ],
        "images": [{"uri": "none.png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}
        ],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    Path(name).write_text(json.dumps(document | changes))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["none.stl"], "none.stl"),
        (["craft.txt"], "mesh: expected a file of"),
        (["craft.stl", "--minutes", "0"], "minutes: expected more than 0, got 0"),
        (["craft.stl", "--seed", "-1"], "seed: expected 0 to 999999, got -1"),
        (["craft.stl", "--distance", "9", "3"], "distance: expected 0 < near < far"),
        (["sphere.ply"], "looks the same from all sides, as a sphere does"),
        (["triangle.ply"], "expected a spacecraft of some depth, got one that is flat"),
        (["cycle.gltf"], "cycle.gltf: expected a tree of nodes, got node 0 in a cycle"),
        (["inner/outside.gltf"], "outside.gltf: expected files in its folder, got '../secret.png'"),
        (["craft.stl", "--symmetry", "none.json"], "none.json"),
        (
            ["craft.stl", "--init", "sojuz"],
            "expected a file or a name (one of dragon, generic, soyuz), got",
        ),
        (["craft.stl", "--init", "other.safetensors"], "other.safetensors"),
        (["craft.stl", "--symmetry", "two.json"], "two.json: axes: expected some that leave"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path, mesh, monkeypatch, capsys, words, text
):
    monkeypatch.chdir(tmp_path)
    Path("craft.txt").write_text("no mesh")
    trimesh.creation.icosphere(subdivisions=4).export("sphere.ply")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export("triangle.ply")
    write_gltf("cycle.gltf", nodes=[{"children": [1]}, {"mesh": 0, "children": [0]}])
    Path("inner").mkdir()
    Path("secret.png").write_bytes(b"no texture of theirs")
    write_gltf("inner/outside.gltf", images=[{"uri": "../secret.png"}])
    axes = [{"axis": [0, 0, 1], "fold": "any"}, {"axis": [1, 0, 0], "fold": "any"}]
    Path("other.safetensors").write_bytes(save({"weight": np.zeros(3, "f4")}))
    Path("two.json").write_text(json.dumps({"axes": axes}))
    assert main(["learn", *words, "--out", "out"]) in (1, 2)
    error = capsys.readouterr().err.strip()
    assert text in error
    assert "\n" not in error
    assert not Path("out").exists()


def error_of(capsys, words):
    """Return the one line with which a command fails."""
    assert main(words) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ffpose: ")]
    assert len(lines) == 1
    return lines[0]


def test_no_write_access_is_one_line(tmp_path, mesh, monkeypatch, capsys):
    def refused(path, *arguments, **options):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(Path, "mkdir", refused)
    out = tmp_path / "out"
    error = error_of(capsys, ["learn", str(mesh), "--out", str(out)])
    assert "Permission denied" in error
    assert str(out) in error
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["symmetry.json", "learn.json", "last.safetensors", "state.pt"])
def test_a_disk_that_fills_up_leaves_nothing_half_written(
    tmp_path, mesh, quick, monkeypatch, capsys, name
):
    """The file that no longer fits is not there, and others are whole."""
    out, words = tmp_path / "out", ["learn", str(mesh), "--out", str(tmp_path / "out")]
    words += ["--processes", "1"]

    def full(path):
        if path.name == name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(files, "_sync", full)
        assert "No space left on device" in error_of(capsys, words)
    written = [path for path in out.rglob("*") if path.is_file() and "views" not in path.parts]
    assert name not in {path.name for path in written}
    assert not list(out.rglob(".ffpose-*"))
    for path in written:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".safetensors" and path.name != name:
            assert read_metadata(path).config
