"""``conditions.csv``: read by name, and refused where it cannot be used."""

import numpy as np
import pytest

from ffpose.datasets import read_conditions
from ffpose.errors import DataError

HEADER = "image,distance_m,eclipsed,sun_angle_deg,earth_behind,visible_share"
ROWS = ["0_rgb.png,9,0,30.5,1,1.0", "1_rgb.png,12,1,120,0,0.95"]


def write(folder, *lines):
    (folder / "conditions.csv").write_text("\n".join([*lines, ""]))
    return folder


def test_rows_are_found_by_name(tmp_path):
    write(tmp_path, HEADER, *ROWS)
    found = read_conditions(tmp_path, ["1_rgb.png", "0_rgb.png", "1_rgb.png"])
    np.testing.assert_array_equal(found.eclipsed, [True, False, True])
    np.testing.assert_array_equal(found.earth_behind, [False, True, False])
    np.testing.assert_array_equal(found.sun_angle_deg, [120, 30.5, 120])
    np.testing.assert_array_equal(found.visible_share, [0.95, 1, 0.95])
    assert found.eclipsed.dtype == bool


def test_columns_stand_in_any_order(tmp_path):
    write(tmp_path, "visible_share,earth_behind,image,eclipsed,sun_angle_deg", "0.5,1,a.png,0,7")
    found = read_conditions(tmp_path, ["a.png"])
    assert [column[0] for column in found] == [0, 7, 1, 0.5]


def test_names_may_have_spaces_around_them(tmp_path):
    write(tmp_path, HEADER, f" {ROWS[0]}", ROWS[1].replace(",", " ,", 1))
    assert read_conditions(tmp_path, ["0_rgb.png", "1_rgb.png"]).eclipsed.tolist() == [False, True]


def test_a_set_without_the_file_says_nothing(tmp_path):
    assert read_conditions(tmp_path, ["0_rgb.png"]) is None


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((HEADER, ROWS[1]), r"conditions\.csv: expected a row for 0_rgb\.png, got none"),
        ((HEADER, ROWS[0], ROWS[0]), r"conditions\.csv:3: 0_rgb\.png is on line 2 already"),
        (("image,eclipsed", "0_rgb.png,0"), "expected the columns image, eclipsed, sun_angle_deg"),
        ((HEADER, "0_rgb.png,9,2,30,1,1"), r"csv:2: eclipsed: expected 0 or 1, got '2'"),
        ((HEADER, "0_rgb.png,9,0,200,1,1"), r"csv:2: sun_angle_deg: expected 0…180, got '200'"),
        ((HEADER, "0_rgb.png,9,0,nan,1,1"), "sun_angle_deg: expected a finite"),
        (
            (HEADER, "0_rgb.png,9,0,30,1,much"),
            "visible_share: expected a finite",
        ),
        ((HEADER, "0_rgb.png,9,0,30"), r"csv:2: expected 6 fields, got 4"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, lines, message):
    write(tmp_path, *lines)
    with pytest.raises(DataError, match=message):
        read_conditions(tmp_path, ["0_rgb.png"])


def test_what_is_no_text_is_named(tmp_path):
    (tmp_path / "conditions.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="expected text in UTF-8"):
        read_conditions(tmp_path, [])
