"""Training on sets other than URSO's: which images validate, and what selects the best epoch."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from safetensors.torch import load_file

from ffpose import DataError
from ffpose.datasets import patches
from ffpose.evaluation.evaluate import evaluate
from ffpose.geometry import Camera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import PRESETS, read_metadata
from ffpose.render import SceneFile
from ffpose.training.calibration_images import open_calibration
from ffpose.training.config import (
    CalibrationImages,
    DataConfig,
    ObjectLossConfig,
    PatchAugmentation,
    TrainConfig,
)
from ffpose.training.data import open_training_data
from ffpose.training.engine import train
from ffpose.training.run import build_run
from scene_runs import FIELDS
from tiny_runs import train_config

CAMERA = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
IMAGES = 6


def write_images(root, names):
    generator = np.random.default_rng(0)
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        pixels = generator.integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(root / name)
    (root / "camera.json").write_text(json.dumps(CAMERA))


@pytest.fixture
def scene(tmp_path):
    """A scene of Cambridge's whose cameras stand around (100, 200, 300)."""
    root = tmp_path / "scene"
    names = [f"seq1/{index}.png" for index in range(IMAGES)]
    write_images(root, names)
    rows = [f"{name} {100 + i} 200 {300 - i} 0.6 0 0.8 0\n" for i, name in enumerate(names)]
    header = "Visual\nImageFile, Camera Position [X Y Z W P Q R]\n\n"
    (root / "dataset_train.txt").write_text(header + "".join(rows))
    (root / "dataset_test.txt").write_text(header + "".join(rows[:2]))
    return root


@pytest.fixture
def own(tmp_path):
    """A user's own images, without a split that validates."""
    root = tmp_path / "own"
    names = [f"{index}.png" for index in range(IMAGES)]
    write_images(root, names)
    rows = [f"{name},0,0,{5 + index},1,0,0,0\n" for index, name in enumerate(names)]
    (root / "train.csv").write_text("image,tx,ty,tz,qw,qx,qy,qz\n" + "".join(rows))
    return root


def opened(config, model="tiny"):
    return open_training_data(config, PRESETS[model], Preprocessing((32, 32)), coordinates=False)


def test_held_out_images_validate_and_do_not_train(own):
    data = opened(DataConfig("csv", own, holdout=3))
    assert data.val_set.names == ["0.png", "3.png"]
    assert data.train_set.names == ["1.png", "2.png", "4.png", "5.png"]
    assert data.val_set.augmentation is None
    np.testing.assert_array_equal(data.train_set.poses[:, 2], [6, 7, 9, 10])


@pytest.mark.parametrize(("split", "z"), [("train", -5), ("val", 0)])
def test_an_object_that_is_not_in_front_of_the_camera_is_refused(own, tmp_path, split, z):
    (own / "val.csv").write_text((own / "train.csv").read_text())
    config = DataConfig("csv", own)
    weights = train(train_config(own, tmp_path / "run", data=config, epochs=1), quiet=True)
    table = own / f"{split}.csv"
    table.write_text(table.read_text().replace(",7,1,", f",{z},1,"))
    expected = rf"{split}\.csv:4: .*2\.png: expected an object in front of .* got z = {z}"
    images = CalibrationImages("csv", own, split=split)
    for work in (
        lambda: opened(config),
        lambda: open_calibration(images, Preprocessing((32, 32))),
        lambda: evaluate(weights.folder.last, "csv", own, split),
    ):
        with pytest.raises(DataError, match=expected):
            work()


def test_a_set_that_validates_on_nothing_is_refused(own):
    with pytest.raises(ValueError, match=r"data\.val_split: expected one of train, got 'val'"):
        opened(DataConfig("csv", own))


def test_any_split_trains(own):
    (own / "flight 2.csv").write_text("\n".join((own / "train.csv").read_text().splitlines()[:3]))
    data = opened(DataConfig("csv", own, train_split="flight 2", val_split="train"))
    assert data.train_set.names == ["0.png", "1.png"]
    assert len(data.val_set) == IMAGES
    with pytest.raises(ValueError, match=r"data.train_split: expected one of train, flight 2, all"):
        opened(DataConfig("csv", own, train_split="flight 3"))


