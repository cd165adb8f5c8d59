"""A user's mesh is rendered with its own frame, size and colors; broken files are one error."""

import gzip

import numpy as np
import pytest
import trimesh

from ffpose.errors import DataError
from ffpose.render import Scene, load_craft, render, render_layers, write_dataset
from ffpose.render.spacecraft.craft import surface_points

SIZE = (160, 120)


@pytest.fixture
def brick(tmp_path):
    mesh = trimesh.creation.box((2.0, 1.0, 0.5))
    mesh.apply_translation((0.5, 0.0, 0.0))
    mesh.visual.face_colors = (250, 30, 30, 255)
    path = tmp_path / "brick.ply"
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb"])
def test_every_format_gives_the_same_shape(brick, tmp_path, suffix):
    path = tmp_path / f"copy{suffix}"
    trimesh.load(brick, force="mesh").export(path)
    craft = load_craft(path, scale=2.0)
    corners = craft.mesh.vertices
    np.testing.assert_allclose(corners.min(axis=0), (-1, -1, -0.5), atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), (3, 1, 0.5), atol=1e-6)
    assert len(craft.mesh.faces) == 12


def test_silhouette_is_that_of_the_label(brick):
    scene = Scene("brick", load_craft(brick), (6.0, 9.0), 5.0, min_visible=1.0)
    for index in range(5):
        frame, layers = render(scene, 0, index, SIZE), render_layers(scene, 0, index, SIZE)
        pixels = frame.pose.project(scene.build().mesh.vertices, frame.camera)
        rows, columns = np.nonzero(layers.mask)
        found = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        expected = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        assert np.abs(found - expected).max() <= 1


def test_color_is_kept(brick):
    scene = Scene("brick", load_craft(brick), (4.0, 4.0), 3.0, min_visible=1.0)
    frame, layers = render(scene, 0, 1, SIZE), render_layers(scene, 0, 1, SIZE)
    red, green, blue = frame.image[layers.mask].mean(axis=0)
    assert red > 2 * green
    assert red > 2 * blue


def test_points_stand_for_as_much_of_the_surface_however_fine_its_triangles_are(tmp_path):
    """A body of 20,000 triangles, and two wings of twelve each, as CAD programs export them."""
    body = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    wings = [trimesh.creation.box((2.0, 0.01, 4.0)) for _ in range(2)]
    for wing, side in zip(wings, (-4.0, 4.0), strict=True):
        wing.apply_translation((side, 0.0, 0.0))
    path = tmp_path / "craft.stl"
    trimesh.util.concatenate([body, *wings]).export(path)
    craft = load_craft(path)
    points = surface_points(craft.mesh.vertices[craft.mesh.faces])
    of_wings = np.abs(points[:, 0]) > 2
    share = 2 * wings[0].area / (2 * wings[0].area + body.area)
    assert of_wings.mean() == pytest.approx(share, abs=0.01)
    np.testing.assert_allclose(np.linalg.norm(points[~of_wings], axis=1), 1.0, atol=2e-3)
    quarters = np.histogram2d(points[points[:, 0] > 2, 0], points[points[:, 0] > 2, 2], (2, 2))[0]
    assert quarters.min() > 0.8 * quarters.max()
    ends = np.abs(craft.outline[np.abs(craft.outline[:, 0]) == 5])  # those of the wings
    np.testing.assert_allclose(ends.max(axis=0), (5, 0.005, 2), rtol=1e-6)


def test_the_radius_reaches_to_the_end_of_a_boom(tmp_path):
    """A body of thousands of vertices, a boom of a few: the lamp's light goes by the radius."""
    body = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    boom = trimesh.creation.box((4.0, 0.02, 0.02))
    boom.apply_translation((3.0, 0, 0))
    path = tmp_path / "boom.stl"
    trimesh.util.concatenate([body, boom]).export(path)
    assert load_craft(path).radius == pytest.approx(3.0, rel=2e-3)  # from -1 to 5


