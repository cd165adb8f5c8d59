"""OBJ, PLY and STL files are read as they are meant; what cannot be read is named."""

import codecs
import re
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from ffpose.errors import DataError
from ffpose.render import load_craft
from ffpose.render.spacecraft.textures import CLAMP, REPEAT

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


HOLED = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        ([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 3),
        ([(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)], 5),
        ([(0, 0), (2, 1), (0, 2), (0.5, 1)], 1.5),
        (HOLED, 12),
    ],
)
def test_a_concave_polygon_is_filled_and_nothing_beside_it(tmp_path, corners, area):
    """Whatever its first corner, and in any plane; areas are by the shoelace formula."""
    for first in range(len(corners)):
        turned = corners[first:] + corners[:first]
        for place in ("{0} {1} 5", "5 {0} {1}", "{1} 5 {0}", "{1} {0} 5"):
            text = "".join(f"v {place.format(x, y)}\n" for x, y in turned)
            text += f"f {' '.join(str(k + 1) for k in range(len(turned)))}\n"
            found = shape(tmp_path, "concave.obj", text)
            normals = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
            assert np.linalg.norm(normals.sum(axis=0)) / 2 == pytest.approx(area)
            assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(area)


def test_a_cut_polygon_keeps_texture_coordinates_at_its_corners(tmp_path):
    """An arrow's corners have their places as texture coordinates."""
    arrow = [(0, 0), (2, 1), (0, 2), (0.5, 1)]
    paint = "newmtl paint\nmap_Kd paint.png\n"
    (tmp_path / "paint.mtl").write_text(paint)
    Image.new("RGB", (2, 2)).save(tmp_path / "paint.png")
    text = "mtllib paint.mtl\nusemtl paint\n"
    text += "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in arrow) + "f 1/1 2/2 3/3 4/4\n"
    (tmp_path / "arrow.obj").write_text(text)
    mesh = load_craft(tmp_path / "arrow.obj").mesh
    places = mesh.vertices[mesh.faces][..., :2]
    np.testing.assert_allclose(mesh.layers[0] * (1, -1) + (0, 1), places, atol=1e-6)


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ("v 1,5 0 0", "expected coordinates as 1.5 -2 3e-4, got '1,5 0 0'"),
        ("v 1 -nan(ind) 0", "expected coordinates as 1.5 -2 3e-4, got '1 -nan(ind) 0'"),
        ("v 1 0", "expected 3 coordinates, got 2"),
    ],
)
def test_vertices_that_are_none_are_named(tmp_path, point, message):
    assert refused(tmp_path, "point.obj", f"{POINTS}{point} # a point\n{FACES}") == (5, message)


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


PLY = (
    "ply\nformat ascii 1.0\ncomment element none\nelement vertex 4\nproperty float x\n"
    "property float y\nproperty float z\nelement face 4\nproperty uchar mark\n"
    "property list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n7 3 0 2 1\n7 3 0 1 3\n7 3 0 3 2\n7 3 1 2 3\n"
)


def test_a_ply_text_that_is_cut_short_is_refused(tmp_path):
    assert len(shape(tmp_path, "whole.ply", PLY)) == 4
    assert len(shape(tmp_path, "last.ply", PLY.rstrip())) == 4
    cases = {
        "7 3 1 2 3\n": "expected 4 rows of face, as stated, got 3: the file is cut short",
        "7 3 0 1 3\n": "expected 4 rows of face, as stated, got 1: the file is cut short",
        "0 1 0\n": "expected 4 rows of vertex, as stated, got 2: the file is cut short",
        "end_header": "expected a head from ply to end_header, got none",
    }
    for after, message in cases.items():
        assert refused(tmp_path, "cut.ply", PLY[: PLY.index(after)])[1] == message


def test_a_short_row_of_a_ply_text_is_named(tmp_path):
    row = PLY.splitlines().index("7 3 0 3 2") + 1
    line, message = refused(tmp_path, "row.ply", PLY.replace("7 3 0 3 2", "7 3 0"))
    assert (line, message) == (row, "face: expected 3 of vertex_indices in the row, got 1")