@pytest.mark.parametrize("trained", ["train", "all"])
def test_what_is_trained_on_does_not_validate(own, trained):
    with pytest.raises(
        ValueError, match=r"data.val_split: expected a split that is not trained on"
    ):
        opened(DataConfig("csv", own, train_split=trained, val_split="train"))


def test_all_splits_train_but_for_what_is_held_out(scene):
    (scene / "dataset_test.txt").write_text(
        (scene / "dataset_test.txt").read_text().replace("seq1", "seq2")
    )
    write_images(scene, ["seq2/0.png", "seq2/1.png"])
    data = opened(DataConfig("cambridge", scene, train_split="all", holdout=4))
    assert (len(data.train_set), len(data.val_set)) == (IMAGES, 2)


def test_any_split_validates(scene):
    data = opened(DataConfig("cambridge", scene, val_split="test"))
    assert (len(data.train_set), len(data.val_set)) == (IMAGES, 2)


@pytest.mark.parametrize(
    "options", [{"holdout": 1}, {"holdout": -2}, {"white": 0.0}, {"white": "p0"}]
)
def test_bad_options_are_refused(own, options):
    with pytest.raises(ValueError, match=r"data\.(holdout|white): expected"):
        DataConfig("csv", own, **options)


def test_images_that_validate_are_of_the_training_images_camera(own):
    (own / "wide.json").write_text(json.dumps(CAMERA | {"fx": 100.0}))
    rows = (own / "train.csv").read_text().splitlines()
    (own / "val.csv").write_text(f"{rows[0]},camera\n{rows[1]},wide.json\n")
    with pytest.raises(ValueError, match=r"data\.val_split: .*fx=50\.0.*, got .*fx=100\.0"):
        build_run(train_config(own, own, data=DataConfig("csv", own)))


def second_look(config):
    return open_training_data(config, PRESETS["polar"], Preprocessing((64, 64)), coordinates=False)


def test_no_image_of_a_set_trains_selects_and_calibrates(own):
    small = replace(PRESETS["polar"], image_size=(64, 64))
    config = DataConfig("csv", own, holdout=2)
    data = open_training_data(config, small, Preprocessing((64, 64)), coordinates=False)
    assert data.train_set.names == ["1.png", "3.png", "5.png"]
    assert data.val_set.names == ["0.png", "4.png"]
    assert data.calibration.whole.names == ["2.png"]
    assert data.calibration.cut is None
    assert data.calibration.hard == ()
    assert data.calibration.strangers is None
    (about,) = data.calibration.about
    assert {name: about[name] for name in ("name", "split", "start", "step", "count")} == {
        "name": "own",
        "split": "train",
        "start": 2,
        "step": 4,
        "count": 1,
    }


def test_a_set_without_an_image_that_could_calibrate_is_refused(own):
    small = replace(PRESETS["polar"], image_size=(64, 64))
    config = DataConfig("csv", own, holdout=IMAGES)
    message = "calibration: expected more than 6 images in train, got 6"
    with pytest.raises(ValueError, match=message):
        open_training_data(config, small, Preprocessing((64, 64)), coordinates=False)


def test_a_second_look_needs_an_object_and_a_pinhole(scene, own):
    with pytest.raises(ValueError, match=r"locate an object, got .*locate the camera"):
        second_look(DataConfig("cambridge", scene, val_split="test"))
    text = json.dumps(CAMERA | {"distortion": [0.1, 0, 0, 0, 0]})
    (own / "camera.json").write_text(text)
    config = DataConfig("csv", own, holdout=2)
    with pytest.raises(ValueError, match=r"camera without distortion \(--data\.undistort\)"):
        second_look(config)
    with pytest.raises(ValueError, match=r"data\.mode: expected resize, .* got 'center_crop'"):
        second_look(replace(config, mode="center_crop"))
    small = replace(PRESETS["polar"], image_size=(64, 64))
    undistorted = replace(config, undistort=True)
    data = open_training_data(undistorted, small, Preprocessing((64, 64)), coordinates=False)
    assert len(data.patches) == 1


