"""What the inspection of a dataset finds and draws."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from ffpose.datasets import inspection, open_dataset
from ffpose.datasets.inspection import contact_sheet, inspect_folder
from ffpose.errors import DataError
from ffpose.imaging.preprocessing import Preprocessing
from urso_sets import LABELS, POSES, SPLITS, table, write_set


@pytest.fixture
def unwritten(monkeypatch):
    """Histograms are drawn, but not written, which takes longer than all else."""
    monkeypatch.setattr(inspection, "save_figure", lambda figure, path, **options: None)


def relabel(root, split, **labels):
    """Change labels of one split, and take away the table that would not agree."""
    (root / "gt.csv").unlink(missing_ok=True)
    rows = {name: LABELS[name] | labels.get(name.removesuffix(".png"), {}) for name in LABELS}
    (root / f"{split}_poses_gt.csv").write_text(table(SPLITS[split], rows))


def write_csv_set(root):
    """Write two images and their camera, for splits to name."""
    root.mkdir()
    camera = {"width": 64, "height": 48, "fx": 32, "fy": 32, "cx": 32, "cy": 24}
    (root / "camera.json").write_text(json.dumps(camera))
    for name in ("a.png", "b.png"):
        Image.new("RGB", (64, 48)).save(root / name)
    return root


@pytest.mark.slow
def test_the_files_are_there_and_open(tmp_path):
    out = tmp_path / "report" / "inspect"
    summary = inspect_folder("urso", write_set(tmp_path / "set"), out)
    assert json.loads((out / "summary.json").read_text()) == summary
    assert {path.name for path in out.iterdir()} == {*summary["files"], "summary.json"}
    for name in summary["files"]:
        with Image.open(out / name) as image:
            image.load()
            assert min(image.size) > 100


@pytest.mark.usefixtures("unwritten")
def test_counts_and_ranges_are_those_of_the_labels(tmp_path):
    summary = inspect_folder("urso", write_set(tmp_path / "set"), tmp_path / "out")
    assert {name: s["images"] for name, s in summary["splits"].items()} == {
        "train": 2,
        "val": 1,
        "test": 1,
    }
    train = summary["splits"]["train"]
    poses = np.array([POSES[name] for name in SPLITS["train"]], float)
    distances = np.linalg.norm(poses[:, :3], axis=1)
    for name, values in {"distance": distances, "y (down)": poses[:, 1]}.items():
        found = train["ranges"][name]
        assert found["unit"] == "m"
        assert found["least"] == pytest.approx(values.min())
        assert found["median"] == pytest.approx(np.median(values))
        assert found["greatest"] == pytest.approx(values.max())
    yaw_pitch_roll = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_euler(
        "ZYX", degrees=True
    )
    assert train["ranges"]["yaw"]["median"] == pytest.approx(np.median(yaw_pitch_roll[:, 0]))
    assert train["origin_in_image"] == 1
    assert train["failed"] == {
        "unit_quaternion": [],
        "scalar_not_negative": ["0_rgb.png"],
        "in_front_of_camera": [],
    }


@pytest.mark.usefixtures("unwritten")
def test_a_target_behind_the_camera_or_outside_the_image_is_found(tmp_path):
    root = write_set(tmp_path / "set")
    relabel(root, "train", **{"0_rgb": {"z": -10}, "2_rgb": {"x": 30}})
    summary = inspect_folder("urso", root, tmp_path / "out")
    train = summary["splits"]["train"]
    assert train["failed"]["in_front_of_camera"] == ["0_rgb.png"]
    assert train["origin_in_image"] == 0


@pytest.mark.usefixtures("unwritten")
def test_quaternions_are_checked_as_the_file_has_them(tmp_path):
    """Norms: sqrt(0.6003² + 0.8²) = 1.00018, and 1.0000018, which is rounding."""
    root = write_set(tmp_path / "set")
    long = {"q1": 0, "q2": 0.8, "q3": 0, "q4": 0.6003}
    rounded = {"q1": 0.8, "q2": 0, "q3": 0, "q4": 0.600003}
    relabel(root, "train", **{"0_rgb": long, "2_rgb": rounded})
    failed = inspect_folder("urso", root, tmp_path / "out")["splits"]["train"]["failed"]
    assert failed["unit_quaternion"] == ["0_rgb.png"]
    assert failed["scalar_not_negative"] == []
    relabel(root, "train", **{"2_rgb": {"q3": -0.8, "q4": -0.6}})
    failed = inspect_folder("urso", root, tmp_path / "out")["splits"]["train"]["failed"]
    assert failed["unit_quaternion"] == []
    assert sorted(failed["scalar_not_negative"]) == ["0_rgb.png", "2_rgb.png"]


@pytest.mark.usefixtures("unwritten")
def test_an_image_in_two_splits_is_found(tmp_path):
    root = write_set(tmp_path / "set")
    for kind in ("images", "poses_gt"):
        (root / f"val_{kind}.csv").write_bytes((root / f"train_{kind}.csv").read_bytes())
    summary = inspect_folder("urso", root, tmp_path / "out")
    assert summary["shared_images"] == ["0_rgb.png", "2_rgb.png"]


def test_an_image_of_another_size_stops_it(tmp_path):
    root = write_set(tmp_path / "set")
    Image.new("RGB", (64, 47)).save(root / "images" / "3_rgb.png")
    (root / "camera.json").write_text(
        json.dumps({"width": 64, "height": 48, "fx": 32, "fy": 32, "cx": 32, "cy": 24})
    )
    with pytest.raises(DataError, match=r"val_images\.csv:1: .*got 64x47"):
        inspect_folder("urso", root, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_truncated_image_stops_it(tmp_path):
    root = write_set(tmp_path / "set")
    path = root / "images" / "3_rgb.png"
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(DataError, match=r"val_images\.csv:1: .*3_rgb\.png: .*truncated"):
        inspect_folder("urso", root, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_sheet_shows_the_axes_at_the_labeled_place(tmp_path):
    dataset = open_dataset("urso", write_set(tmp_path / "set"), "test", Preprocessing())
    pixels = np.asarray(contact_sheet(dataset, 4)).astype(int)
    # 1_rgb.png: u = 32 + 32 * -3 / 12 = 24, v = 24 + 32.02 * 2 / 12, at five times the size,
    # and a margin of six pixels; x and z are turned about y, which points down from there.
    column = pixels[153 : 153 + 40, 126 - 3 : 126 + 3]
    assert (column[..., 1] - column[..., 0] > 100).any(axis=1).mean() > 0.9


@pytest.mark.usefixtures("unwritten")
def test_a_set_may_have_more_splits_than_there_are_colors(tmp_path):
    root = write_csv_set(tmp_path / "set")
    flights = [f"flight {number}" for number in range(9)]
    for name in flights:
        (root / f"{name}.csv").write_text("image,tx,ty,tz,qw,qx,qy,qz\na.png,0,0,9,1,0,0,0\n")
    summary = inspect_folder("csv", root, tmp_path / "out")
    assert list(summary["splits"]) == flights


@pytest.mark.usefixtures("unwritten")
def test_splits_without_labels_are_counted_and_decoded(tmp_path):
    root = write_csv_set(tmp_path / "set")
    (root / "train.csv").write_text("image,tx,ty,tz,qw,qx,qy,qz\na.png,0,0,9,1,0,0,0\n")
    (root / "flight.csv").write_text("image\na.png\nb.png\n")
    summary = inspect_folder("csv", root, tmp_path / "out")
    assert summary["unlabeled"] == {"flight": 2}
    assert list(summary["splits"]) == ["train"]
    assert summary["shared_images"] == ["a.png"]
    (root / "b.png").write_bytes(b"none")
    with pytest.raises(DataError, match=r"flight\.csv:3: .*b\.png: cannot be read"):
        inspect_folder("csv", root, tmp_path / "other")
    (root / "train.csv").unlink()
    with pytest.raises(ValueError, match=r"expected labels in a split .*, got none in flight$"):
        inspect_folder("csv", root, tmp_path / "other")


@pytest.mark.usefixtures("unwritten")
def test_labels_that_locate_the_camera_have_no_object_in_view(tmp_path):
    """The camera at (3, 4, -12) is 13 m from the origin; the second norm is 1.04."""
    root = tmp_path / "scene"
    root.mkdir()
    lines = ["Visual", "ImageFile, Camera Position [X Y Z W P Q R]", ""]
    lines += ["0.png 3 4 -12 1 0 0 0", "1.png 3 4 -12 1.04 0 0 0"]
    (root / "dataset_train.txt").write_text("\n".join(lines))
    for index in range(2):
        Image.new("RGB", (96, 54)).save(root / f"{index}.png")
    train = inspect_folder("cambridge", root, tmp_path / "out")["splits"]["train"]
    assert train["ranges"]["distance"]["median"] == pytest.approx(13)
    assert train["ranges"]["z"]["least"] == pytest.approx(-12)
    assert train["origin_in_image"] is None
    assert train["failed"] == {"unit_quaternion": ["1.png"], "scalar_not_negative": []}
