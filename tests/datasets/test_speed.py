"""The SPEED reader on a set made by hand, and on what can be wrong with one."""

import json

import numpy as np
import pytest
from PIL import Image

from ffpose.datasets import list_splits, open_dataset, read_records
from ffpose.errors import DataError
from ffpose.geometry import Pose
from ffpose.imaging.preprocessing import Preprocessing

PREPROCESSING = Preprocessing(size=(24, 32))
HALF = 0.5**0.5

TRAIN = [
    {
        "filename": "img000002.jpg",
        "q_vbs2tango": [-0.5, 0.5, -0.5, 0.5],
        "r_Vo2To_vbs_true": [0.1, -0.2, 10],
    },
    {
        "filename": "img000001.jpg",
        "q_vbs2tango": [HALF, 0.0, 0.0, HALF],
        "r_Vo2To_vbs_true": [0.0, 0.0, 5.0],
    },
]
TEST = [{"filename": "img000001.jpg"}]
REAL = [
    {"filename": "img000001real.jpg", "q_vbs2tango": [1, 0, 0, 0], "r_Vo2To_vbs_true": [0, 0, 3.0]}
]


def write(path, entries):
    """One object a line, as an editor would; the first line is the bracket."""
    path.write_text("[\n" + ",\n".join(map(json.dumps, entries)) + "\n]\n")


@pytest.fixture
def root(tmp_path):
    for split, entries in {"train": TRAIN, "test": TEST, "real": REAL}.items():
        write(tmp_path / f"{split}.json", entries)
        folder = tmp_path / "images" / split
        folder.mkdir(parents=True)
        for entry in entries:
            Image.new("L", (1920, 1200), 30).save(folder / entry["filename"])
    return tmp_path


def read(root, split="train"):
    return open_dataset("speed", root, split, PREPROCESSING)


def test_the_origin_is_projected_where_the_intrinsics_say(root):
    """Pixel: u = 960 + 3003.413 * 0.01, v = 600 - 3003.413 * 0.02."""
    record = read(root).records[0]
    pixel = record.pose.project([0, 0, 0], record.camera)
    np.testing.assert_allclose(pixel, [990.03413, 539.93174], atol=1e-9)


def test_a_point_of_the_object_turns_by_the_quaternion(root):
    """A quarter turn about z takes (1, 0, 0) to (0, 1, 0), at 5 m: v = 600 + 3003.413 / 5."""
    record = read(root).records[1]
    pixel = record.pose.project([1.0, 0.0, 0.0], record.camera)
    np.testing.assert_allclose(pixel, [960, 1200.6826], atol=1e-9)


def test_labels_are_canonical_and_raw_quaternions_as_in_the_file(root):
    dataset = read(root)
    np.testing.assert_allclose(dataset.poses[0], [0.1, -0.2, 10, 0.5, -0.5, 0.5, -0.5], rtol=1e-15)
    assert dataset.records[0].raw_quaternion == (-0.5, 0.5, -0.5, 0.5)
    assert dataset[0].image.shape == (3, 24, 32)


def test_names_are_paths_as_files_repeat_across_splits(root):
    names = [record.name for record in read_records("speed", root, "all")]
    assert names == [
        *("train/img000002.jpg", "train/img000001.jpg"),
        *("test/img000001.jpg", "real/img000001real.jpg"),
    ]


def test_splits_without_labels_are_read_but_not_opened_as_labeled(root):
    assert list_splits("speed", root) == ["train", "test", "real"]
    (record,) = read_records("speed", root, "test")
    assert record.pose is None
    with pytest.raises(DataError, match=r"test\.json:2: .*expected a label, got .*without labels"):
        read(root, "test")