def test_a_scene_trains_and_selects_by_its_spread(scene, tmp_path):
    """Positions 100 + i, 300 - i of i = 0, 1 are 0.5 from their mean along two axes."""
    config = train_config(scene, tmp_path / "run")
    result = train(replace(config, data=DataConfig("cambridge", scene, val_split="test")))
    scores = [row["val_scene_score"] for row in result.history]
    for row, score in zip(result.history, scores, strict=True):
        position = row["val_median_translation_error_m"] / math.sqrt(0.5)
        rotation = math.radians(row["val_median_rotation_error_deg"])
        assert score == pytest.approx(position + rotation)
    assert result.best_epoch == 1 + scores.index(min(scores))
    evaluation = evaluate(result.folder.best, "cambridge", scene)
    errors = evaluation.errors
    ranked = errors.translation_m.numpy() / math.sqrt(0.5) + np.radians(errors.rotation_deg.numpy())
    assert evaluation.ranking.tolist() == np.argsort(ranked, kind="stable").tolist()
    assert errors.translation_m.max() < 20  # of the center, 374 m from the origin
    assert read_metadata(result.folder.best).data["kind"] == "cambridge"
    assert read_metadata(result.folder.best).locates == "camera"


def test_images_of_several_cameras_train(own, tmp_path):
    other = CAMERA | {"fx": 60.0, "width": 2 * CAMERA["width"]}
    (own / "other.json").write_text(json.dumps(other))
    lines = (own / "train.csv").read_text().splitlines()
    cameras = ["camera", "camera.json", "other.json", *["camera.json"] * (IMAGES - 2)]
    text = "\n".join(f"{line},{camera}" for line, camera in zip(lines, cameras, strict=True))
    (own / "train.csv").write_text(text)
    Image.new("RGB", (other["width"], other["height"])).save(own / "1.png")
    config = train_config(own, tmp_path / "run", epochs=1)
    result = train(replace(config, data=DataConfig("csv", own, holdout=2, cache=True)))
    assert read_metadata(result.folder.best).camera is None
    evaluation = evaluate(result.folder.best, "csv", own, "train")
    assert len(evaluation.errors.translation_m) == IMAGES


def second_look_config(root, out, **fields):
    """One epoch of a small network with a second look on a user's own images."""
    small = FIELDS | {"image_size": [64, 64]}
    points = out.with_name("points.csv")
    points.write_text("name,x,y,z\ntip,1,0,0\nfoot,0,-1,0.5\n")
    data = DataConfig("csv", root, holdout=3, keypoints=str(points))
    loss = ObjectLossConfig(coordinates=0, mask=0, keypoints=1)
    values = {"model": "polar", "model_fields": small, "data": data, "object_loss": loss}
    return TrainConfig(out=out, epochs=1, batch_size=2, device="cpu", **(values | fields))


def test_what_a_second_look_cannot_learn_is_refused(own, tmp_path):
    """Keypoints of a mesh, which names none; images without the object in batches of one."""
    config = second_look_config(own, tmp_path / "run")
    with pytest.raises(ValueError, match="batch_size: expected 2 or more"):
        train(replace(config, batch_size=1))
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "box.stl")
    limits, camera = (180.0, 90.0, 180.0), Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
    scene = SceneFile("box", tmp_path / "box.stl", 1.0, (5.0, 9.0), limits, camera)
    scene.write(tmp_path / "box.json")
    counts = {"count": 4, "validation": 2, "calibration": 2}
    data = DataConfig("scenes", tmp_path / "views", scene=str(tmp_path / "box.json"), **counts)
    with pytest.raises(ValueError, match=r"object_loss\.keypoints: expected 0 .*, got 1"):
        train(replace(config, data=data))


