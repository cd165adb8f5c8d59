"""Files that trimesh reads as something else are refused, or read as they are meant."""

import codecs

import numpy as np
import pytest

from ffpose.errors import DataError
from ffpose.render import load_craft

POINTS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
TETRAHEDRON = POINTS + FACES


def corners(path):
    mesh = load_craft(path).mesh
    return mesh.vertices[mesh.faces]


def shape(folder, name, content):
    """Return the corners (F, 3, 3) of a file of this content."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return corners(path)


def refused(folder, name, content):
    """Return line and text of the error that a file of this content is."""
    with pytest.raises(DataError) as caught:
        shape(folder, name, content)
    assert caught.value.file == folder / name
    return caught.value.line, caught.value.message


@pytest.mark.parametrize("mark", [codecs.BOM_UTF8, codecs.BOM_UTF16_LE])
def test_a_byte_order_mark_hides_no_vertex(tmp_path, mark):
    code = "utf-8" if mark == codecs.BOM_UTF8 else "utf-16-le"
    # With a vertex to spare at the end, no face would notice that the first one is missing.
    text = TETRAHEDRON.replace("f", "v 9 9 9\nf", 1)
    plain = shape(tmp_path, "plain.obj", TETRAHEDRON)
    np.testing.assert_array_equal(shape(tmp_path, "mark.obj", mark + text.encode(code)), plain)


def test_a_byte_order_mark_hides_no_material(tmp_path):
    materials = b"newmtl red\nKd 1 0 0\n"
    (tmp_path / "paint.mtl").write_bytes(codecs.BOM_UTF8 + materials)
    path = tmp_path / "painted.obj"
    path.write_text(f"mtllib paint.mtl\n{POINTS}usemtl red\n{FACES}")
    assert load_craft(path).materials[0].color == (1, 0, 0)


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 0 1 2", "expected one of 4 vertices, counted from 1, got 0"),
        ("f 1 2 5", "expected one of 4 vertices, counted from 1, got 5"),
        ("f -1 -2 -5", "expected one of 4 vertices, counted from 1, got -5"),
        ("f 1/1 2/1 3/1", "expected one of 0 texture coordinates, counted from 1, got 1"),
        ("f 1//1 2//1 3//2", "expected one of 1 normals, counted from 1, got 2"),
        ("f 1 2", "expected at least 3 corners, got 2"),
        ("f", "expected at least 3 corners, got 0"),
        ("f 1 2 x", "expected a corner as 1, 1/1, 1//1 or 1/1/1, got 'x'"),
        ("f 1 2 /3", "expected a corner as 1, 1/1, 1//1 or 1/1/1, got '/3'"),
        ("f 1 2 3.5", "expected a corner as 1, 1/1, 1//1 or 1/1/1, got '3.5'"),
        ("f 1 2 3//1/1", "expected a corner as 1, 1/1, 1//1 or 1/1/1, got '3//1/1'"),
    ],
)
def test_faces_that_are_none_are_named(tmp_path, face, message):
    content = f"{TETRAHEDRON}vn 0 0 1\n{face}\nf 1 2 3\n"
    assert refused(tmp_path, "face.obj", content) == (10, message)


def test_lines_are_counted_with_comments_and_continuations(tmp_path):
    content = f"# in C:\\models\\\n{POINTS}f 1 \\\n2 3\nf 1 2 \\\n9\n"
    line, message = refused(tmp_path, "long.obj", content)
    assert (line, message[-5:]) == (8, "got 9")


def test_negative_numbers_count_back_from_the_face(tmp_path):
    """The specification's second example: vertices and faces by turns."""
    text = "".join(
        f"v 0 0 {z}\nv 1 0 {z}\nv 0 1 {z}\nvn 0 0 1\nf -3//-1 -2//-1 -1//-1\n" for z in (0, 1)
    )
    found = shape(tmp_path, "turns.obj", text)
    assert sorted(found[:, :, 2].mean(axis=1)) == [0, 1]
    np.testing.assert_array_equal(found[0, :, :2], [(0, 0), (1, 0), (0, 1)])


def test_unusual_spaces_and_comments_hide_nothing(tmp_path):
    plain = shape(tmp_path, "plain.obj", TETRAHEDRON)
    for name, text in {
        "tab.obj": TETRAHEDRON.replace("v ", "v\t").replace("f ", "f\t"),
        "indented.obj": TETRAHEDRON.replace("v 0 1", "  v 0 1").replace("f", " f"),
        "mac.obj": TETRAHEDRON.replace("\n", "\r"),
        "comment.obj": TETRAHEDRON.replace("f 1 2 4", "f 1 2 \\\n4 # mtllib none.mtl"),
    }.items():
        np.testing.assert_array_equal(shape(tmp_path, name, text), plain)
