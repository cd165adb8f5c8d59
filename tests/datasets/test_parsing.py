"""Tables and lists that are hostile or damaged: each is refused by file and line."""

import json

import pytest

from ffpose._internal.entries import read_object
from ffpose.datasets import read_conditions, read_records
from ffpose.datasets.parsing import read_list, read_rows, read_table
from ffpose.errors import DataError
from ffpose.geometry import Camera

DEEP = "[" * 100_000 + "]" * 100_000
DIGITS = "9" * 5000
LARGE = "1" + "0" * 400
"""An integer that Python reads, and that no float holds."""


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (DEEP, "expected JSON of few levels, got too many"),
        (DIGITS, "expected numbers of few digits: .*.*5000 digits"),
    ],
    ids=["deep", "digits"],
)
def test_json_that_python_cannot_decode_is_named(tmp_path, value, words):
    path = tmp_path / "train.json"
    path.write_text(f'[\n{{"x": 1}},\n{{"x": {value}}}\n]')
    with pytest.raises(DataError, match=rf"train\.json:3: {words}"):
        read_list(path)
    path.write_text(f'{{"x": {value}}}')
    for read in (read_object, Camera.read):
        with pytest.raises(DataError, match=rf"train\.json(:1)?: {words}"):
            read(path)


def test_an_integer_that_no_float_holds_is_named(tmp_path):
    path = tmp_path / "train.json"
    path.write_text(f'[\n{{"x": {LARGE}, "r": [1, {LARGE}]}}\n]')
    (entry,) = read_list(path)
    for key, read in (("x", entry.number), ("r", lambda key: entry.numbers(key, 2))):
        with pytest.raises(
            DataError, match=rf"train\.json:2: {key}: expected a finite number, got"
        ):
            read(key)


@pytest.mark.parametrize("name", ["fx", "cy", "distortion"])
def test_a_camera_that_no_float_holds_is_named(tmp_path, name):
    values = {"width": 64, "height": 48, "fx": 50.0, "fy": 51.0, "cx": 30.5, "cy": 25.0}
    wrong = [0, int(LARGE), 0, 0, 0] if name == "distortion" else int(LARGE)
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(values | {name: wrong}))
    with pytest.raises(DataError, match=rf"camera\.json: {name}: expected a finite number"):
        Camera.read(path)


def test_blank_lines_may_end_a_table_and_not_interrupt_it(tmp_path):
    path = tmp_path / "train.csv"
    path.write_text("image,tx\r\na.png,1\r\n\r\n  \n")
    (entry,) = read_table(path, ("image", "tx"))
    assert entry.values == {"image": "a.png", "tx": "1"}
    path.write_text("image,tx\n\na.png,1\n")
    with pytest.raises(DataError, match=r"train\.csv:2: expected 2 fields, got 0"):
        read_table(path, ("image", "tx"))


@pytest.mark.parametrize(
    ("header", "others", "accepted"),
    [
        ("b,a", False, True),
        ("a,b,d,c", False, True),  # a group is there, or is not
        ("a,b,c", False, False),
        ("a,b,e", False, True),
        ("a,c,d", False, False),
        ("a,b,f", False, False),
        ("a,b,f", True, True),
        ("a,f", True, False),
    ],
)
def test_columns_stand_in_any_order_and_groups_of_them_may_be_missing(
    tmp_path, header, others, accepted
):
    path = tmp_path / "train.csv"
    path.write_text(f"{header}\n{header}\n")
    if accepted:
        (entry,) = read_table(path, ("a", "b"), ("c", "d"), ("e",), others=others)
        assert entry.values == {name: name for name in header.split(",")}
        return
    with pytest.raises(
        DataError, match=r"\.csv:1: expected the columns a, b, and perhaps c, d, and"
    ):
        read_table(path, ("a", "b"), ("c", "d"), ("e",), others=others)


def test_a_long_value_is_not_repeated_whole(tmp_path):
    path = tmp_path / "train.json"
    path.write_text(json.dumps([{"x": "a" * 100_000}]))
    with pytest.raises(DataError, match=r"got 'aaa.*\.\.\..*'$") as caught:
        read_list(path)[0].number("x")
    assert len(caught.value.message) < 200


BROKEN = {
    "open": ('a/0.png,"1\nb/0.png,2\n', 2),
    "line break": ('b/0.png,2\n"a/\n0.png",1\n', 3),
    "closed within": ('b/0.png,2\nc/0.png,3\n"a/0"x.png,1\n', 4),
    "long": (f"{'a' * 131_073},1\n", 2),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_row_that_is_no_csv_is_named_by_its_line(tmp_path, case):
    text, line = BROKEN[case]
    path = tmp_path / "train.csv"
    path.write_text("image,tx\n" + text)
    with pytest.raises(DataError, match=rf"train\.csv:{line}: expected a row of CSV in one line"):
        read_table(path, ("image", "tx"))


def test_quoted_fields_are_read_without_their_quotes(tmp_path):
    path = tmp_path / "train.csv"
    path.write_bytes(b'image,"tx"\r\n"a,""b"".png",1\r\n')
    assert list(read_rows(path)) == [(1, ["image", "tx"]), (2, ['a,"b".png', "1"])]


def test_labels_of_urso_and_conditions_are_read_alike(tmp_path):
    (tmp_path / "train_images.csv").write_text("0_rgb.png\n1_rgb.png\n")
    row = "0,0,10,0,0,0,1\n"
    (tmp_path / "train_poses_gt.csv").write_text(f'x,y,z,q1,q2,q3,q4\n{row}"{row}')
    with pytest.raises(DataError, match=r"train_poses_gt\.csv:3: expected a row of CSV"):
        read_records("urso", tmp_path, "train")
    names = "image,eclipsed,sun_angle_deg,earth_behind,visible_share\n"
    (tmp_path / "conditions.csv").write_text(f'{names}0_rgb.png,0,9,0,"1\n1_rgb.png,0,9,0,1\n')
    with pytest.raises(DataError, match=r"conditions\.csv:2: expected a row of CSV"):
        read_conditions(tmp_path, ["0_rgb.png"])
