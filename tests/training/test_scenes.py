"""A training on rendered scenes: from a name to weights, which a second run makes again."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from ffpose._internal.seeds import CALIBRATION, CHOICES, TRAINING, VALIDATION
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import (
    PRESETS,
    load_network,
    read_metadata,
)
from ffpose.render import find_scene, label, patches
from ffpose.render.dataset import writer
from ffpose.render.renderer import situation
from ffpose.training import DataConfig, data, tasks
from ffpose.training.engine import train
from ffpose.training.run import build_run
from scene_runs import COUNT, scenes_config


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """The folder of views and images that the first run renders and the others find."""
    return tmp_path_factory.mktemp("scenes")


@pytest.fixture
def rendered(monkeypatch):
    """Views and whole images that were rendered since."""
    made, view, image = [], patches.render_patches, writer.render_one

    def counted(scene, seed, index, spec, content="object"):
        made.append((seed, index, content))
        return view(scene, seed, index, spec, content)

    def image_counted(job, index):
        made.append((job.seed, index, "object"))
        return image(job, index)

    monkeypatch.setattr(patches, "render_patches", counted)
    monkeypatch.setattr(writer, "render_one", image_counted)
    return made


@pytest.mark.slow
def test_a_run_on_scenes_resumes_bit_for_bit_and_renders_once(root, tmp_path, rendered):
    whole = scenes_config(root, tmp_path / "whole")
    train(whole, quiet=True)
    assert [(seed, content) for seed, _, content in rendered if seed in TRAINING] == [
        *[(3, "object")] * 12,
        *[(500_003, "empty")] * 2,
        (500_003, "decoy"),
    ]
    others = [seed for seed, *_ in rendered if seed not in TRAINING]
    assert others == [VALIDATION.start + 3] * COUNT + [CALIBRATION.start + 3] * COUNT
    rendered.clear()
    part = replace(whole, out=tmp_path / "part")
    train(replace(part, epochs=1), quiet=True)
    train(part, quiet=True, resume=True)
    assert rendered == []
    for name in ("last", "best"):
        one, other = (load_file(folder / f"{name}.safetensors") for folder in (whole.out, part.out))
        assert one.keys() == other.keys()
        assert all(torch.equal(value, other[key]) for key, value in one.items())
    best = whole.out / "best.safetensors"
    before, said = load_file(best), read_metadata(best)
    assert not torch.equal(before["variance_scales"], torch.ones(2))
    train(whole, quiet=True, resume=True)
    assert read_metadata(best) == said
    assert all(torch.equal(value, before[key]) for key, value in load_file(best).items())


def test_workers_prepare_the_batches_of_this_process(root, tmp_path, monkeypatch):
    monkeypatch.setattr(tasks, "LEAST_BATCHES", 1)
    task = build_run(scenes_config(root, tmp_path / "run")).task
    assert task.workers == 0
    # Forked before there is a thread: one that is just ending may hold a lock of MKL's, for good.
    task.workers = 2
    theirs = list(task.batches(seed=5))
    task.workers = 0
    own = list(task.batches(seed=5))
    assert len(own) == len(theirs) == task.steps > 1
    for one, two in zip(own, theirs, strict=True):
        for name, value in one._asdict().items():
            assert torch.equal(getattr(two, name), value), name


@pytest.mark.slow
def test_processes_that_train_together_share_the_workers(root, tmp_path):
    losses = []
    for workers in (0, 3):
        config = scenes_config(root, tmp_path / str(workers), epochs=1, processes=2, batch_size=2)
        config = replace(config, data=replace(config.data, workers=workers))
        losses.append(train(config, quiet=True).history[0]["train_loss"])
    assert losses[0] == losses[1]


def test_autocast_computes_nearly_the_same_loss_and_trains_as_much(root, tmp_path):
    run = build_run(scenes_config(root, tmp_path / "run"))
    batch, trained, losses = next(run.task.batches(0)), [], []
    for half in (False, True):
        run.optimizer.zero_grad()
        torch.manual_seed(0)
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            loss = run.task.terms(run.model, batch, run.device).total
        loss.backward()
        losses.append(loss.item())
        gradients = ((name, weight.grad) for name, weight in run.model.named_parameters())
        trained.append({name for name, grad in gradients if grad is not None and grad.any()})
        # A constant two-vector of each angle, rotated by it, has no mean: a gradient of rounding.
        trained[-1].discard("orientation_branch.vectors.bias")
    assert losses[0] != losses[1] == pytest.approx(losses[0], rel=0.01)
    assert trained[0] == trained[1]


def test_the_weights_know_data_camera_and_how_to_look(root, tmp_path, capsys):
    config = scenes_config(root, tmp_path / "run", epochs=1)
    folder = train(config).folder
    assert f"{COUNT} images calibrate: fewer than 10 tell little" in capsys.readouterr().err
    metadata = read_metadata(folder.best)
    assert metadata.config.view_camera == find_scene(
        "soyuz_easy", (180.0, 90.0, 180.0)
    ).camera.resized(128, 96)
    assert metadata.preprocessing.mean == (0.0, 0.0, 0.0)
    assert (metadata.data["kind"], metadata.data["count"]) == ("scenes", 12)
    camera = find_scene("soyuz_easy").camera
    assert metadata.data["image_size"] == [camera.height, camera.width]
    assert metadata.data["sets"] == [{"scene": "soyuz_easy", "seed": 3, "count": 12}]
    assert metadata.recipe["data"]["scene"] == "soyuz_easy"
    assert not any("dense" in name for name in load_file(folder.last))
    pose = load_network(folder.last)(torch.zeros(2, 3, 96, 128))
    assert all(bool(part.isfinite().all()) for part in pose)


def test_a_network_that_looks_once_learns_from_whole_images_of_the_same_scenes(tmp_path, rendered):
    fields = {
        "image_size": [96, 128],
        "dim": 16,
        "head_hidden": 16,
        "backbone": "compact_resnet_narrow",
    }
    config = scenes_config(
        tmp_path / "images", tmp_path / "run", model="tiny", model_fields=fields, epochs=1
    )
    seen = build_run(config).task.train_set
    scene = find_scene("soyuz_easy", (180.0, 90.0, 180.0))
    indices = [int(name.removesuffix("_rgb.png")) for name in seen.names]
    assert sorted(indices) == list(range(12))
    poses = [label(scene, 3, index).vector for index in indices]
    np.testing.assert_allclose(seen.poses, poses, atol=1e-9)
    assert seen.camera == scene.camera.resized(128, 96)
    assert seen[0].image.shape == (3, 96, 128)
    assert len(rendered) == 12 + COUNT
    rendered.clear()
    assert len(train(config, quiet=True).history) == 1
    assert rendered == []


def test_a_set_smaller_than_a_batch_is_refused(root, tmp_path):
    with pytest.raises(ValueError, match="batch_size: expected 1 to 12, got 13"):
        train(scenes_config(root, tmp_path / "run", batch_size=13), quiet=True)
    assert not list((tmp_path / "run").glob("*.safetensors"))


@pytest.mark.parametrize("seed", [0, 499_999, 500_000, TRAINING.stop - 1])
def test_no_training_renders_a_tests_scenes(monkeypatch, seed):
    asked = []

    def rendered_patches(root, scene, seed, count, spec, *, content="object", **_):
        asked.append((seed, content))
        return {"labels": np.zeros((count, 13))}

    monkeypatch.setattr(data, "rendered_patches", rendered_patches)
    for name in ("open_frames", "open_calibration"):
        monkeypatch.setattr(data, name, lambda *_, **__: None)
    config = DataConfig("scenes", Path("none"), scene="soyuz_hard+soyuz_easy", seed=seed)
    model = PRESETS["polar"]
    data.open_training_data(config, model, Preprocessing(model.image_size), coordinates=True)
    assert [content for _, content in asked] == ["object", "object", "empty", "decoy"]
    assert all(given in TRAINING for given, _ in asked)
    assert [given for given, _ in asked[:2]] == [seed, (seed + 1) % len(TRAINING)]
    assert not {given for given, _ in asked[:2]} & {given for given, _ in asked[2:]}


def test_sets_that_are_joined_show_different_scenes(monkeypatch):
    """Image i of one set has another attitude, light and Earth than image i of any other."""
    asked = []

    def rendered_patches(root, scene, seed, count, spec, *, content="object", **_):
        asked.append((scene, seed, count, content))
        return {"labels": np.zeros((count, 13))}

    monkeypatch.setattr(data, "rendered_patches", rendered_patches)
    for name in ("open_frames", "open_calibration"):
        monkeypatch.setattr(data, name, lambda *_, **__: None)
    config = DataConfig(
        *("scenes", Path("none")),
        scene="soyuz_hard+soyuz_easy+soyuz_hard",
        count=[3, 2, 4],
        cut=1,
        randomized=1,
        dusk=1,
        seed=101,
    )
    model = PRESETS["polar"]
    data.open_training_data(config, model, Preprocessing(model.image_size), coordinates=True)
    shown = [part for part in asked if part[3] == "object"]
    assert [(scene.name, seed, count) for scene, seed, count, _ in shown[:3]] == [
        ("soyuz_hard", 101, 3),
        ("soyuz_easy", 102, 2),
        ("soyuz_hard", 103, 4),
    ]
    assert len(shown) == 12
    assert [scene.dusk for scene, *_ in shown] == [False] * 9 + [True] * 3
    for index in range(2):
        seen = [situation(scene, seed, index) for scene, seed, _, _ in shown]
        for one, other in itertools.combinations(seen, 2):
            assert np.abs(one.pose.rotation - other.pose.rotation).max() > 1e-3
            for name in ("sun", "nadir", "ground"):
                differ = getattr(one.around, name) - getattr(other.around, name)
                assert np.abs(differ).max() > 1e-3


def test_a_number_of_images_for_each_set_is_expected():
    with pytest.raises(ValueError, match=r"data\.count: expected a number for 2 sets, got \[1\]"):
        DataConfig("scenes", Path("none"), scene="soyuz_hard+soyuz_easy", count=[1])
    with pytest.raises(ValueError, match=r"data\.count: expected 1 or more, got \[1, 0\]"):
        DataConfig("scenes", Path("none"), scene="soyuz_hard+soyuz_easy", count=[1, 0])


def test_seeds_of_tests_are_refused():
    with pytest.raises(ValueError, match="0 to 999999, as later seeds are not for training, got"):
        DataConfig("scenes", Path("none"), seed=CHOICES.start)
