"""The 7Scenes reader on a room made by hand."""

import numpy as np
import pytest
from PIL import Image

from ffpose.datasets import list_splits, open_dataset
from ffpose.errors import DataError
from ffpose.imaging.preprocessing import Preprocessing

PREPROCESSING = Preprocessing(size=(24, 32))
# From the camera to the world: its x, y and z axes are the world's x, -z and y, as for a camera
# that looks along y with z up; printed as the set has them, with tabs and a space at the end.
POSE = "\n".join(
    [
        "  1.0000000e+000\t  0.0000000e+000\t  0.0000000e+000\t  5.0000000e-001\t ",
        "  0.0000000e+000\t  1.0000000e-004\t  1.0000000e+000\t -2.0000000e+000\t ",
        "  0.0000000e+000\t -1.0000000e+000\t  1.0000000e-004\t  1.5000000e+000\t ",
        "  0.0000000e+000\t  0.0000000e+000\t  0.0000000e+000\t  1.0000000e+000\t \n",
    ]
)


@pytest.fixture
def root(tmp_path):
    (tmp_path / "TrainSplit.txt").write_text("sequence3\r\nsequence1\r\n")
    (tmp_path / "TestSplit.txt").write_text("sequence12\n")
    for sequence in ("seq-01", "seq-03", "seq-12"):
        (tmp_path / sequence).mkdir()
        for frame in range(2):
            stem = tmp_path / sequence / f"frame-00000{frame}"
            Image.new("RGB", (64, 48), (50, 60, 70)).save(f"{stem}.color.png")
            Image.new("I;16", (64, 48)).save(f"{stem}.depth.png")
            stem.with_name(f"{stem.name}.pose.txt").write_text(POSE)
    return tmp_path


def read(root, split="train"):
    return open_dataset("sevenscenes", root, split, PREPROCESSING)


def test_points_of_the_world_are_projected_where_they_are_seen(root):
    """From (0.5, -2, 1.5), the point (0.7, 0, 1.4) is 0.2 right, 0.1 down and 2 ahead."""
    dataset = read(root)
    assert (dataset.camera.width, dataset.camera.fx) == (64, 52.5)
    pixel = dataset.records[0].pose.project([0.7, 0.0, 1.4], dataset.camera)
    np.testing.assert_allclose(pixel, [32 + 5.25, 24 + 2.625], atol=0.02)


def test_the_network_learns_the_center_of_the_camera(root):
    dataset = read(root)
    half = 0.5**0.5
    expected = [0.5, -2, 1.5, half, half, 0, 0]  # a quarter turn about x, from world to camera
    np.testing.assert_allclose(dataset.poses, [expected] * 4, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(dataset.poses[:, 3:], axis=1), 1, rtol=1e-14)


def test_sequences_are_those_of_the_split_in_its_order(root):
    assert list_splits("sevenscenes", root) == ["train", "test"]
    names = [f"{s}/frame-00000{f}.color.png" for s in ("seq-03", "seq-01") for f in range(2)]
    assert read(root).names == names
    assert read(root, "test").names[0] == "seq-12/frame-000000.color.png"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seq-01\n", r":1: expected a line such as sequence1, got 'seq-01'"),
        ("sequence3\n\nsequence1\n", r":2: expected a line such as sequence1, got ''"),
        ("sequence1\nsequence1\n", r":2: seq-01 is on line 1 already"),
        ("sequence1\nsequence7\n", r":2: expected frames in .*seq-07, got none"),
        ("", r": expected at least one sequence"),
    ],
)
def test_a_broken_split_is_named_by_file_and_line(root, text, words):
    (root / "TrainSplit.txt").write_text(text)
    with pytest.raises(DataError, match=r"TrainSplit\.txt" + words):
        read(root)


def test_blank_lines_may_end_a_split(root):
    names = read(root).names
    (root / "TrainSplit.txt").write_text("sequence3\nsequence1\n\n \t\n")
    assert read(root).names == names


@pytest.mark.parametrize("suffix", ["color.png", "pose.txt"])
def test_a_frame_has_an_image_and_a_pose(root, suffix):
    (root / "seq-01" / f"frame-000001.{suffix}").unlink()
    with pytest.raises(DataError, match=rf"TrainSplit\.txt:2: expected .*frame-000001\.{suffix}"):
        read(root)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("5.0000000e-001", "nan", r":1: expected four finite numbers"),
        ("5.0000000e-001", "x", r":1: expected four numbers"),
        ("  1.5000000e+000", "", r":3: expected four finite numbers"),
        ("1.0000000e+000\t \n", "2.0000000e+000\t \n", r":4: expected 0 0 0 1"),
        ("  1.0000000e+000\t  0.0", " -1.0000000e+000\t  0.0", r": expected a rotation"),
        ("  1.0000000e+000\t  0.0", "  1.1000000e+000\t  0.0", r": expected a rotation"),
        (POSE.splitlines()[-1] + "\n", "", r": expected four rows of four numbers, got 3 rows"),
        (POSE, "", r": expected four rows of four numbers, got 0 rows"),
    ],
)
def test_a_broken_pose_is_named_by_file_and_line(root, old, new, words):
    assert old in POSE
    path = root / "seq-01" / "frame-000001.pose.txt"
    path.write_text(POSE.replace(old, new, 1))
    with pytest.raises(DataError, match=r"frame-000001\.pose\.txt" + words):
        read(root)