@pytest.mark.parametrize(
    ("head", "row"),
    [
        (("uchar mark", "uchar mark"), ("7 3 0 3 2", "300 3 0.0 3.0 2e0")),
        (("uchar mark", "float quality"), ("7 3 0 3 2", "-nan(ind) 3 0 3 2")),
        (("uchar mark", "uint material_index"), ("7 3 0 3 2", "-1 3 0 3 2")),
        (("list uchar int", "list char uchar"), ("7 3 0 3 2", "7 3 0 3 2")),
    ],
)
def test_a_ply_text_has_no_widths_and_what_is_not_read_may_be_anything(tmp_path, head, row):
    text = PLY.replace(*head).replace(*row)
    np.testing.assert_array_equal(shape(tmp_path, "a.ply", text), shape(tmp_path, "b.ply", PLY))


def test_a_ply_text_has_polygons_of_any_number_of_corners(tmp_path):
    """Here 300, which the type of the count, ``uchar``, could not hold in a binary file."""
    angles = np.arange(300) * (2 * np.pi / 300)
    rows = "".join(f"{np.cos(a)} {np.sin(a)} 0\n" for a in angles)
    head = PLY[: PLY.index("0 0 0\n")].replace("vertex 4", "vertex 300").replace("face 4", "face 1")
    found = shape(tmp_path, "disk.ply", f"{head}{rows}7 300 {' '.join(map(str, range(300)))}\n")
    area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    assert area.sum() / 2 == pytest.approx(150 * np.sin(2 * np.pi / 300))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("vertex 4", "vertex -4"), "expected of vertex at least 0 rows .*, got -4 of x, y, z"),
        (("float y", "float x"), "expected of vertex .* distinct properties, got 4 of x, x, z"),
        (("ascii", "ASCII"), "expected a format of ascii, binary_little_endian, .*, got ASCII"),
        (("format ascii 1.0\n", ""), "expected a format of ascii, .*, got none"),
        (("7 3 0 3 2", "7 -3 0 3 2"), "face: expected lists of at least 0 values, got -3"),
        (("ply\n", "plx\n"), "expected a head from ply to end_header, got none"),
    ],
)
def test_a_head_of_a_ply_file_that_cannot_be_is_named(tmp_path, change, message):
    assert re.fullmatch(message, refused(tmp_path, "a.ply", PLY.replace(*change, 1))[1])


def test_a_ply_file_without_vertices_has_no_triangles(tmp_path):
    head = PLY[: PLY.index("0 0 0\n")].replace("vertex 4", "vertex 0").replace("face 4", "face 0")
    assert refused(tmp_path, "a.ply", head)[1] == "expected triangles, got none"


def binary(text, order):
    """Return the PLY text of this file in binary."""
    head, _, body = text.partition("end_header\n")
    rows = [[float(word) for word in row.split()] for row in body.splitlines()]
    kinds = [f"{order}3f" if len(row) == 3 else f"{order}BB{len(row) - 2}i" for row in rows]
    kind = "binary_big_endian" if order == ">" else "binary_little_endian"
    packed = [
        struct.pack(form, *(row if "f" in form else map(int, row)))
        for form, row in zip(kinds, rows, strict=True)
    ]
    return (head.replace("ascii", kind) + "end_header\n").encode() + b"".join(packed)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_binary_ply_has_faces_of_different_numbers_of_corners(tmp_path, order):
    """Blender writes such files; a pyramid on a square has the area of the square, and its own."""
    text = PLY.replace("vertex 4", "vertex 5").replace("face 4", "face 5")
    text = text[: text.index("0 0 0\n")] + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0.5 0.5 1\n"
    text += "7 4 0 3 2 1\n7 3 0 1 4\n7 3 1 2 4\n7 3 2 3 4\n7 3 3 0 4\n"
    content = binary(text, order)
    found = shape(tmp_path, "mixed.ply", content)
    np.testing.assert_array_equal(found, shape(tmp_path, "text.ply", text))
    area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    assert area.sum() / 2 == pytest.approx(1 + 5**0.5)
    assert "got 4: the file is cut short" in refused(tmp_path, "cut.ply", content[:-1])[1]
    assert "bytes after the head" in refused(tmp_path, "long.ply", content + b"\n\n")[1]


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
def test_a_binary_ply_that_is_cut_short_is_refused(tmp_path, share):
    content = trimesh.creation.icosphere(2).export(file_type="ply")
    assert refused(tmp_path, "cut.ply", content[: int(share * len(content))])


