"""The URSO reader on a set made by hand, and on everything that can be wrong with one."""

import json
import re
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from ffpose.datasets import list_splits, open_dataset
from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA, Camera, Pose
from ffpose.imaging.preprocessing import Preprocessing
from urso_sets import PIXELS, POSES, SPLITS, table, write_set

PREPROCESSING = Preprocessing(size=(24, 32))


def read(root, split="train", **options):
    return open_dataset("urso", root, split, PREPROCESSING, **options)


@pytest.mark.parametrize("images", ["images", ""])
@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_labels_are_those_worked_out_by_hand(tmp_path, images, split):
    dataset = read(write_set(tmp_path, images), split)
    assert dataset.names == SPLITS[split]
    np.testing.assert_allclose(
        dataset.poses, [POSES[name] for name in dataset.names], rtol=0, atol=1e-15
    )


def test_the_origin_shows_where_the_label_says(tmp_path):
    write_set(tmp_path)
    for split in SPLITS:
        dataset = read(tmp_path, split)
        for index, name in enumerate(dataset.names):
            pose = Pose.from_vector(dataset.poses[index])
            column, row = np.floor(pose.project([0, 0, 0], dataset.camera)).astype(int)
            assert (column, row) == PIXELS[name]
            assert dataset.load_image(index).getpixel((column, row)) == (250, 200, 150)


def test_images_become_rgb_and_transparency_is_dropped(tmp_path):
    dataset = read(write_set(tmp_path))
    for index in range(len(dataset)):
        image = dataset.load_image(index)
        assert (image.mode, image.size) == ("RGB", (64, 48))
        assert image.getpixel((0, 0)) == (20, 20, 20)


def test_a_quaternion_and_its_negative_are_one_label(tmp_path):
    write_set(tmp_path)
    lines = (tmp_path / "gt.csv").read_text().splitlines()
    places = [lines[0].split(",").index(name) for name in lines[0].split(",") if "q" in name]
    assert len(places) == 4

    def negated(line):
        fields = line.split(",")
        for place in places:
            fields[place] = repr(-float(fields[place]))
        return ",".join(fields)

    (tmp_path / "gt.csv").write_text("\n".join([lines[0], *map(negated, lines[1:])]) + "\n")
    dataset = read(tmp_path)
    expected = [POSES[name] for name in dataset.names]
    np.testing.assert_allclose(dataset.poses, expected, rtol=0, atol=1e-15)


def test_splits_are_those_whose_lists_are_there(tmp_path):
    write_set(tmp_path)
    assert list_splits("urso", tmp_path) == ["train", "val", "test"]
    (tmp_path / "val_images.csv").unlink()
    assert list_splits("urso", tmp_path) == ["train", "test"]


def test_a_folder_without_splits_and_a_file_are_no_set(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"expected one of train_images\.csv, .* got none"):
        list_splits("urso", tmp_path)
    (tmp_path / "gt.csv").write_text("")
    for call in (list_splits, lambda *place: open_dataset(*place, "train", PREPROCESSING)):
        with pytest.raises(NotADirectoryError, match=r"expected a folder, got the file .*gt\.csv"):
            call("urso", tmp_path / "gt.csv")


def test_the_camera_is_ursos_at_the_size_of_the_images(tmp_path):
    dataset = read(write_set(tmp_path))
    assert dataset.camera == URSO_CAMERA.resized(64, 48)
    assert dataset.camera.fy == pytest.approx(640.463 / 20)


def test_a_camera_file_goes_first(tmp_path):
    camera = {"width": 64, "height": 48, "fx": 50.0, "fy": 51, "cx": 30.5, "cy": 25.0}
    write_set(tmp_path)
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    assert read(tmp_path).camera == Camera(**camera)


def test_other_shapes_need_a_camera_file(tmp_path):
    write_set(tmp_path)
    Image.new("RGB", (64, 64)).save(tmp_path / "images" / "2_rgb.png")
    with pytest.raises(DataError, match=r"train_images.csv:1: .*camera\.json, got 64x64"):
        read(tmp_path)


def replace(root, file, old, new):
    text = (root / file).read_text()
    assert old in text
    (root / file).write_text(text.replace(old, new, 1))