def test_another_mesh_is_another_set(brick, tmp_path):
    out = tmp_path / "set"
    write_dataset(Scene("brick", load_craft(brick), (4.0, 9.0), 5.0), out, 2, size=SIZE)
    with pytest.raises(ValueError, match=r"scene\.craft"):
        write_dataset(Scene("brick", load_craft(brick, 1.5), (4.0, 9.0), 5.0), out, 2, size=SIZE)


def test_open_surface_is_lit_on_the_side_that_is_seen(tmp_path):
    path = tmp_path / "sheet.obj"
    path.write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n")
    scene = Scene("sheet", load_craft(path), (5.0, 5.0), 2.0, (180.0, 20.0, 180.0))
    assert all(render(scene, 0, i, SIZE).image.max() > 60 for i in range(4))


def test_surface_that_is_no_manifold_is_rendered(tmp_path):
    """Three fins on one edge, one of them twice, and a face without area."""
    path = tmp_path / "fins.obj"
    path.write_text(
        "v 0 0 -1\nv 0 0 1\nv 1 0 0\nv -1 1 0\nv -1 -1 0\n"
        "f 1 2 3\nf 1 2 4\nf 1 2 5\nf 1 2 5\nf 1 1 2\n"
    )
    scene = Scene("fins", load_craft(path), (4.0, 4.0), 1.0)
    assert all(render_layers(scene, 0, i, SIZE).mask.any() for i in range(4))
    assert all(render(scene, 0, i, SIZE).image.max() > 60 for i in range(4))


def test_huge_meshes_are_refused(brick, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("ffpose.render.spacecraft.meshfile.MAX_FACES", 11)
        with pytest.raises(ValueError, match=r"brick\.ply: expected at most 11 triangles, got 12"):
            load_craft(brick)
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate((1 << 30) + 1)  # takes no room on disk
    with pytest.raises(ValueError, match=r"huge\.stl: expected at most 1073741824 bytes"):
        load_craft(tmp_path / "huge.stl")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.obj", ""),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("flat.obj", "v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n"),
        ("cut.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"),
        ("noise.glb", "not a mesh"),
        ("noise.stl", "solid nothing"),
    ],
)
def test_broken_files_are_named(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=name):
        load_craft(tmp_path / name)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 71234\n",
            "git lfs pull",
        ),
        (b"\xef\xbb\xbf\n<!DOCTYPE html>\n<html><body>Sign in</body></html>\n", "a web page"),
        (b"<html><body>404</body></html>", "a web page"),
        (b"PK\x03\x04\x14\x00", "a ZIP archive: unpack it"),
        (gzip.compress(b"v 0 0 0\n", mtime=0), "a gzip archive: unpack it"),
        (b"ISO-10303-21;\nHEADER;\n", "a STEP file: export it as triangles"),
    ],
)
@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".gltf"])
def test_what_is_no_mesh_is_told_by_its_kind(tmp_path, suffix, content, message):
    path = tmp_path / f"satellite{suffix}"
    path.write_bytes(content)
    with pytest.raises(DataError, match=f"satellite{suffix}: .*got .*{message}"):
        load_craft(path)


def test_a_file_that_a_mesh_refers_to_is_told_by_its_kind(tmp_path):
    path = tmp_path / "satellite.obj"
    path.write_text("mtllib satellite.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "satellite.mtl").write_text("version https://git-lfs.github.com/spec/v1\n")
    with pytest.raises(DataError, match=r"satellite\.mtl: .*git lfs pull"):
        load_craft(path)


def test_wrong_requests_are_refused(brick, tmp_path):
    with pytest.raises(FileNotFoundError):
        load_craft(tmp_path / "none.obj")
    with pytest.raises(ValueError, match=r"\.obj, \.stl"):
        load_craft(tmp_path / "model.step")
    with pytest.raises(ValueError, match="scale"):
        load_craft(brick, scale=0.0)