def broken(index=1, **changes):
    """The list of train with changes to one entry; None takes a key away."""
    entries = [dict(entry) for entry in TRAIN]
    entries[index] |= changes
    entries[index] = {key: value for key, value in entries[index].items() if value is not None}
    return entries


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (broken(q_vbs2tango=None), r":3: expected the key q_vbs2tango"),
        (broken(r_Vo2To_vbs_true=None), r":3: expected the key r_Vo2To_vbs_true"),
        (broken(q_vbs2tango=None, r_Vo2To_vbs_true=None), r":3: expected a label as the first"),
        (broken(q_vbs2tango=[1, 0, 0]), r":3: q_vbs2tango: expected 4 numbers, got \[1, 0, 0\]"),
        (broken(q_vbs2tango=[0, 0, 0, 0]), r":3: quaternion: expected norm 1"),
        (broken(r_Vo2To_vbs_true=[0, 0, float("nan")]), r":3: .*expected a finite number, got nan"),
        (broken(r_Vo2To_vbs_true=[0, 0, "5"]), r":3: .*expected a finite number, got '5'"),
        (broken(r_Vo2To_vbs_true=[0, 0, True]), r":3: .*expected a finite number, got True"),
        (broken(filename=None), r":3: expected the key filename"),
        (broken(filename=""), r":3: filename: expected a name"),
        (broken(filename="../img000001.jpg"), r":3: expected the path of an image within"),
        (broken(filename="img000002.jpg"), r":3: train/img000002\.jpg is on line 2 already"),
        (broken(filename="img000009.jpg"), r":3: expected the image .*img000009\.jpg"),
    ],
)
def test_a_broken_entry_is_named_by_file_and_line(root, entries, words):
    write(root / "train.json", entries)
    with pytest.raises(DataError, match=r"train\.json" + words):
        read(root)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ":1: expected a list of objects"),
        ("{}", ":1: expected a list of objects"),
        ("[]", ": expected at least one image"),
        ("[\n1]", ":2: expected an object, got 1"),
        ('[\n{"filename": "a", "filename": "b"}]', ":2: .*each key once, got 'filename' twice"),
        ('[\n{"filename": "a"}', ":2: not JSON: Expecting ',' delimiter"),
        ('[\n{"filename": "a"},', ":2: not JSON: Expecting value"),
        ('[{"filename": "a"},\n]', ":[12]: not JSON"),
        ('[{"filename": "a"}\n{"filename": "b"}]', ":2: not JSON: Expecting ',' delimiter"),
        ('[\n{"filename": "a", }]', ":2: not JSON"),
        ('[{"filename": "a"}] x', ":1: not JSON: Extra data"),
    ],
)
def test_what_is_no_list_of_objects_is_named(root, text, words):
    (root / "train.json").write_text(text)
    with pytest.raises(DataError, match=r"train\.json" + words):
        read(root)


def test_truncated_and_other_images_are_named_by_their_line(root):
    path = root / "images" / "train" / "img000001.jpg"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(DataError, match=r"train\.json:3: .*img000001\.jpg: cannot be read"):
        read(root)[1]
    Image.new("L", (1920, 1080)).save(path)
    with pytest.raises(DataError, match=r"train\.json:3: .*expected 1920x1200 pixels.*1920x1080"):
        read(root)[1]


def test_unknown_splits_and_folders_without_lists_are_refused(root, tmp_path):
    with pytest.raises(ValueError, match=r"expected one of \('train', 'test', 'real', 'real_test'"):
        read(root, "val")
    with pytest.raises(FileNotFoundError, match=r"real_test\.json, got no such file"):
        read(root, "real_test")
    with pytest.raises(FileNotFoundError, match=r"expected one of train\.json, .*got none"):
        list_splits("speed", root / "images")
    with pytest.raises(FileNotFoundError, match="got no such file or folder"):
        list_splits("speed", root / "none")


def test_real_images_have_the_same_camera(root):
    real = read(root, "real")
    assert real.camera == read(root).camera
    assert real.records[0].pose == Pose([0, 0, 3], [1, 0, 0, 0])