POSES_FILE, NAMES_FILE = "train_poses_gt.csv", "train_images.csv"
# The table of train is the header, then the row of 2_rgb.png, then that of 0_rgb.png.
BROKEN = {
    "column": (POSES_FILE, "q4", "qw", f"{POSES_FILE}:1: expected the columns x, y, z, q1"),
    "column twice": (POSES_FILE, "q4", "q1", f"{POSES_FILE}:1: expected a header of distinct"),
    "NaN": (POSES_FILE, "0,20", "nan,20", f"{POSES_FILE}:2: .*expected a finite"),
    "infinite": (POSES_FILE, "-0.7,10", "-0.7,inf", f"{POSES_FILE}:3: .*expected a finite"),
    "no number": (POSES_FILE, "-0.7,10", "-0.7,ten", f"{POSES_FILE}:3: .*'ten'"),
    "zero quaternion": (POSES_FILE, "0,20,0,0,-1", "0,20,0,0,0", f"{POSES_FILE}:2: .*norm 1"),
    "norm": (POSES_FILE, "0,20,0,0,-1", "0,20,0,0,-1.1", f"{POSES_FILE}:2: .*norm 1 .*1.1"),
    "short row": (POSES_FILE, "0,20,0,", "0,20,", f"{POSES_FILE}:2: expected 7 fields, got 6"),
    "row too many": (POSES_FILE, "\n0,20", "\n0,20,0,0,-1,4,0\n0,20", f"{POSES_FILE}: expected 2"),
    "empty row": (POSES_FILE, "\n0,20", "\n\n0,20", f"{POSES_FILE}:2: expected 7 fields, got 0"),
    "no rows": (POSES_FILE, table(SPLITS["train"]), table([]), f"{POSES_FILE}: expected at least"),
    "empty file": (POSES_FILE, table(SPLITS["train"]), "", f"{POSES_FILE}:1: expected a header"),
    "no image": (NAMES_FILE, "0_rgb", "7_rgb", "gt.csv: expected a row for 7_rgb.png"),
    "duplicate": (NAMES_FILE, "0_rgb", "2_rgb", f"{NAMES_FILE}:2: 2_rgb.png is on line 1"),
    "empty name": (NAMES_FILE, "0_rgb.png", "\n0_rgb.png", f"{NAMES_FILE}:2: expected the name"),
    "path": (NAMES_FILE, "0_rgb", "../0_rgb", f"{NAMES_FILE}:2: expected the name"),
    "no names": (NAMES_FILE, "2_rgb.png\n0_rgb.png\n", "", f"{NAMES_FILE}: expected at least one"),
    "swapped": (NAMES_FILE, "2_rgb.png\n0", "0_rgb.png\n2", f"{POSES_FILE}:2: .*do not align"),
    "label": (POSES_FILE, "0,20", "0,20.001", f"{POSES_FILE}:2: .*do not align"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_list_is_named_by_file_and_line(tmp_path, case):
    file, old, new, words = BROKEN[case]
    replace(write_set(tmp_path), file, old, new)
    with pytest.raises(DataError, match=words) as caught:
        read(tmp_path)
    assert caught.value.file.parent == tmp_path


def test_blank_lines_may_end_the_files_of_a_split(tmp_path):
    write_set(tmp_path)
    for file in (POSES_FILE, NAMES_FILE):
        (tmp_path / file).write_text((tmp_path / file).read_text() + "\n  \n")
    assert read(tmp_path).names == SPLITS["train"]


def test_a_missing_image_is_named_by_its_line(tmp_path):
    write_set(tmp_path)
    (tmp_path / "images" / "0_rgb.png").unlink()
    with pytest.raises(DataError, match=rf"{NAMES_FILE}:2: .*0_rgb\.png") as caught:
        read(tmp_path)
    assert caught.value.line == 2


def test_without_the_whole_table_the_split_files_are_enough(tmp_path):
    (write_set(tmp_path) / "gt.csv").unlink()
    assert len(read(tmp_path)) == 2


def test_digits_that_another_program_rounded_still_align(tmp_path):
    replace(write_set(tmp_path), POSES_FILE, "0,20,", "0,20.000001,")
    assert len(read(tmp_path)) == 2


def test_a_byte_order_mark_and_windows_lines_are_read(tmp_path):
    write_set(tmp_path)
    for file in (POSES_FILE, NAMES_FILE):
        text = (tmp_path / file).read_text().replace("\n", "\r\n")
        (tmp_path / file).write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read(tmp_path).names == SPLITS["train"]


@pytest.mark.parametrize("file", [".", NAMES_FILE, POSES_FILE])
def test_a_missing_list_or_folder_is_not_found(tmp_path, file):
    root = tmp_path / "set"
    if file != ".":
        (write_set(root) / file).unlink()
    with pytest.raises(FileNotFoundError, match=re.escape(str(root / file))):
        read(root)


def test_binary_labels_are_refused(tmp_path):
    (write_set(tmp_path) / NAMES_FILE).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="UTF-8"):
        read(tmp_path)


CAMERA = {"width": 64, "height": 48, "fx": 32.0, "fy": 32.0, "cx": 32.0, "cy": 24.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", r"camera\.json:1: not JSON"),
        ("[]", r"camera\.json: expected the keys width, .*; got \[\]"),
        (json.dumps(CAMERA | {"k1": 0.1}), "expected the keys .*, and distortion .*; got 'k1' too"),
        (json.dumps(CAMERA).replace("cy", "Cy"), "expected the keys .*; got none of the name cy"),
        (json.dumps(CAMERA)[:-1] + ', "fx": 9}', "expected each key once, got 'fx' twice"),
        (json.dumps(CAMERA | {"width": "64"}), "width: expected a whole number, got '64'"),
        (json.dumps(CAMERA | {"width": 64.5}), "width: expected a whole number, got 64.5"),
        (json.dumps(CAMERA | {"height": True}), "height: expected a whole number, got True"),
        (json.dumps(CAMERA | {"height": 2**53}), "height: expected less than 2⁵³, got 9007"),
        (json.dumps(CAMERA | {"distortion": 0}), "distortion: expected 5 numbers, got 0"),
        (
            json.dumps(CAMERA | {"distortion": [0.1, False, 0, 0, 0]}),
            "distortion: expected a finite number, got False",
        ),
        (json.dumps(CAMERA | {"fx": "32"}), "fx: expected a finite number, got '32'"),
        (json.dumps(CAMERA | {"fx": -1.0}), "expected fx > 0"),
        (json.dumps(CAMERA | {"fx": float("nan")}), "fx: expected a finite number, got nan"),
    ],
)
def test_a_bad_camera_file_is_named(tmp_path, text, words):
    (write_set(tmp_path) / "camera.json").write_text(text)
    with pytest.raises(DataError, match=words):
        read(tmp_path)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-40])