def stl(triangles, stated, head=b"", codes=(0, 0, 0, 0)):
    body = b"".join(
        struct.pack("<3f", 0, 0, 0) + np.float32(t).tobytes() + struct.pack("<H", code)
        for t, code in zip(triangles, codes, strict=True)
    )
    return head.ljust(80, b"\0") + struct.pack("<I", stated) + body


def test_a_binary_stl_of_another_size_is_refused(tmp_path):
    triangles = shape(tmp_path, "plain.obj", TETRAHEDRON)
    for head in (b"", b"solid by a careless program"):
        whole = stl(triangles, 4, head)
        np.testing.assert_array_equal(shape(tmp_path, "whole.stl", whole), triangles)
        for content, message in {
            whole[:-50]: "4 triangles in 284 bytes, as stated, got 3 in 234: the file is cut short",
            whole[:-1]: "4 triangles in 284 bytes, as stated, got 3 in 283: the file is cut short",
            whole + b"\n": "4 triangles in 284 bytes, as stated, got 4 in 285",
            stl(triangles, 3, head): "3 triangles in 234 bytes, as stated, got 4 in 284",
            whole[:83]: "84 bytes before the triangles, got 83",
        }.items():
            assert refused(tmp_path, "other.stl", content) == (None, f"expected {message}")


PART = b"COLOR=\xff\x00\x99\xff,MATERIAL="
RED, GREEN, BLUE, PINK, GRAY = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 0, 153), (102,) * 3
HIGH = 0x8000
SRGB = {0: 0.0, 102: 0.132868, 153: 0.318547, 255: 1.0}
"""Light of sRGB codes, by hand."""


@pytest.mark.parametrize(
    ("head", "codes", "colors"),
    [
        (b"", (31 << 10 | HIGH, 31 << 5 | HIGH, 31 | HIGH, 31), (RED, GREEN, BLUE, GRAY)),
        (b"", (0, 1, 2, 31), (GRAY,) * 4),
        (PART, (31, 31 << 5, 31 << 10, HIGH), (RED, GREEN, BLUE, PINK)),
        (PART, (31 | HIGH, 31 << 5 | HIGH, 31 << 10 | HIGH, HIGH), (RED, GREEN, BLUE, (0, 0, 0))),
        (PART, (HIGH | 31,) * 4, (RED,) * 4),
        (PART, (HIGH,) * 4, (PINK,) * 4),
        (PART, (0,) * 4, (PINK,) * 4),
        (b"COLOR=", (31, 31, 31, 31), (GRAY,) * 4),
    ],
    ids=["viscam", "neither", "magics", "meshlab", "red", "part", "head", "cut"],
)
def test_the_colors_of_binary_stl_files(tmp_path, head, codes, colors):
    triangles = shape(tmp_path, "plain.obj", TETRAHEDRON)
    (tmp_path / "colors.stl").write_bytes(stl(triangles, 4, head.rjust(80), codes))
    craft = load_craft(tmp_path / "colors.stl")
    found = np.ones(3) if craft.mesh.colors is None else craft.mesh.colors[:, 0, :3]
    expected = [[SRGB[code] for code in color] for color in colors]
    light = np.broadcast_to(found * craft.materials[0].color, (4, 3))
    np.testing.assert_allclose(light, expected, atol=1e-5)


CORNER_COLORS = (RED, BLUE, PINK, GRAY)
"""Of the vertices of `POINTS`."""


@pytest.mark.parametrize(
    ("vertex", "got"), [("vertex x 0 0", "x 0 0"), ("vertex 0 0", "0 0"), ("vertex", "")]
)
def test_coordinates_of_an_stl_text_that_are_none_are_named(tmp_path, vertex, got):
    facet = f"facet normal 0 0 1\nouter loop\n{vertex}\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    text = f"solid a\n{facet}endfacet\nendsolid a\n"
    message = refused(tmp_path, "a.stl", text)[1]
    assert message == f"expected coordinates of a vertex as 1.5 -2 3e-4, got {got!r}"


def test_a_binary_stl_file_of_no_triangles_has_none(tmp_path):
    head = b"COLOR=" + bytes([1, 2, 3, 4])
    assert (
        refused(tmp_path, "a.stl", head.ljust(80) + bytes(4))[1] == "expected triangles, got none"
    )


def obj_of_colors(most=1):
    colors = (" ".join(str(code * most / 255) for code in color) for color in CORNER_COLORS)
    lines = zip(POINTS.splitlines(), colors, strict=True)
    return "".join(f"{line} {color}\n" for line, color in lines) + FACES