def test_keypoints_teach_a_set_that_has_poses_alone(own, tmp_path):
    """Objects straight ahead, unturned, in a view 6.6 m wide to each side and not displaced.

    The tip is to the right, at the angle zero, the foot above, at three quarters of a turn.
    """
    config = second_look_config(own, tmp_path / "run")
    still = PatchAugmentation(twist_deg=0, look_lateral=0, look_distance=0, empty=0)
    run = build_run(replace(config, views=still))
    (batch,) = [b for b in run.task.batches(0) if 0 in b.index]
    row = batch.index.tolist().index(0)
    scale = 6 / 6.6  # the second of the images, 6 m away
    turns, radii = batch.keypoints[row].unbind(1)
    np.testing.assert_allclose(radii, [scale / 6, scale / 6.5], rtol=1e-5)
    np.testing.assert_allclose((turns + 0.5) % 1, [0.5, 0.25], atol=1e-5)
    before = [value.clone() for value in run.task.loss.parameters()]
    folder = train(config, quiet=True).folder
    assert [tuple(value.shape) for value in before] == [(8, 24, 1, 1), (8,)]
    assert not any("heatmaps" in name for name in load_file(folder.best))


def test_distances_that_the_first_look_cannot_tell_are_named_with_what_to_set(own, tmp_path):
    """It would be clamped to half of the nearest and twice the farthest that it is made for."""
    config = second_look_config(own, tmp_path / "run")
    fields = config.model_fields | {"distance_m": (100.0, 200.0)}
    with pytest.raises(ValueError, match=r"distances of 50 to 400 m, .* got .*--model.distance-m"):
        build_run(replace(config, model_fields=fields))


def test_keypoints_and_their_weight_belong_together(own, tmp_path):
    config = second_look_config(own, tmp_path / "run")
    message = r"expected a file and a weight above 0, or neither, got"
    with pytest.raises(ValueError, match=f"{message} None and 1"):
        replace(config, data=replace(config.data, keypoints=None))
    with pytest.raises(ValueError, match=f"{message} '.*points.csv' and 0"):
        replace(config, object_loss=ObjectLossConfig())
    with pytest.raises(ValueError, match="none with kind scenes, which has its own, got"):
        replace(config, data=replace(config.data, kind="scenes", holdout=0))


@pytest.mark.parametrize("kind", ["csv", "scenes"])
def test_a_network_that_looks_twice_sees_whole_frames(kind, own, tmp_path):
    data = DataConfig(kind, own, mode="center_crop", holdout=3 if kind == "csv" else 0)
    config = second_look_config(own, tmp_path / "run", data=data, object_loss=ObjectLossConfig())
    with pytest.raises(ValueError, match=r"data\.mode: expected resize, with a .* twice"):
        build_run(config)


def test_a_set_without_coordinates_says_what_does_without(own, tmp_path):
    data = DataConfig("csv", own, holdout=3)
    config = second_look_config(own, tmp_path / "run", data=data, object_loss=ObjectLossConfig())
    with pytest.raises(DataError, match=r"train.csv:3: .*--object-loss.keypoints 1 --data.keyp"):
        build_run(config)


def test_views_of_a_set_are_cut_once_where_they_are_cached(own, tmp_path, monkeypatch):
    monkeypatch.setenv("FFPOSE_CACHE", str(tmp_path / "cache"))
    cut = []
    once = patches.extract_patches
    monkeypatch.setattr(
        patches, "extract_patches", lambda *args: cut.append(args[1].t[2]) or once(*args)
    )
    config = DataConfig("csv", own, holdout=3)
    (fresh,) = second_look(config).patches
    assert sorted(cut) == [6, 7, 9, 10]
    for _ in range(2):
        (mapped,) = second_look(replace(config, cache=True)).patches
        assert len(cut) == 8
        for name, values in fresh.items():
            np.testing.assert_array_equal(mapped[name], values)
        assert isinstance(mapped["windows"], np.memmap)
    moved = (own / "train.csv").read_text().replace("0,0,6,1", "0,0,6.5,1")
    (own / "train.csv").write_text(moved)
    (mapped,) = second_look(replace(config, cache=True)).patches
    assert mapped["labels"][0, 2] == 6.5
    assert len(cut) == 12
    (own / "1.png").write_bytes((own / "2.png").read_bytes())
    (mapped,) = second_look(replace(config, cache=True)).patches
    np.testing.assert_array_equal(mapped["frames"][0], mapped["frames"][1])
    assert len(cut) == 16