def no_image(path):
    path.write_text("not an image")


def other_size(path):
    Image.new("RGB", (63, 48)).save(path)


def sixteen_bits(path):
    Image.fromarray(np.zeros((48, 64), np.uint16)).save(path)


def bomb(path, side=60_000):
    """A PNG of a hundred bytes whose header declares 3.6 gigapixels."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IEND", b""))


def large(path):
    bomb(path, side=9_000)  # below Pillow's own limit


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (truncate, "cannot be read as an image"),
        (no_image, "cannot be read as an image"),
        (other_size, "expected 64x48 pixels.*got 63x48"),
        (sixteen_bits, "expected pixels of mode.*got I;16"),
        (bomb, r"expected an image of at most [0-9,]+ pixels, got [0-9,]+"),
        (large, "expected 64x48 pixels.*got 9000x9000"),
    ],
)
@pytest.mark.parametrize("cache", [False, True])
def test_a_bad_image_is_named_by_its_line(tmp_path, spoil, words, cache):
    spoil(write_set(tmp_path) / "images" / "0_rgb.png")  # the second of train
    with pytest.raises(DataError, match=rf"{NAMES_FILE}:2: .*0_rgb\.png: {words}"):
        read(tmp_path, cache=cache)[1]


def test_the_first_image_cannot_declare_the_camera_to_be_huge(tmp_path):
    bomb(write_set(tmp_path) / "images" / "2_rgb.png", side=9_000)
    with pytest.raises(DataError, match="expected at most 1280x960 pixels"):
        read(tmp_path)