def ply_of_colors(kind, most):
    head, _, rows = PLY.partition("end_header\n")
    names = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    lines = rows.splitlines()
    for number, color in enumerate(CORNER_COLORS):
        lines[number] += "".join(f" {code * most / 255:.9g}" for code in color)
    head = head.replace("property float z\n", f"property float z\n{names}")
    return "\n".join([f"{head}end_header", *lines])


TYPES = (("uchar", 255), ("int", 255), ("ushort", 65535), ("float", 1), ("float", 255))
COLORED = {f"{most}.obj": obj_of_colors(most) for most in (1, 255)}
COLORED |= {f"{kind}-{most}.ply": ply_of_colors(kind, most) for kind, most in TYPES}


@pytest.mark.parametrize(("name", "text"), COLORED.items(), ids=COLORED)
def test_vertices_have_their_colors(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    mesh = load_craft(path).mesh
    points = [[float(word) for word in line.split()[1:]] for line in POINTS.splitlines()]
    for point, color in zip(points, CORNER_COLORS, strict=True):
        its = (mesh.vertices[mesh.faces] == point).all(axis=-1)
        assert its.sum() == 3
        light = [SRGB[code] for code in color]
        np.testing.assert_allclose(mesh.colors[its, :3], [light] * 3, atol=1e-5)


@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "latin-1"])
def test_an_stl_text_is_read(tmp_path, code):
    triangles = shape(tmp_path, "plain.obj", TETRAHEDRON)
    text = "solid Körper\n"
    for triangle in triangles:
        text += "facet normal 0 0 0\nouter loop\n"
        text += "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle) + "endloop\nendfacet\n"
    content = f"{text}endsolid Körper\n".encode(code)
    np.testing.assert_array_equal(shape(tmp_path, "text.stl", content), triangles)
    assert "cut short" in refused(tmp_path, "cut.stl", content[:-20])[1]
    assert "cut short" in refused(tmp_path, "second.stl", content + content[:-20])[1]


@pytest.mark.parametrize("count", [2, 4, 6])
def test_facets_of_an_stl_text_that_are_no_triangles_are_refused(tmp_path, count):
    loop = "facet normal 0 0 1\nouter loop\n" + "vertex 0 0 1\n" * count + "endloop\nendfacet\n"
    expected = f"expected three vertices of each triangle, got {count}"
    assert refused(tmp_path, "a.stl", f"solid a\n{loop * 3}endsolid a\n") == (None, expected)


def test_vertices_of_an_stl_text_outside_a_loop_are_refused(tmp_path):
    facet = "facet normal 0 0 1\n" + "vertex 0 0 1\n" * 3 + "endfacet\n"
    expected = "expected the vertices of each triangle in an outer loop, got some outside"
    assert refused(tmp_path, "a.stl", f"solid a\n{facet}endsolid a\n") == (None, expected)


def test_faces_without_texture_coordinates_leave_the_others_theirs(tmp_path):
    Image.new("RGB", (2, 2), "red").save(tmp_path / "red.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd red.png\n")
    given = "mtllib a.mtl\n" + POINTS + "vt 0 0\nvt 1 0\nvt 0.25 0.5\nvn 0 0 1\nusemtl a\n"
    (tmp_path / "a.obj").write_text(given + "f 1/1 3/2 2/3\nf 1//1 2//1 4//1\nf 1 4 3\n")
    (layer,) = load_craft(tmp_path / "a.obj").mesh.layers
    assert layer[0].tolist() == [[0, 1], [1, 1], [0.25, 0.5]]  # from the upper left
    assert layer[1:].tolist() == [[[0, 1]] * 3] * 2


def test_a_texture_without_coordinates_is_told(tmp_path, caplog):
    Image.new("RGB", (2, 2), "red").save(tmp_path / "red.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd red.png\n")
    shape(tmp_path, "a.obj", "mtllib a.mtl\nusemtl a\n" + TETRAHEDRON)
    assert "material 'a' has a texture and no texture coordinates" in caplog.text


def test_comments_end_the_lines_of_an_obj_file(tmp_path):
    plain = shape(tmp_path, "plain.obj", TETRAHEDRON)
    text = TETRAHEDRON.replace("v 1 0 0", "v 1 0 0 # 1").replace("f 1 3 2", "f 1 3 2 # base")
    np.testing.assert_array_equal(shape(tmp_path, "told.obj", text), plain)


