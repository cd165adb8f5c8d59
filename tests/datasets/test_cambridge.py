"""The Cambridge Landmarks reader on scenes made by hand, in both forms of the labels."""

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from ffpose.datasets import list_splits, open_dataset
from ffpose.errors import DataError
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.transforms import Augmentation

PREPROCESSING = Preprocessing(size=(24, 32))
HEADER = (
    "Visual Landmark Dataset V1\nImageFile, Camera Position [X Y Z W P Q R]\n\n"  # as published
)
# The second camera looks along the world's y axis: x right, -z down, y forward. Its quaternion, a
# quarter turn about x from the world to the camera, has the norm 1.04.
ROWS = {
    "seq1/frame00002.png": (3.0, 4.0, -12.0, -1.0, 0.0, 0.0, 0.0),
    "seq1/frame00001.png": (10.0, -20.0, 2.0, 0.7353910525, 0.7353910525, 0.0, 0.0),
}
TEST = {"seq2/frame00001.png": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)}


def images(root, names):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (192, 108), (90, 80, 70)).save(root / name)


def text(rows):
    return HEADER + "".join(f"{name} {' '.join(map(str, row))}\n" for name, row in rows.items())


@pytest.fixture
def root(tmp_path):
    for split, rows in {"train": ROWS, "test": TEST}.items():
        (tmp_path / f"dataset_{split}.txt").write_text(text(rows))
        images(tmp_path, rows)
    return tmp_path


def table(rows, split, scene="KingsCollege"):
    return [
        ",".join(map(str, (scene, split, name.split("/")[1], name, *row)))
        for name, row in rows.items()
    ]


@pytest.fixture
def csv_root(tmp_path):
    rows, test = ({f"KingsCollege/{n}": r for n, r in each.items()} for each in (ROWS, TEST))
    header = "scene,split,seq,img_path,t1,t2,t3,q1,q2,q3,q4"
    lines = [header, *table(test, "test"), *table(rows, "train")]
    (tmp_path / "labels.csv").write_text("\n".join(lines) + "\n")
    images(tmp_path, [*rows, *test])
    return tmp_path


def read(root, split="train", **options):
    return open_dataset("cambridge", root, split, PREPROCESSING, **options)


@pytest.mark.parametrize("form", ["root", "csv_root"])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_points_of_the_world_are_projected_where_they_are_seen(request, form, ending):
    """The camera at (10, -20, 2) looks along y: (13, 10, 1) is 3 right, 1 down and 30 ahead."""
    root = request.getfixturevalue(form)
    for path in [*root.glob("*.txt"), *root.glob("*.csv")]:
        path.write_bytes(path.read_text().replace("\n", ending).encode())
    dataset = read(root)
    camera = dataset.camera
    assert (camera.width, camera.height, camera.fx) == (192, 108, 167.4)
    pixel = dataset.records[1].pose.project([13.0, 10.0, 1.0], camera)
    np.testing.assert_allclose(pixel, [96 + 167.4 * 0.1, 54 + 167.4 / 30], atol=1e-6)
    # The first has the world's axes: (3.5, 4, -7) is 0.5 right and 5 ahead.
    pixel = dataset.records[0].pose.project([3.5, 4.0, -7.0], camera)
    np.testing.assert_allclose(pixel, [96 + 167.4 * 0.1, 54], atol=1e-9)


def test_the_network_learns_the_center_of_the_camera(root):
    dataset = read(root)
    assert dataset.target == "camera"
    half = 0.5**0.5
    expected = [[3, 4, -12, 1, 0, 0, 0], [10, -20, 2, half, half, 0, 0]]
    np.testing.assert_allclose(dataset.poses, expected, atol=1e-12)
    np.testing.assert_allclose(dataset[1].translation, [10, -20, 2], rtol=1e-6)
    for index, record in enumerate(dataset.records):
        pose = dataset.to_pose(dataset.poses[index])
        np.testing.assert_allclose(pose.vector, record.pose.vector, atol=1e-12)
        center = Rotation.from_quat(record.pose.q, scalar_first=True).inv().apply(-record.pose.t)
        np.testing.assert_allclose(center, dataset.poses[index, :3], atol=1e-12)


