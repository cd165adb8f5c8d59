"""Keypoints of an object: the points as written, and what is wrong with a file, by line."""

import numpy as np
import pytest

from ffpose import DataError
from ffpose.datasets.csv_set import read_keypoints


def written(folder, *lines):
    path = folder / "points.csv"
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def test_points_come_in_the_order_of_the_rows_whatever_that_of_the_columns(tmp_path):
    path = written(tmp_path, "z, name,x,y", "3,tip,1,2", "-1e-1,foot,0,0.5")
    np.testing.assert_array_equal(read_keypoints(path), [[1, 2, 3], [0, 0.5, -0.1]])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["name,x,y,z"], "expected at least one row"),
        (["name,x,y", "tip,1,2"], r":1: expected the columns name, x, y, z, got name, x, y"),
        (["name,x,y,z", "tip,1,2,3", "tip,1,2,3"], ":3: tip is on line 2 already"),
        (["name,x,y,z", "tip,1,2,nan"], ":2: z: expected a finite number, got 'nan'"),
        (["name,x,y,z", "tip,1,2"], ":2: expected 4 fields, got 3"),
        (["name,x,y,z", ",1,2,3"], ":2: name: expected a name"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(tmp_path, lines, message):
    with pytest.raises(DataError, match=message):
        read_keypoints(written(tmp_path, *lines))