def test_a_mesh_without_area_is_refused(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"
    expected = "expected triangles that have an area, got 0 together"
    assert refused(tmp_path, "line.obj", text) == (None, expected)


def test_a_type_that_ply_files_do_not_have_is_named(tmp_path):
    text = "ply\nformat ascii 1.0\nelement vertex 0\nproperty int64 x\nend_header\n"
    assert refused(tmp_path, "a.ply", text) == (None, "expected a type of PLY files, got int64")


def test_vertices_that_no_face_uses_move_nothing(tmp_path):
    (tmp_path / "plain.obj").write_text(TETRAHEDRON)
    shifted = "v 90 0 0\n" + POINTS + "f 2 4 3\nf 2 3 5\nf 2 5 4\nf 3 4 5\n"
    (tmp_path / "stray.obj").write_text(shifted)
    plain, stray = (load_craft(tmp_path / f"{n}.obj", center=True) for n in ("plain", "stray"))
    np.testing.assert_array_equal(stray.mesh.vertices, plain.mesh.vertices)
    assert stray.radius == plain.radius


def test_textures_are_found_beside_their_mtl_file_and_behind_options(tmp_path, caplog):
    (tmp_path / "paint").mkdir()
    Image.new("RGB", (4, 2), "red").save(tmp_path / "paint" / "solar panel.png")
    Image.new("RGB", (2, 2), "red").save(tmp_path / "panel.png")
    line = "newmtl a\nmap_Kd -s 2 -0.5 1 -clamp on -blendu off -colorspace sRGB solar panel.png\n"
    (tmp_path / "paint" / "a.mtl").write_text(line)
    text = "mtllib paint/a.mtl\n" + POINTS + "vt 0 0\nusemtl a\nf 1/1 3/1 2/1\nf 1/1 2/1 4/1\n"
    (tmp_path / "a.obj").write_text(text)
    image = load_craft(tmp_path / "a.obj").materials[0].color_map.image
    assert (image.width, image.height) == (4, 2)
    left_out = "-blendu off -colorspace sRGB"
    assert f"a.obj: options of a texture are left out: {left_out}\n" in caplog.text


def test_options_of_textures_scale_move_and_clamp_them(tmp_path):
    """As other readers take them: coordinates times -s plus -o."""
    for name in ("a.png", "n.png"):
        Image.new("RGB", (4, 4), "white").save(tmp_path / name)
    lines = "newmtl a\nmap_Kd -s 2 -0.5 1 -o 0.25 a.png\nnorm -bm 0.5 -clamp on n.png\n"
    (tmp_path / "a.mtl").write_text(lines)
    text = "mtllib a.mtl\n" + POINTS + "vt 0.5 0.5\nvt 1 0\nvt 0 1\nusemtl a\n"
    (tmp_path / "a.obj").write_text(text + "f 1/1 3/2 2/3\n")
    craft = load_craft(tmp_path / "a.obj")
    color, normal = craft.mesh.layers
    np.testing.assert_allclose(color[0], [[1.25, 1.25], [2.25, 1], [0.25, 1.5]])
    np.testing.assert_allclose(normal[0], [[0.5, 0.5], [1, 1], [0, 0]])
    material = craft.materials[0]
    assert (material.color_map.layer, material.normal_map.layer) == (0, 1)
    assert (material.color_map.image.wrap, material.normal_map.image.wrap) == (
        (REPEAT, REPEAT),
        (CLAMP, CLAMP),
    )
    # White stands for (1, 1, 1), of which the first two are halved.
    expected = np.array([0.5, 0.5, 1, 0]) / np.sqrt(1.5)
    np.testing.assert_allclose(material.normal_map.image.level(0)[0, 0], expected, atol=1e-3)


@pytest.mark.parametrize(
    "option", ["-s r b", "-clamp 2", "-bm on", "-o off", "-s 1e39", "-bm 1e999"]
)
def test_a_value_that_its_option_does_not_have_is_refused(tmp_path, option):
    Image.new("RGB", (4, 2), "red").save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text(f"newmtl a\nmap_Kd {option} a.png\n")
    text = "mtllib a.mtl\n" + POINTS + "vt 0 0\nusemtl a\nf 1/1 3/1 2/1\n"
    key, _, values = option.partition(" ")
    expected = f"after {key} of a texture, got {values!r}"
    assert refused(tmp_path, "a.obj", text)[1].endswith(expected)


def test_coordinates_that_a_transform_makes_infinite_are_refused(tmp_path):
    Image.new("RGB", (4, 2), "red").save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd -s 3e38 1 1 a.png\n")
    text = "mtllib a.mtl\n" + POINTS + "vt 2 0\nusemtl a\nf 1/1 3/1 2/1\n"
    assert "expected finite texture coordinates" in refused(tmp_path, "a.obj", text)[1]


@pytest.mark.parametrize("binary", [False, True])
def test_polygons_of_ply_files_keep_their_colors_and_their_shape(tmp_path, binary):
    """A green square, and a red arrowhead, whose fan would fill more."""
    form = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {form} 1.0\nelement vertex 8\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 2\nproperty list uchar int vertex_indices\n"
    head += "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    points += [(2, 0, 1), (0.25, 0.25, 1), (0, 2, 1), (0, 0, 1)]
    rows = [((0, 1, 2, 3), (0, 255, 0)), ((4, 5, 6, 7), (255, 0, 0))]
    if binary:
        body = b"".join(struct.pack("<3f", *point) for point in points)
        body += b"".join(struct.pack("<B4i3B", 4, *face, *color) for face, color in rows)
    else:
        lines = [*points] + [(4, *face, *color) for face, color in rows]
        body = "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()
    path = tmp_path / "two.ply"
    path.write_bytes(head.encode() + b"end_header\n" + body)
    mesh = load_craft(path).mesh
    area = np.linalg.norm(mesh.face_normals, axis=1) / 2
    green, red = (mesh.colors[:, 0, k] == 1 for k in (1, 0))
    assert area[green].sum() == pytest.approx(1)
    assert area[red].sum() == pytest.approx(0.5)  # two triangles of base 2 and height 1/4
    assert len(area) == 4


def test_vertices_without_coordinates_are_told(tmp_path):
    path = tmp_path / "flat.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(f"{head}{faces}0 0\n1 0\n0 1\n3 0 1 2\n")
    with pytest.raises(DataError, match=r"flat\.ply: expected x, y and z .*, got none of z"):
        load_craft(path)


def colored_ply(tmp_path, faces, more="", binary=False):
    """Write four vertices of `CORNER_COLORS` with texture coordinates, and rows of faces."""
    form = "binary_little_endian" if binary else "ascii"
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
    names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat {form} 1.0\n{more}element vertex 4\n{names}"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    points = [[float(word) for word in line.split()[1:]] for line in POINTS.splitlines()]
    rows = [(*point, 0.5, 0.5, *color) for point, color in zip(points, CORNER_COLORS, strict=True)]
    if binary:
        body = b"".join(struct.pack("<5f3B", *row) for row in rows)
        body += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    else:
        lines = [*rows, *((len(face), *face) for face in faces)]
        body = "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()
    path = tmp_path / "colored.ply"
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("binary", [False, True])
def test_a_ply_file_with_texture_coordinates_and_no_texture_has_its_colors(tmp_path, binary):
    """As Blender writes one of a mesh with a UV map."""
    mesh = load_craft(colored_ply(tmp_path, [(0, 2, 1), (0, 1, 3)], binary=binary)).mesh
    found = np.unique(mesh.colors[..., :3].reshape(-1, 3).astype(float), axis=0)
    expected = sorted([SRGB[code] for code in color] for color in CORNER_COLORS)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_ply_file_of_several_textures_is_refused(tmp_path):
    names = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    with pytest.raises(DataError, match=r"of at most one texture, got 2: save it as OBJ or glTF"):
        load_craft(colored_ply(tmp_path, [(0, 2, 1)], names))


def test_a_ply_face_of_two_corners_is_left_out_with_its_color(tmp_path):
    path = tmp_path / "edge.ply"
    names = "property list uchar int vertex_indices\n"
    names += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    rows = ["0 0 0", "1 0 0", "0 1 0", "0 0 1", "2 0 1 255 0 0", "3 0 2 1 0 255 0"]
    text = f"element face 2\n{names}end_header\n" + "\n".join(rows) + "\n"
    head = "ply\nformat ascii 1.0\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(head + text)
    mesh = load_craft(path).mesh
    assert len(mesh.faces) == 1
    np.testing.assert_array_equal(mesh.colors[0, 0, :3], [0, 1, 0])


@pytest.mark.parametrize("binary", [False, True])
def test_the_corners_of_a_ply_face_are_the_list_of_that_name(tmp_path, binary):
    """Though a list of six texture coordinates stands before it."""
    form = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {form} 1.0\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 2\nproperty list uchar float texcoord\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    if binary:
        body = b"".join(struct.pack("<3f", *point) for point in points)
        body += 2 * struct.pack("<B6fB3i", 6, *[0.5] * 6, 3, 0, 2, 1)
    else:
        rows = [*points, *2 * [(6, *[0.5] * 6, 3, 0, 2, 1)]]
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    (tmp_path / "list.ply").write_bytes(head.encode() + body)
    np.testing.assert_array_equal(
        corners(tmp_path / "list.ply"), 2 * [[(0, 0, 0), (0, 1, 0), (1, 0, 0)]]
    )


def test_an_stl_solid_may_be_named_vertex(tmp_path):
    text = trimesh.creation.box().export(file_type="stl_ascii")
    plain = shape(tmp_path, "plain.stl", text)
    assert text.startswith("solid")
    named = "solid Vertex_Holder" + text[text.index("\n") :]
    np.testing.assert_array_equal(shape(tmp_path, "named.stl", named), plain)


def test_without_materials_texture_coordinates_paint_nothing(tmp_path):
    text = POINTS + "vt 0 0\nf 1/1 3/1 2/1\nf 1/1 2/1 4/1\n"
    (tmp_path / "a.obj").write_text(text)
    (material,) = load_craft(tmp_path / "a.obj").materials
    assert (material.color, material.maps) == (pytest.approx((SRGB[102],) * 3, abs=1e-5), ())


def test_vertices_have_their_colors_beside_texture_coordinates_and_others_without(tmp_path):
    """White multiplies nothing: the last vertex has no color of its own."""
    lines = obj_of_colors().splitlines()
    lines[3] = " ".join(lines[3].split()[:4])
    text = "\n".join(lines).replace("f 1 3 2", "f 1/1 3/1 2/1") + "\nvt 0 0\n"
    (tmp_path / "a.obj").write_text(text)
    craft = load_craft(tmp_path / "a.obj")
    first = craft.mesh.colors[0, :, :3] * craft.materials[0].color
    light = [[SRGB[code] for code in color] for color in (RED, PINK, BLUE)]
    np.testing.assert_allclose(first, light, atol=1e-5)
    last = craft.mesh.vertices[craft.mesh.faces] == (0, 0, 1)
    np.testing.assert_array_equal(craft.mesh.colors[last.all(axis=-1)], 1)


@pytest.mark.parametrize("lines", ["Kd 0.4 0.4 0.4\n", "map_Kd a.png\n"])
def test_a_material_with_a_color_has_it_and_not_that_of_vertices(tmp_path, lines):
    """Where both are baked into a scan, light would count twice."""
    Image.new("RGB", (2, 2), (102, 102, 102)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{lines}")
    head = "mtllib a.mtl\nvt 0 0\nusemtl a\n"
    (tmp_path / "a.obj").write_text(head + obj_of_colors().replace("f 1 3 2", "f 1/1 3/1 2/1"))
    assert load_craft(tmp_path / "a.obj").mesh.colors is None


def test_a_texture_may_be_called_by_a_number(tmp_path):
    Image.new("RGB", (2, 2), (102, 102, 102)).save(tmp_path / "#1.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd #1.png\n")
    faces = FACES.replace("f 1 3 2", "f 1/1 3/1 2/1")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nvt 0 0\nusemtl a\n{POINTS}{faces}")
    assert load_craft(tmp_path / "a.obj").materials[0].color_map is not None


@pytest.mark.parametrize("lines", ["", "\n", "# exported\n", "Ns 10\nillum 2\n", "map_Kd\nKd\n"])
def test_a_material_without_a_color_leaves_vertices_theirs(tmp_path, lines):
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{lines}")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl a\n{obj_of_colors()}")
    craft = load_craft(tmp_path / "a.obj")
    light = [[SRGB[code] for code in color] for color in (RED, PINK, BLUE)]
    first = craft.mesh.colors[0, :, :3] * craft.materials[0].color
    np.testing.assert_allclose(first, light, atol=1e-5)


def test_parts_without_colors_stay_gray_beside_one_with(tmp_path):
    plain = "".join(f"v 9 {line[2:]}\n" for line in ("v 0 0", "v 1 0", "v 0 1"))
    text = f"usemtl colored\n{obj_of_colors()}{plain}usemtl plain\nf 5 6 7\n"
    (tmp_path / "a.obj").write_text(text)
    craft = load_craft(tmp_path / "a.obj")
    colors = {m.color[0] for m in craft.materials}
    assert sorted(colors) == [pytest.approx(SRGB[102], abs=1e-5), 1.0]


def test_faces_without_normals_leave_the_others_theirs(tmp_path):
    """A normal that is no number, as old programs write, is none."""
    text = POINTS + "vn 0 0.6 0.8\nvn -nan(ind) 0 0\nf 1//1 3//1 2//1\nf 1 2 4\nf 1//2 4//2 3//2\n"
    (tmp_path / "a.obj").write_text(text)
    normals = load_craft(tmp_path / "a.obj").mesh.normals
    np.testing.assert_allclose(normals[0], [(0, 0.6, 0.8)] * 3, atol=1e-6)
    assert np.isnan(normals[1:]).all()


def test_a_material_without_a_name_is_that_of_faces_that_name_none(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{POINTS}usemtl\n{FACES}")
    assert load_craft(tmp_path / "a.obj").materials[0].color == (1, 0, 0)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Kd red", "material 'a': expected one number or three after kd, got 'red'"),
        ("Kd 0.5 0.5", "material 'a': expected one number or three after kd, got '0.5 0.5'"),
        ("Ns nan", "material 'a': expected one number or three after ns, got 'nan'"),
        ("Ke 1e999 0 0", "material 'a': expected one number or three after ke, got '1e999 0 0'"),
    ],
)
def test_numbers_of_materials_that_are_none_are_named(tmp_path, line, message):
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{line}\n")
    assert refused(tmp_path, "a.obj", f"mtllib a.mtl\n{POINTS}usemtl a\n{FACES}")[1] == message


