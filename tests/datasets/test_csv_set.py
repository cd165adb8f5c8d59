"""The CSV reader on a user's folder, with cameras of their own and images of 16 bits."""

import json

import numpy as np
import pytest
from PIL import Image

from ffpose.datasets import Decoding, list_splits, open_dataset, read_records
from ffpose.errors import DataError
from ffpose.imaging.preprocessing import Preprocessing

PREPROCESSING = Preprocessing(size=(24, 32))
CAMERA = {"width": 64, "height": 48, "fx": 50.0, "fy": 51.0, "cx": 30.5, "cy": 25.0}
LENS = CAMERA | {"distortion": [-0.1, 0.0, 0.0, 0.0, 0.0]}
TRAIN = """qw,qx,qy,qz,image,tx,ty,tz
-0.6,0,0.8,0,a/0.png,1,2,10
1,0,0,0,b/0.png,0,0,5
"""


@pytest.fixture
def root(tmp_path):
    for name in ("a/0.png", "b/0.png"):
        (tmp_path / name).parent.mkdir()
        Image.new("RGB", (64, 48), (9, 8, 7)).save(tmp_path / name)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    (tmp_path / "lens.json").write_text(json.dumps(LENS))
    (tmp_path / "train.csv").write_text(TRAIN)
    (tmp_path / "flight 7.csv").write_text("image\nb/0.png\n")
    return tmp_path


def read(root, split="train", **options):
    return open_dataset("csv", root, split, PREPROCESSING, **options)


def test_labels_are_in_the_conventions_of_the_package(root):
    """Pixel: u = 30.5 + 50 / 10, v = 25 + 51 * 2 / 10."""
    dataset = read(root)
    assert dataset.names == ["a/0.png", "b/0.png"]
    np.testing.assert_allclose(dataset.poses[0], [1, 2, 10, 0.6, 0, -0.8, 0], rtol=1e-15)
    pixel = dataset.records[0].pose.project([0, 0, 0], dataset.camera)
    np.testing.assert_allclose(pixel, [35.5, 35.2], rtol=1e-14)


def test_hidden_files_folders_and_keypoints_are_no_splits(root):
    (root / "._train.csv").write_text("what macOS leaves")
    (root / "points.csv").write_text("name, x, y, z\ntop, 0, 0, 1\n")
    (root / "quoted.csv").write_text('"name","x","y","z"\n"top",0,0,1\n')
    (root / "old.csv").mkdir()
    assert list_splits("csv", root) == ["train", "flight 7"]


def test_splits_are_by_name_and_those_of_a_training_first(root):
    for name in ("sun-low", "sun", "sun 2", "val"):
        (root / f"{name}.csv").write_text("image\n")
    assert list_splits("csv", root) == ["train", "val", "flight 7", "sun", "sun 2", "sun-low"]


def test_any_file_is_a_split_and_labels_may_be_missing(root):
    (root / "conditions.csv").write_text("not a split")
    assert list_splits("csv", root) == ["train", "flight 7"]
    (record,) = read_records("csv", root, "flight 7")
    assert record.pose is None
    with pytest.raises(DataError, match=r"flight 7\.csv:2: .*expected a label"):
        read(root, "flight 7")


def test_all_splits_together_have_each_image_once(root):
    """Else it would count twice, or be trained on and held out."""
    lines = (root / "train.csv").read_text().splitlines()
    (root / "again.csv").write_text("\n".join(lines[:2]) + "\n")
    assert len(read(root, "again")) == 1
    with pytest.raises(DataError, match=r"again\.csv:2: .*a/0\.png in train and again"):
        read(root, "all")