def test_norms_are_kept_for_the_checks(root):
    assert read(root).records[1].raw_quaternion == ROWS["seq1/frame00001.png"][3:]
    assert read(root).names == list(ROWS)


@pytest.mark.parametrize("form", ["root", "csv_root"])
def test_train_is_the_first_split(request, form):
    root = request.getfixturevalue(form)
    assert list_splits("cambridge", root) == ["train", "test"]
    assert len(read(root, "all")) == 3
    with pytest.raises(ValueError, match=r"expected one of \('train', 'test', 'all'\), got 'val'"):
        read(root, "val")


def test_hidden_files_are_no_tables(csv_root):
    (csv_root / "._labels.csv").write_bytes(b"\0what macOS leaves")
    assert list_splits("cambridge", csv_root) == ["train", "test"]


def test_turning_the_camera_is_refused(root):
    with pytest.raises(ValueError, match="labels that locate the camera"):
        read(root, augmentation=Augmentation(pan=5))


LINE = "seq1/frame00001.png 10.0 -20.0 2.0 0.7353910525 0.7353910525 0.0 0.0"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("ImageFile, Camera", "File, Camera", r":2: expected 'ImageFile, Camera Position"),
        (HEADER, "", r":2: expected 'ImageFile, Camera Position"),
        (LINE, LINE + " 1", r":5: expected image X Y Z W P Q R, got"),
        (LINE, LINE[:-4], r":5: expected image X Y Z W P Q R, got"),
        (LINE, f"\n{LINE}", r":5: expected image X Y Z W P Q R, got ''"),
        ("-20.0", "nan", r":5: Y: expected a finite number, got 'nan'"),
        ("-20.0", "east", r":5: Y: expected a finite number, got 'east'"),
        ("-1.0 0.0", "0.0 0.0", r":4: quaternion: expected norm 1 within 0\.05, got 0"),
        ("0.7353910525 0.7", "0.9353910525 0.7", r":5: quaternion: expected norm 1 within"),
        ("frame00001", "frame00002", r":5: seq1/frame00002\.png is on line 4 already"),
        ("frame00001", "frame00003", r":5: expected the image .*frame00003\.png"),
        ("seq1/frame00001", "../seq1/frame00001", r":5: expected the path of an image within"),
        (text(ROWS)[len(HEADER) :], "", r": expected at least one image"),
    ],
)
def test_a_broken_list_is_named_by_file_and_line(root, old, new, words):
    path = root / "dataset_train.txt"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(DataError, match=r"dataset_train\.txt" + words):
        read(root)


def test_blank_lines_may_end_a_list(root):
    path = root / "dataset_train.txt"
    path.write_text(path.read_text() + "\n \n")
    assert read(root).names == list(ROWS)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("img_path", "image", r":1: expected the columns scene, split, seq, img_path"),
        ("q3,q4", "q3,q3", r":1: expected a header of distinct columns"),
        (",0.0,0.0\n", ",0.0\n", r":2: expected 11 fields, got 10"),
        ("-20.0", "inf", r":4: t2: expected a finite number, got 'inf'"),
        ("frame00001.png,10", "frame00002.png,10", r":4: .*is on line 3 already"),
        (",train,", ",,", r":3: split: expected a name"),
    ],
)
def test_a_broken_table_is_named_by_file_and_line(csv_root, old, new, words):
    path = csv_root / "labels.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(DataError, match=r"labels\.csv" + words):
        read(csv_root)


def test_a_folder_without_lists_is_no_scene(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"dataset_train\.txt, .* or a CSV file"):
        list_splits("cambridge", tmp_path)
    with pytest.raises(FileNotFoundError, match="got no such file or folder"):
        list_splits("cambridge", tmp_path / "none")


def test_images_of_another_shape_need_a_camera_file(root):
    for name in ROWS:
        Image.new("RGB", (192, 120)).save(root / name)
    with pytest.raises(DataError, match=r"dataset_train\.txt:4: .*camera\.json, got 192x120"):
        read(root)
