"""The format of URSO; that its labels convert rightly is tested with `ffpose.geometry.Pose`."""

import pytest

from ffpose._internal import urso


def test_names_of_images_are_numbers():
    assert urso.image_name(12) == "12_rgb.png"
    assert [urso.index_of(urso.image_name(index)) for index in (0, 7, 12_345)] == [0, 7, 12_345]


@pytest.mark.parametrize(
    "name", ["gt.csv", "1_mask.png", "x1_rgb.png", "1_rgb.png.part", "-1_rgb.png"]
)
def test_other_names_are_no_images(name):
    assert urso.index_of(name) is None


def test_a_label_there_and_back():
    label = (2.0, 1.0, 10.0, 0.1, -0.5, 0.5, -0.7)
    t, q = urso.from_label(*label)
    assert (t, q) == ((2.0, -1.0, 10.0), (-0.7, 0.1, 0.5, 0.5))  # t = M t, q = (q4, q1, -q2, q3)
    assert urso.to_label(t, q) == label
