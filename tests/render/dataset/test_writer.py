"""Sets of images: layout, the same bytes however made, refusals before work is lost."""

import csv
import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from ffpose import DataError
from ffpose.geometry import Pose
from ffpose.render import (
    SCENES,
    Randomization,
    coordinates_limit,
    find_scene,
    label,
    render,
    render_layers,
    write_dataset,
)
from ffpose.render.dataset import tables, writer
from ffpose.render.dataset.sequence_writer import write_sequence
from ffpose.render.layers import LAYERS, depth_step
from ffpose.render.renderer import camera_of
from ffpose.render.sequence import Sequence

SIZE = (64, 48)


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("set") / "soyuz"
    done = write_dataset("soyuz_easy", out, 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (12, 0)
    return out


def test_layout_is_that_of_urso(folder):
    with (folder / "gt.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["x", "y", "z", "q1", "q2", "q3", "q4"]
    assert len(rows) == 13
    names = {}
    for split in ("train", "val", "test"):
        names[split] = (folder / f"{split}_images.csv").read_text().split()
        with (folder / f"{split}_poses_gt.csv").open() as file:
            poses = list(csv.reader(file))
        assert poses[0] == rows[0]
        assert poses[1:] == [rows[1 + int(name.split("_")[0])] for name in names[split]]
    assert names["val"] == ["1_rgb.png", "11_rgb.png"]
    assert names["test"] == ["2_rgb.png"]
    assert len(names["train"]) == 9
    with Image.open(folder / "0_rgb.png") as image:
        assert image.size == SIZE
        assert image.mode == "RGB"
    camera = json.loads((folder / "camera.json").read_text())
    assert camera == {
        "width": 64, "height": 48, "fx": 32.0, "fy": 640.463 / 20, "cx": 32.0, "cy": 24.0,
    }  # fmt: skip


def test_manifest_has_the_hash_of_every_file(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    there = contents(folder)
    there.pop("manifest.json")
    assert manifest["files"] == {k: hashlib.sha256(v).hexdigest() for k, v in there.items()}
    assert manifest["parameters"]["seed"] == 7
    assert manifest["parameters"]["scene"]["name"] == "soyuz_easy"
    assert set(manifest["versions"]) == {"ffpose", "numpy", "embreex", "pillow"}


def test_written_image_is_what_render_gives(folder):
    frame = render("soyuz_easy", 7, 3, SIZE)
    np.testing.assert_array_equal(np.asarray(Image.open(folder / "3_rgb.png")), frame.image)
    np.testing.assert_array_equal(label("soyuz_easy", 7, 3).vector, frame.pose.vector)


def test_workers_do_not_change_a_byte(folder, tmp_path):
    write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE, workers=2)
    assert contents(tmp_path) == contents(folder)


def test_interrupted_and_damaged_sets_are_completed(folder, tmp_path):
    write_dataset("soyuz_easy", tmp_path, 5, seed=7, size=SIZE)
    (tmp_path / "2_rgb.png").unlink()
    (tmp_path / "3_rgb.png").write_bytes(b"cut off")
    # As a kill leaves it: images, but a manifest without their hashes.
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    (tmp_path / "manifest.json").write_text(json.dumps(manifest | {"files": {}}))
    done = write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (9, 3)
    assert contents(tmp_path) == contents(folder)


def test_altered_image_is_rendered_again(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "set")
    Image.new("RGB", SIZE).save(tmp_path / "set" / "4_rgb.png")
    done = write_dataset("soyuz_easy", tmp_path / "set", 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (1, 11)
    assert contents(tmp_path / "set") == contents(folder)


def test_shards_in_any_order_make_the_set(folder, tmp_path):
    closed = []
    for start, count in ((8, 4), (0, 4), (4, 4)):
        done = write_dataset("soyuz_easy", tmp_path, count, seed=7, start=start, size=SIZE)
        closed.append(done.closed)
    assert closed == [True, False, False]  # the first was alone
    done = write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept, done.closed) == (0, 12, True)
    assert contents(tmp_path) == contents(folder)


def test_shard_alone_keeps_rows_and_names_together(tmp_path):
    assert write_dataset("soyuz_easy", tmp_path, 2, seed=7, start=3, size=SIZE).closed
    assert not (tmp_path / "gt.csv").exists()  # its row 0 would be that of image 0
    with (tmp_path / "train_poses_gt.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["x"]) for row in rows] == [label("soyuz_easy", 7, i).t[0] for i in (3, 4)]
    assert (tmp_path / "train_images.csv").read_text() == "3_rgb.png\n4_rgb.png\n"
    assert not (tmp_path / "val_images.csv").exists()


def test_a_shard_costs_what_its_own_images_cost(tmp_path, monkeypatch):
    """Far from the first index, and beside others: labels drawn and files read are its own."""
    write_dataset("soyuz_easy", tmp_path, 3, seed=7, size=SIZE, labels=["mask"])
    labeled, hashed = set(), set()
    draw, read = writer.label, writer.sha256
    monkeypatch.setattr(writer, "label", lambda s, seed, i: labeled.add(i) or draw(s, seed, i))
    monkeypatch.setattr(writer, "sha256", lambda path: hashed.add(path.name) or read(path))
    far = 5_000_000
    done = write_dataset("soyuz_easy", tmp_path, 2, seed=7, start=far, size=SIZE, labels=["mask"])
    assert done.rendered == 2
    assert labeled <= {far, far + 1}
    own = (far, far + 1)
    assert hashed == {f"{index}_{kind}.png" for index in own for kind in ("mask", "rgb")}
    alone = write_dataset("soyuz_easy", tmp_path / "alone", 2, seed=7, start=far, size=SIZE)
    assert alone.closed
    assert labeled == {far, far + 1}


def test_a_shard_of_a_closed_set_leaves_it_closed(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "set")
    (tmp_path / "set" / "4_rgb.png").unlink()
    done = write_dataset("soyuz_easy", tmp_path / "set", 4, seed=7, start=3, size=SIZE)
    assert (done.rendered, done.kept, done.closed) == (1, 3, True)
    assert contents(tmp_path / "set") == contents(folder)


def test_what_a_part_says_of_an_image_is_held_against_it(folder, tmp_path):
    for start in (0, 6):
        write_dataset("soyuz_easy", tmp_path, 6, seed=7, start=start, size=SIZE)
    Image.new("RGB", SIZE).save(tmp_path / "7_rgb.png")  # whole, but not the image
    done = write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (1, 11)
    assert contents(tmp_path) == contents(folder)


def rows_by_name(folder, split):
    """The label of each image that a split lists, as text."""
    names = (folder / f"{split}_images.csv").read_text().split()
    with (folder / f"{split}_poses_gt.csv").open() as file:
        return dict(zip(names, csv.DictReader(file), strict=True))


def test_shards_that_close_at_once_do_not_mix_names_and_poses(tmp_path, monkeypatch):
    """A second shard runs whole while the first is between its names and its poses."""
    write_poses, began = tables._write_poses, []

    def interrupted(target, poses):
        if target.name == "train_poses_gt.csv" and not began:
            began.append(True)
            write_dataset("soyuz_easy", tmp_path, 4, seed=7, start=4, size=SIZE)
        write_poses(target, poses)

    monkeypatch.setattr(tables, "_write_poses", interrupted)
    write_dataset("soyuz_easy", tmp_path, 4, seed=7, size=SIZE)
    assert (tmp_path / "7_rgb.png").exists()
    for name, row in rows_by_name(tmp_path, "train").items():
        pose = Pose.from_urso(**{key: float(value) for key, value in row.items()})
        expected = label("soyuz_easy", 7, int(name.split("_")[0]))
        np.testing.assert_array_equal(pose.t, expected.t)


def test_layers_are_written_beside_the_images(tmp_path):
    labels = [*LAYERS, "coordinates"]
    write_dataset("soyuz_easy", tmp_path, 2, seed=7, size=SIZE, labels=labels)
    truth = render_layers("soyuz_easy", 7, 1, SIZE)
    mask = np.asarray(Image.open(tmp_path / "1_mask.png"))
    np.testing.assert_array_equal(mask, np.where(truth.mask, 255, 0))
    depth = np.asarray(Image.open(tmp_path / "1_depth.png"))
    np.testing.assert_allclose(depth / 1000, truth.depth, atol=6e-4)
    with (tmp_path / "1_keypoints.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [point.name for point in truth.keypoints]
    assert [float(row["u"]) for row in rows] == [point.u for point in truth.keypoints]
    with Image.open(tmp_path / "1_coordinates.png") as image:
        assert image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image), truth.coordinates)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert {"0_depth.png", "0_coordinates.png"} <= manifest["files"].keys()
    assert manifest["parameters"]["labels"] == labels
    assert manifest["parameters"]["depth_step_m"] == pytest.approx(0.001)
    limit = coordinates_limit(SCENES["soyuz_easy"].build())
    assert manifest["parameters"]["coordinates_limit_m"] == limit


@pytest.mark.parametrize(("scale", "step"), [(0.02, 1e-4), (1.0, 0.001), (20.0, 0.1)])
def test_depth_files_hold_any_distance(tmp_path, scale, step):
    """65,535 codes: 47 m of depth need steps of 1 mm, 20 times as much of 0.1 m."""
    easy = SCENES["soyuz_easy"]
    craft, distances = easy.build().scaled(scale), (8 * scale, 42 * scale)
    scene = replace(easy, craft=craft, distance_m=distances, lateral_m=12 * scale)
    write_dataset(scene, tmp_path, 1, seed=7, size=SIZE, labels=["depth"])
    truth = render_layers(scene, 7, 0, SIZE).depth
    depth = np.asarray(Image.open(tmp_path / "0_depth.png"))
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["parameters"]["depth_step_m"] == pytest.approx(step)
    assert truth.max() > 4 * scale
    np.testing.assert_allclose(depth * step, truth, atol=0.51 * step)


def test_depth_steps_hold_a_spacecraft_whose_origin_is_at_one_end():
    easy = SCENES["soyuz_easy"]
    craft = easy.build()
    vertices = craft.mesh.vertices + np.array([0.9 * craft.radius, 0, 0])
    aside = replace(craft, mesh=replace(craft.mesh, vertices=vertices))
    scene = replace(easy, craft=aside, distance_m=(40.0, 58.0))
    farthest = np.linalg.norm(aside.mesh.vertices, axis=1).max()
    assert 65_535 * depth_step(scene) >= 58.0 + farthest


def test_only_the_labels_that_were_asked_for_are_written(tmp_path):
    write_dataset("soyuz_easy", tmp_path, 1, size=SIZE, labels=["coordinates", "mask"])
    images = {path.name for path in tmp_path.iterdir() if path.suffix == ".png"}
    assert images == {"0_rgb.png", "0_mask.png", "0_coordinates.png"}
    assert not (tmp_path / "0_keypoints.csv").exists()


def test_what_a_killed_run_left_is_removed(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "set")
    left = tmp_path / "set" / ".ffpose-left"
    left.mkdir()
    (left / "4_rgb.png").write_bytes(b"cut off")
    os.utime(left, (0, 0))
    write_dataset("soyuz_easy", tmp_path / "set", 12, seed=7, size=SIZE)
    assert contents(tmp_path / "set") == contents(folder)


def test_lost_layer_is_written_again(tmp_path):
    labels = [*LAYERS, "coordinates"]
    write_dataset("soyuz_easy", tmp_path, 4, seed=7, size=SIZE, labels=labels)
    before = contents(tmp_path)
    (tmp_path / "0_mask.png").unlink()
    (tmp_path / "1_keypoints.csv").write_text("altered")
    (tmp_path / "2_coordinates.png").write_bytes(b"cut off")
    done = write_dataset("soyuz_easy", tmp_path, 4, seed=7, size=SIZE, labels=labels)
    assert (done.rendered, done.kept) == (3, 1)
    assert contents(tmp_path) == before


def test_a_layer_that_was_cut_off_before_its_hash_was_known_is_written_again(tmp_path):
    labels = [*LAYERS, "coordinates"]
    write_dataset("soyuz_easy", tmp_path, 6, seed=7, size=SIZE, labels=labels)
    before = contents(tmp_path)
    manifest = json.loads(before["manifest.json"])
    (tmp_path / "manifest.json").write_text(json.dumps(manifest | {"files": {}}))
    for name in ("0_mask.png", "1_keypoints.csv", "2_coordinates.png", "3_depth.png"):
        (tmp_path / name).write_bytes(before[name][: len(before[name]) // 2])
    *rows, _ = before["4_keypoints.csv"].splitlines(keepends=True)
    (tmp_path / "4_keypoints.csv").write_bytes(b"".join(rows))
    done = write_dataset("soyuz_easy", tmp_path, 6, seed=7, size=SIZE, labels=labels)
    assert (done.rendered, done.kept) == (5, 1)
    assert contents(tmp_path) == before


def test_folder_of_another_set_is_left_alone(folder):
    before = contents(folder)
    with pytest.raises(ValueError, match="seed 7 there, 8 now"):
        write_dataset("soyuz_easy", folder, 12, seed=8, size=SIZE)
    assert contents(folder) == before


def test_foreign_images_are_left_alone(tmp_path):
    Image.new("RGB", SIZE).save(tmp_path / "0_rgb.png")
    with pytest.raises(ValueError, match="images without a manifest"):
        write_dataset("soyuz_easy", tmp_path, 2, size=SIZE)


def test_the_camera_of_other_images_is_left_alone(tmp_path):
    """As of a sequence of frames, or of a set of one's own."""
    frames = Sequence.of_kind("tumble", SCENES["soyuz_easy"], 1, 2, 0, (32, 24))
    write_sequence(frames, tmp_path)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=r"got another camera\.json without a manifest: move it"):
        write_dataset("soyuz_easy", tmp_path, 2, size=SIZE)
    assert contents(tmp_path) == before


def test_the_camera_of_a_set_may_be_there_before_it(tmp_path):
    camera_of(SCENES["soyuz_easy"], SIZE).write(tmp_path / "camera.json")
    assert write_dataset("soyuz_easy", tmp_path, 2, size=SIZE).rendered == 2


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"parameters": [], "versions": {}, "files": {}}', '{"parameters": {}}']
)
def test_broken_manifest_is_named(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(DataError, match=r"manifest\.json"):
        write_dataset("soyuz_easy", tmp_path, 2, size=SIZE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scene": "sputnik"}, "scene: expected one of soyuz_easy, soyuz_hard, dragon_hard, or a"),
        ({"count": 0}, "count: expected 1"),
        ({"count": 10**9}, "count: expected 1"),
        ({"start": -1}, "start: expected 0"),
        ({"seed": -1}, "seed: expected 0"),
        ({"workers": 0}, "workers: expected 1"),
        ({"labels": ["masks"]}, "labels: expected some of mask, depth, .*, got 'masks'"),
        ({"size": (8, 8)}, "size: expected width and height"),
        ({"size": (100_000, 100)}, "size: expected width and height"),
    ],
)
def test_absurd_requests_are_refused_before_anything_is_written(tmp_path, change, message):
    request = {"scene": "soyuz_easy", "out": tmp_path / "new", "count": 2, "size": SIZE} | change
    with pytest.raises(ValueError, match=message):
        write_dataset(**request)
    assert not (tmp_path / "new").exists()


def test_scene_without_a_pose_fails_before_anything_is_written(tmp_path):
    scene = replace(SCENES["soyuz_easy"], distance_m=(2.0, 2.5), lateral_m=0.1, min_visible=1.0)
    with pytest.raises(ValueError, match="found no pose"):
        write_dataset(scene, tmp_path / "new", 2, size=SIZE)
    assert not (tmp_path / "new").exists()


def test_set_larger_than_the_disk_is_refused_at_once(tmp_path, monkeypatch):
    room = shutil.disk_usage(tmp_path)._replace(free=10**6)
    monkeypatch.setattr("shutil.disk_usage", lambda path: room)
    new = tmp_path / "a" / "new"
    with pytest.raises(OSError, match=r"1000 images need at least 0\.5 GB, got 0\.0 GB free"):
        write_dataset("soyuz_easy", new, 1000, size=(1280, 960))
    assert not list(tmp_path.iterdir())
    assert write_dataset("soyuz_easy", new, 1, size=SIZE).rendered == 1


def test_disk_that_fills_up_is_one_error_and_the_next_run_carries_on(folder, tmp_path, monkeypatch):
    whole, written = Image.Image.save, []

    def full(image, path, **options):
        if len(written) == 4:
            path.write_bytes(b"half a pic")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        written.append(path)
        whole(image, path, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", full)
        with pytest.raises(OSError, match="No space left"):
            write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"manifest.json", *(f"{index}_rgb.png" for index in range(4))}
    done = write_dataset("soyuz_easy", tmp_path, 12, seed=7, size=SIZE)
    assert (done.rendered, done.kept) == (8, 4)
    assert contents(tmp_path) == contents(folder)


RUN = """
import sys
from ffpose.render import write_dataset

if __name__ == "__main__":
    write_dataset("soyuz_easy", sys.argv[1], 100_000, seed=7, size=(64, 48), workers=2)
"""


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_parent_and_the_next_run_carries_on(folder, tmp_path, end):
    (tmp_path / "run.py").write_text(RUN)
    command = [sys.executable, tmp_path / "run.py", tmp_path / "set"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as run:
        waits = 0
        while not list(tmp_path.glob("set/*_rgb.png")) and waits < 600:
            time.sleep(0.1)
            waits += 1
        run.send_signal(end)
        # The workers hold this pipe too: it ends with the last of them.
        run.communicate(timeout=30)
    images = {f"{index}_rgb.png" for index in range(12)}
    left = {path.name for path in (tmp_path / "set").iterdir()} - {"manifest.json"}
    assert left & images
    for name in left - images:
        assert name.endswith("_rgb.png")
        (tmp_path / "set" / name).unlink()
    done = write_dataset("soyuz_easy", tmp_path / "set", 12, seed=7, size=SIZE)
    assert done.kept == len(left & images)
    assert contents(tmp_path / "set") == contents(folder)


def test_a_second_renderer_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    scene = replace(SCENES["soyuz_easy"], renderer="mitsuba")
    with pytest.raises(ImportError, match=r"ffpose\[mitsuba\]"):
        write_dataset(scene, tmp_path / "new", 3, size=SIZE)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"renderer": "blender"}, "renderer: expected one of ffpose, mitsuba, got 'blender'"),
        (
            {"renderer": "mitsuba", "randomization": Randomization.of_strength(0.5)},
            "expected ffpose for randomized materials",
        ),
    ],
)
def test_what_a_renderer_cannot_do_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        replace(SCENES["soyuz_easy"], **fields)


def test_unwritable_folder_is_an_os_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        write_dataset("soyuz_easy", tmp_path / "file" / "set", 2, size=SIZE)


def test_unknown_set_lists_the_known():
    with pytest.raises(ValueError, match=r"scene: expected one of soyuz_easy, .*, got 'x'"):
        find_scene("x")