def test_polygons_of_a_binary_ply_are_not_taken_for_triangles_by_their_number(tmp_path):
    """Two, three and four corners, together as many as three triangles."""
    faces = [(0, 2, 1), (0, 1), (0, 1, 2, 3)]
    mesh = load_craft(colored_ply(tmp_path, faces, binary=True)).mesh
    points = np.array([[float(word) for word in line.split()[1:]] for line in POINTS.splitlines()])
    expected = points[[(0, 2, 1), (0, 1, 2), (0, 2, 3)]]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], expected)


def test_a_textured_ply_file_has_its_normals_and_coordinates(tmp_path):
    """A square of two triangles, whose corners have other places in the texture."""
    Image.new("RGB", (2, 2), "red").save(tmp_path / "red.png")
    head = "ply\nformat ascii 1.0\ncomment TextureFile red.png\nelement vertex 4\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    head += "element face 2\nproperty list uchar int vertex_indices\n"
    head += "property list uchar float texcoord\nend_header\n"
    rows = [f"{x} {y} 0 0 {x} {2 - x}" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    rows += ["3 0 1 2 6 0 0 1 0 1 1", "3 0 2 3 6 0.5 0 1 1 0 1"]
    (tmp_path / "a.ply").write_text(head + "\n".join(rows) + "\n")
    mesh = load_craft(tmp_path / "a.ply").mesh
    np.testing.assert_allclose(mesh.layers[0][1], [(0.5, 1), (1, 0), (0, 0)])
    half = np.sqrt(0.5)
    expected = [[(0, 0, 1), (0, half, half), (0, half, half)]]
    expected += [[(0, 0, 1), (0, half, half), (0, 0, 1)]]
    np.testing.assert_allclose(mesh.normals, expected, atol=1e-6)


def test_a_ply_texture_without_coordinates_is_told(tmp_path, caplog):
    Image.new("RGB", (2, 2), "red").save(tmp_path / "red.png")
    text = PLY.replace("comment element none", "comment TextureFile red.png")
    shape(tmp_path, "a.ply", text)
    assert "texture 'red.png' is left out, as there are no texture coordinates" in caplog.text


def test_a_ply_text_of_other_types_than_it_states_is_named(tmp_path):
    row = PLY.splitlines().index("7 3 0 3 2") + 1
    line, message = refused(tmp_path, "row.ply", PLY.replace("7 3 0 3 2", "7 3 0 3 x"))
    assert line == row
    assert message == "face: expected numbers of vertex_indices, got '0 3 x'"