def test_each_image_may_have_a_camera_of_its_own(root):
    text = TRAIN.replace("tz\n", "tz,camera\n").replace("10\n", "10,camera.json\n")
    (root / "train.csv").write_text(text.replace(",5\n", ",5,lens.json\n"))
    dataset = read(root)
    assert dataset.camera is None
    assert dataset.image_size == (48, 64)
    plain, lens = (record.camera for record in dataset.records)
    np.testing.assert_allclose(plain.project([2.0, 0.0, 2.0]), [80.5, 25])
    np.testing.assert_allclose(lens.project([2.0, 0.0, 2.0]), [30.5 + 50 * 0.9, 25])
    assert dataset[1].image.shape == (3, 24, 32)
    assert read(root, decoding=Decoding(undistort=True)).camera == plain


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("qw,", "w,", r":1: expected the columns image, and perhaps tx, .*, got w, qx"),
        ("tx,ty", "tx,tx", r":1: expected a header of distinct columns"),
        (TRAIN, "", r":1: expected a header of distinct columns, got \[\]"),
        (TRAIN, TRAIN.splitlines()[0] + "\n", r": expected at least one row, got none"),
        (",1,2,10", ",1,2", r":2: expected 8 fields, got 7"),
        (",1,2,10", ",1,nan,10", r":2: ty: expected a finite number, got 'nan'"),
        (",1,2,10", ",1,,10", r":2: ty: expected a finite number, got ''"),
        ("-0.6,0,0.8,0", "0,0,0,0", r":2: quaternion: expected norm 1"),
        ("-0.6,0,0.8,0", "-0.6,0,0.9,0", r":2: quaternion: expected norm 1"),
        ("b/0.png", "a/0.png", r":3: a/0\.png is on line 2 already"),
        ("b/0.png", "./a//0.png", r":3: a/0\.png is on line 2 already"),
        ("b/0.png", "b/1.png", r":3: expected the image .*1\.png, got no such file"),
        ("b/0.png", "/etc/hosts", r":3: expected the path of an image within"),
        ("b/0.png", "", r":3: image: expected a name, got ''"),
    ],
)
def test_a_broken_table_is_named_by_file_and_line(root, old, new, words):
    assert old in TRAIN
    (root / "train.csv").write_text(TRAIN.replace(old, new, 1))
    with pytest.raises(DataError, match=r"train\.csv" + words):
        read(root)


def test_a_missing_camera_is_named(root):
    (root / "camera.json").unlink()
    with pytest.raises(DataError, match=r"\.csv:2: expected .*camera\.json, the camera of all"):
        read(root)


@pytest.mark.parametrize("distortion", [[0.1], None, [0, 0, 0, 0, "x"], {"k1": 0.1}])
def test_bad_distortion_is_named(root, distortion):
    (root / "camera.json").write_text(json.dumps(CAMERA | {"distortion": distortion}))
    with pytest.raises(DataError, match=r"camera\.json: distortion: expected"):
        read(root)


def test_levels_of_sixteen_bits_are_scaled_by_the_stated_white(root):
    """Of 12 bits, white 4095: 1365 is a third, 85; 2047.5 would be 127.5; 5000 is saturated."""
    levels = np.zeros((48, 64), np.uint16)
    levels[0, :4] = 1365, 4095, 5000, 819
    Image.fromarray(levels).save(root / "a/0.png")
    with pytest.raises(DataError, match=r"train\.csv:2: .*\(--data\.white\), got I;16"):
        read(root)[0]
    image = read(root, decoding=Decoding(white=4095)).load_image(0)
    assert [image.getpixel((column, 0)) for column in range(5)] == [
        (level,) * 3 for level in (85, 255, 255, 51, 0)
    ]


def test_levels_of_sixteen_bits_are_scaled_by_a_percentile_of_their_image(root):
    """The levels are 1 to 3072: their median is 1536.5, their 99th percentile 3041.29."""
    levels = np.arange(1, 48 * 64 + 1, dtype=np.uint16).reshape(48, 64)
    Image.fromarray(levels).save(root / "a/0.png")
    for white, level in (("p50", 1536.5), ("p99", 3041.29), ("p100", 3072), ("p0.1", 4.071)):
        image = read(root, decoding=Decoding(white=white)).load_image(0)
        expected = np.rint(np.minimum(levels / level, 1) * 255)
        np.testing.assert_array_equal(np.asarray(image)[..., 0], expected)
    dark = np.zeros((48, 64), np.uint16)
    dark[0, 0] = 9
    Image.fromarray(dark).save(root / "a/0.png")
    with pytest.raises(DataError, match=r"\.csv:2: .*above 0 at percentile p50, got 0"):
        read(root, decoding=Decoding(white="p50")).load_image(0)


def test_a_white_level_is_for_images_of_more_than_eight_bits(root):
    with pytest.raises(DataError, match=r"\.csv:2: .*for which a white level is stated, got RGB"):
        read(root, decoding=Decoding(white=4095))[0]
    for level in (0, -1, float("nan"), float("inf"), "p0", "p101", "99", "p1e1", "pnan"):
        with pytest.raises(ValueError, match="white: expected a positive level"):
            Decoding(white=level)


def test_other_splits_and_folders_are_refused(root):
    with pytest.raises(ValueError, match=r"expected one of \('train', 'flight 7', 'all'\)"):
        read(root, "val")
    with pytest.raises(FileNotFoundError, match=r"expected a file such as train\.csv"):
        list_splits("csv", root / "a")
