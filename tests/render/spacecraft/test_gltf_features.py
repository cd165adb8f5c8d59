"""Each feature of glTF 2.0 by a file of its own: shape, materials, textures, and what is seen."""

import base64
import io
import json
import struct
import sys

import numpy as np
import pytest
from PIL import Image

from ffpose.errors import DataError, MissingExtraError
from ffpose.geometry import Camera, Pose
from ffpose.render import load_craft
from ffpose.render.renderer import prepared, sample_count
from ffpose.render.shading.maps import Maps
from ffpose.render.shading.rays import cast_rays, find_window
from ffpose.render.spacecraft.textures import build_pyramid, linear

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
PLACES = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
"""The whole texture, upright, on the square seen from +z."""

CAMERA = Camera(64, 64, 64.0, 64.0, 32.0, 32.0)
FROM_ABOVE = Pose((0.0, 0.0, 3.0), (0.0, 1.0, 0.0, 0.0))
"""The camera at +z, x to the right and y up in the image."""

KINDS = {
    np.dtype("f4"): 5126,
    np.dtype("u2"): 5123,
    np.dtype("u1"): 5121,
    np.dtype("i1"): 5120,
    np.dtype("i2"): 5122,
}


class File:
    """A .glb file under construction: a square, and what tests change."""

    def __init__(self):
        self.blob = b""
        self.header = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "images": [],
            "textures": [],
            "materials": [],
        }
        self.attributes = {"POSITION": self.accessor(SQUARE), "TEXCOORD_0": self.accessor(PLACES)}
        self.primitive = {"attributes": self.attributes, "indices": self.accessor(FACES)}
        self.header["meshes"] = [{"primitives": [self.primitive]}]
        self.header["nodes"] = [{"mesh": 0}]
        self.header["scenes"] = [{"nodes": [0]}]

    def view(self, content):
        self.header["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(content)}
        )
        self.blob += content + bytes(-len(content) % 4)
        return len(self.header["bufferViews"]) - 1

    def accessor(self, values, **more):
        values = np.asarray(values)
        width = values.shape[1] if values.ndim > 1 else 1
        self.header["accessors"].append(
            {
                "bufferView": self.view(values.tobytes()),
                "componentType": KINDS[values.dtype],
                "count": len(values),
                "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[width],
                **more,
            }
        )
        return len(self.header["accessors"]) - 1

    def texture(self, pixels, **more):
        file = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
        self.header["images"].append(
            {"bufferView": self.view(file.getvalue()), "mimeType": "image/png"}
        )
        self.header["textures"].append({"source": len(self.header["images"]) - 1, **more})
        return len(self.header["textures"]) - 1

    def material(self, **material):
        self.header["materials"].append(material)
        self.primitive["material"] = len(self.header["materials"]) - 1

    def load(self, folder, **options):
        self.header["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.header).encode()
        text += b" " * (-len(text) % 4)
        path = folder / "square.glb"
        path.write_bytes(
            struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.blob))
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(self.blob), b"BIN\0")
            + self.blob
        )
        return load_craft(path, **options)


def seen(craft, pose=FROM_ABOVE, samples=2):
    """Surface at the hits of a view, and the hits' pixels (row, column)."""
    tracer, finish = prepared(craft)
    window = find_window(craft.mesh.vertices, pose, CAMERA)
    view = cast_rays(tracer, window, CAMERA, pose, samples)
    width = np.float32(1 / CAMERA.fx)
    surface = finish.surface(view, view.hits.distance * width, samples)
    row, column = np.divmod(view.hits.ray, window.shape[1] * samples)
    return surface, (window.top + row / samples, window.left + column / samples)


QUARTERS = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]])
"""Red and green above, blue and white below."""


def quarter(craft, top, left):
    surface, (row, column) = seen(craft)
    rows = (row > 15) & (row < 27) if top else (row > 37) & (row < 49)
    columns = (column > 15) & (column < 27) if left else (column > 37) & (column < 49)
    return surface.color[:, rows & columns].mean(axis=1)


def textured(pixels, slot=None, **sampler):
    file = File()
    number = file.texture(pixels, **({"sampler": 0} if sampler else {}))
    if sampler:
        file.header["samplers"] = [sampler]
    rough = {"baseColorTexture": {"index": number, **(slot or {})}, "metallicFactor": 0}
    file.material(pbrMetallicRoughness=rough)
    return file


def test_a_texture_is_upright(tmp_path):
    craft = textured(QUARTERS.repeat(8, 0).repeat(8, 1)).load(tmp_path)
    expected = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
    corners = [(True, True), (True, False), (False, True), (False, False)]
    for where, color in zip(corners, expected, strict=True):
        np.testing.assert_allclose(quarter(craft, *where), color, atol=0.02)


def test_texture_transform_and_wrap(tmp_path):
    """Moved by a half to the right: red and green change places; rotated by 90° they go round."""
    pixels = QUARTERS.repeat(8, 0).repeat(8, 1)
    change = {"extensions": {"KHR_texture_transform": {"offset": [0.5, 0.0]}}}
    craft = textured(pixels, change).load(tmp_path)
    np.testing.assert_allclose(quarter(craft, True, True), (0, 1, 0), atol=0.02)
    change = {"extensions": {"KHR_texture_transform": {"scale": [2.0, 2.0]}}}
    clamped = textured(pixels, change, wrapS=33071, wrapT=33071).load(tmp_path)
    np.testing.assert_allclose(quarter(clamped, False, False), (1, 1, 1), atol=0.02)
    turned = {"rotation": np.pi / 2, "offset": [0.0, 1.0]}
    change = {"extensions": {"KHR_texture_transform": turned}}
    craft = textured(pixels, change).load(tmp_path)
    # (u, v) → (v, 1 − u) of the turned and moved coordinates: upper left shows the lower left.
    np.testing.assert_allclose(quarter(craft, True, True), (0, 0, 1), atol=0.02)


@pytest.mark.parametrize(
    ("offset", "color"), [([1, 0], (0, 1, 0)), ([0, 1], (0, 0, 1)), ([1, 1], (1, 1, 1))]
)
def test_a_mirrored_texture_goes_on_from_its_other_end(tmp_path, offset, color):
    """Moved by its own size, the upper left shows the corner beside, below, or across."""
    pixels = QUARTERS.repeat(8, 0).repeat(8, 1)
    change = {"extensions": {"KHR_texture_transform": {"offset": offset}}}
    craft = textured(pixels, change, wrapS=33648, wrapT=33648).load(tmp_path)
    np.testing.assert_allclose(quarter(craft, True, True), color, atol=0.02)


@pytest.mark.parametrize(
    "slot",
    [
        {"texCoord": 1},
        {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}},
    ],
    ids=["slot", "transform"],
)
def test_a_second_set_of_coordinates(tmp_path, slot):
    file = textured(QUARTERS.repeat(8, 0).repeat(8, 1), slot)
    file.attributes["TEXCOORD_1"] = file.accessor(PLACES[:, ::-1].copy())
    np.testing.assert_allclose(quarter(file.load(tmp_path), True, False), (0, 0, 1), atol=0.02)


def test_a_texture_without_coordinates_is_told(tmp_path, caplog):
    textured(QUARTERS, {"texCoord": 1}).load(tmp_path)
    assert caplog.messages == [
        f"{tmp_path / 'square.glb'}: mesh 0 has a texture and no TEXCOORD_1: of one color"
    ]


def test_nodes_scenes_and_instances_place_what_they_hold(tmp_path):
    file = File()
    half = float(np.sqrt(0.5))
    file.header["nodes"] = [
        {"translation": [5, 0, 0], "children": [1], "camera": 0},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [1, 2, 1]},
        {"mesh": 0},
    ]
    file.header["cameras"] = [{"type": "perspective"}]
    file.header["scenes"] = [{"nodes": [2]}, {"nodes": [0]}]
    file.header["scene"] = 1
    vertices = file.load(tmp_path).mesh.vertices
    np.testing.assert_allclose(np.sort(vertices[:, 0]), [3, 3, 7, 7], atol=1e-6)
    np.testing.assert_allclose(np.sort(vertices[:, 1]), [-1, -1, 1, 1], atol=1e-6)
    copies = file.accessor(np.array([[0, 0, 0], [0, 0, 4]], np.float32))
    attributes = {"attributes": {"TRANSLATION": copies}}
    file.header["nodes"][1]["extensions"] = {"EXT_mesh_gpu_instancing": attributes}
    assert set(file.load(tmp_path).mesh.vertices[:, 2].round(6)) == {0.0, 4.0}
    file.header["nodes"][0]["extensions"] = {"KHR_node_visibility": {"visible": False}}
    with pytest.raises(DataError, match="expected triangles, got none"):
        file.load(tmp_path)


def test_copies_have_places_of_their_own_and_a_mirror_keeps_outside_out(tmp_path):
    """One is mirrored, the other as long again and turned by a quarter about x."""
    file = textured(QUARTERS)
    file.attributes["NORMAL"] = file.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    file.attributes["COLOR_0"] = file.accessor(np.eye(4, 3, dtype=np.float32))
    half = np.sqrt(0.5)
    places = {
        "TRANSLATION": [[0, 0, 0], [0, 0, 4]],
        "ROTATION": [[0, 0, 0, 1], [half, 0, 0, half]],
        "SCALE": [[-1, 1, 1], [2, 1, 1]],
    }
    attributes = {name: file.accessor(np.float32(values)) for name, values in places.items()}
    copies = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    file.header["nodes"] = [{"mesh": 0, "translation": [10, 0, 0], "extensions": copies}]
    mesh = file.load(tmp_path).mesh
    x, y, _ = SQUARE.T
    np.testing.assert_allclose(mesh.vertices[:4], np.stack([10 - x, y, 0 * x], 1), atol=1e-6)
    turned = np.stack([10 + 2 * x, 0 * x, 4 + y], 1)
    np.testing.assert_allclose(mesh.vertices[4:], turned, atol=1e-6)
    outward = np.array([[0, 0, 1]] * 2 + [[0, -1, 0]] * 2)
    np.testing.assert_allclose(mesh.face_normals / [[4], [4], [8], [8]], outward, atol=1e-6)
    normals = outward[:, None].repeat(3, axis=1)
    np.testing.assert_allclose(mesh.corner_normals, normals, atol=1e-6)
    for values in (mesh.layers[0], mesh.colors):
        np.testing.assert_array_equal(values[:2, ::-1], values[2:])


def skinned(**skin):
    """A square of which joints take vertices, in a node whose own place does not count."""
    file = File()
    file.attributes["NORMAL"] = file.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    joints = np.array([[0, 1, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]], np.uint8)
    shares = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0], [0, 0, 0, 0]], np.float32)
    file.attributes |= {"JOINTS_0": file.accessor(joints), "WEIGHTS_0": file.accessor(shares)}
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[0, 0, 3] = -1  # where the first joint is: it changes nothing
    quarter = np.sqrt(0.5)
    file.header["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"translation": [1, 0, 0], "children": [2]},
        {"translation": [0, 0, 2], "rotation": [quarter, 0, 0, quarter]},
    ]
    file.header["scenes"] = [{"nodes": [0, 1]}]
    columns = bind.swapaxes(1, 2).reshape(2, 16)
    file.header["skins"] = [
        {"joints": [1, 2], "inverseBindMatrices": file.accessor(columns), **skin}
    ]
    return file


def test_joints_of_a_skin_take_its_vertices(tmp_path):
    mesh = skinned().load(tmp_path).mesh
    # A quarter turn about x takes (x, y, 0) to (x, 0, y); the second joint is at (1, 0, 2).
    expected = [[-1, -1, 0], [2, 0, 1], [1.5, 0.5, 1.5], [0, 0, 3]]
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)
    np.testing.assert_allclose(
        mesh.corner_normals[0],
        [[0, 0, 1], [0, -1, 0], [0, -np.sqrt(0.5), np.sqrt(0.5)]],
        atol=1e-6,
    )


def test_a_skin_without_bind_matrices_and_a_mesh_without_joints(tmp_path):
    file = skinned()
    joint = file.header["nodes"][1]
    joint["extensions"] = {"KHR_node_visibility": {"visible": False}}  # the mesh is seen still
    del file.header["skins"][0]["inverseBindMatrices"]
    np.testing.assert_allclose(file.load(tmp_path).mesh.vertices[0], [0, -1, 0], atol=1e-6)
    del file.attributes["JOINTS_0"]
    np.testing.assert_allclose(file.load(tmp_path).mesh.vertices, SQUARE + 9, atol=1e-6)


def test_joints_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(DataError, match="expected joints 0…0, got 0…1"):
        skinned(joints=[1]).load(tmp_path)
    file = skinned()
    file.header["scenes"] = [{"nodes": [0]}]
    with pytest.raises(DataError, match="expected joints of skin 0 in the scene, got node 1"):
        file.load(tmp_path)
    file.header["scenes"] = [{"nodes": [0, 1]}]
    (skin,) = file.header["skins"]
    skin["joints"] = [1, 2, 0]
    with pytest.raises(DataError, match="expected 3 bind matrices of skin 0, got 2"):
        file.load(tmp_path)
    skin["joints"] = [1, 2]
    del file.attributes["WEIGHTS_0"]
    with pytest.raises(DataError, match="got one without 'WEIGHTS_0'"):
        file.load(tmp_path)


def test_morph_targets_move_vertices_normals_and_colors_by_their_weights(tmp_path):
    file = File()
    file.attributes["NORMAL"] = file.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    file.attributes["COLOR_0"] = file.accessor(np.full((4, 3), 0.5, np.float32))
    up, leaning = (np.tile(np.float32(v), (4, 1)) for v in ([0, 0, 2], [4, 0, 0]))
    moved = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 8, 0]], np.float32)
    file.primitive["targets"] = [
        {"POSITION": file.accessor(up), "NORMAL": file.accessor(leaning)},
        {"POSITION": file.accessor(moved), "COLOR_0": file.accessor(-up)},
    ]
    assert file.load(tmp_path).mesh.vertices == pytest.approx(SQUARE)
    file.header["meshes"][0]["weights"] = [0.25, 0.5]
    craft = file.load(tmp_path)
    expected = SQUARE + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0.5], [0, 4, 0.5]])
    assert craft.mesh.vertices == pytest.approx(expected)
    assert craft.mesh.corner_normals[0] == pytest.approx(np.tile([0.5, 0, 0.5], (3, 1)) * 2**0.5)
    surface, _ = seen(craft)
    assert surface.color[:2] == pytest.approx(0.5, abs=1e-6)
    assert surface.color[2] == pytest.approx(0.0, abs=1e-6)  # 0.5 - 1, which is no color
    # Deltas without alpha leave it, and an alpha's are for one that is not told: it is 1.
    file.attributes["COLOR_0"] = file.accessor(np.full((4, 4), 0.5, np.float32))
    assert seen(file.load(tmp_path))[0].color[2] == pytest.approx(0.0, abs=1e-6)
    # A node's weights go before its mesh's; two nodes show one mesh in two shapes.
    file.header["nodes"] = [{"mesh": 0, "weights": [0.5, 0]}, {"mesh": 0, "weights": [0, 0]}]
    file.header["scenes"] = [{"nodes": [0, 1]}]
    heights = file.load(tmp_path).mesh.vertices[:, 2]
    assert sorted(heights.tolist()) == pytest.approx([0, 0, 0, 0, 1, 1, 1, 1])


def test_colors_of_vertices_are_within_their_range_after_all_morph_targets(tmp_path):
    """What is no number is black; 0.75 + 0.5 - 0.5 is 0.75, though the first sum is more than 1."""
    file = File()
    colors = np.array([[2, -1, 0.5], [np.nan, np.inf, 1], [0.75] * 3, [0, 0, 0]], np.float32)
    file.attributes["COLOR_0"] = file.accessor(colors)
    half = file.accessor(np.full((4, 3), 0.5, np.float32))
    file.primitive["targets"] = [{"COLOR_0": half}, {"COLOR_0": half}]
    mesh = file.load(tmp_path).mesh
    expected = np.array([[1, 0, 0.5], [0, 1, 1], [0.75] * 3])
    np.testing.assert_allclose(mesh.colors[0, :, :3], expected)
    file.header["meshes"][0]["weights"] = [1, -1]
    assert file.load(tmp_path).mesh.colors[0, 2, :3] == pytest.approx(0.75)


def test_morph_targets_that_do_not_fit_are_refused(tmp_path):
    file = File()
    file.primitive["targets"] = [{"POSITION": file.accessor(SQUARE[:3])}]
    file.header["meshes"][0]["weights"] = [1, 1]
    with pytest.raises(DataError, match="expected weights of 1 morph targets, got 2"):
        file.load(tmp_path)
    file.header["meshes"][0]["weights"] = [1]
    with pytest.raises(DataError, match="expected 4 values of POSITION in a morph target, got 3"):
        file.load(tmp_path)


def test_a_mirror_keeps_outside_out(tmp_path):
    file = File()
    file.header["nodes"] = [{"mesh": 0, "scale": [-1, 1, 1]}]
    craft = file.load(tmp_path)
    a, b, c = craft.mesh.vertices[craft.mesh.faces[0]]
    assert np.cross(b - a, c - a)[2] > 0
    file.attributes["NORMAL"] = file.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    np.testing.assert_allclose(file.load(tmp_path).mesh.corner_normals[0], [[0, 0, 1]] * 3)


@pytest.mark.parametrize(
    ("mode", "indices"),
    [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3]), (4, None)],
    ids=["strip", "fan", "no indices"],
)
def test_modes_of_primitives(tmp_path, mode, indices):
    file = File()
    file.primitive["mode"] = mode
    if indices is None:
        del file.primitive["indices"]
        file.attributes["POSITION"] = file.accessor(SQUARE[FACES])
        del file.attributes["TEXCOORD_0"]
    else:
        file.primitive["indices"] = file.accessor(np.array(indices, np.uint16))
    mesh = file.load(tmp_path).mesh
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(4)


def test_whole_numbers_that_stand_for_fractions_and_sparse_values(tmp_path):
    file = File()
    file.attributes["POSITION"] = file.accessor((SQUARE * 127).astype(np.int8), normalized=True)
    file.attributes["COLOR_0"] = file.accessor(np.full((4, 3), 51, np.uint8), normalized=True)
    craft = file.load(tmp_path)
    np.testing.assert_allclose(craft.mesh.vertices, SQUARE, atol=1e-6)
    np.testing.assert_allclose(craft.mesh.colors[..., :3], 0.2, atol=1e-6)
    file = File()
    where = file.view(np.array([2], np.uint16).tobytes())
    what = file.view(np.array([[3, 3, 0]], np.float32).tobytes())
    file.header["accessors"][file.attributes["POSITION"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": where, "componentType": 5123},
        "values": {"bufferView": what},
    }
    np.testing.assert_allclose(file.load(tmp_path).mesh.vertices[2], (3, 3, 0))


def compressed(number, file, values, mode, packed, **more):
    """Replace the view of an accessor by one that holds nothing but its compression."""
    where = file.view(packed)
    hidden = file.header["bufferViews"].pop()
    assert where == len(file.header["bufferViews"])
    view = file.header["bufferViews"][file.header["accessors"][number]["bufferView"]]
    stride = values.itemsize * (values.shape[1] if values.ndim > 1 else 1)
    view |= {"byteOffset": 0, "buffer": 1}
    extension = {**hidden, "byteStride": stride, "count": len(values), "mode": mode, **more}
    view["extensions"] = {"EXT_meshopt_compression": extension}


def meshopt_file():
    meshopt = pytest.importorskip("meshopt")
    file = File()
    file.header["extensionsRequired"] = ["EXT_meshopt_compression"]
    attributes = meshopt.encode_gltf_buffer(PLACES, "ATTRIBUTES")
    compressed(1, file, PLACES, "ATTRIBUTES", attributes)
    triangles = meshopt.encode_gltf_buffer(FACES, "TRIANGLES")
    compressed(2, file, FACES, "TRIANGLES", triangles)
    # Coordinates of -1 and 1 are exact in the filter's 15 bits and common exponent.
    filtered = meshopt.encode_filter_exp(SQUARE, 15, "SharedVector")
    positions = meshopt.encode_gltf_buffer(filtered, "ATTRIBUTES")
    compressed(0, file, SQUARE, "ATTRIBUTES", positions, filter="EXPONENTIAL")
    return file


def test_compression_by_meshopt_changes_nothing(tmp_path):
    plain, unpacked = File(), meshopt_file()
    for file in (plain, unpacked):
        file.material(pbrMetallicRoughness={"baseColorTexture": {"index": file.texture(QUARTERS)}})
    plain, unpacked = (file.load(tmp_path).mesh for file in (plain, unpacked))

    def corners(mesh):
        return mesh.vertices[mesh.faces]

    # The coder may turn the corners of a triangle, but not flip it.
    for triangle, found in zip(corners(plain), corners(unpacked), strict=True):
        assert any((np.roll(found, turn, axis=0) == triangle).all() for turn in range(3))
    both = (np.concatenate([corners(m)[..., :2], m.layers[0]], axis=-1) for m in (plain, unpacked))
    pairs = [{tuple(row) for row in each.reshape(-1, 4).tolist()} for each in both]
    assert pairs[0] == pairs[1]


def test_what_meshopt_compressed_is_refused_without_it_and_when_broken(tmp_path, monkeypatch):
    file = meshopt_file()
    packed = file.header["bufferViews"][0]["extensions"]["EXT_meshopt_compression"]
    packed["count"] = 5
    with pytest.raises(DataError, match="expected 48 bytes in a compressed buffer, got 5 times 12"):
        file.load(tmp_path)
    packed["count"], file.blob = 4, bytes(len(file.blob))
    with pytest.raises(DataError, match="expected a glTF document, got "):
        file.load(tmp_path)
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(MissingExtraError, match=r"meshopt.*\[meshopt\]"):
        file.load(tmp_path)


def test_factors_and_extensions_of_materials(tmp_path):
    file = File()
    file.material(
        pbrMetallicRoughness={
            "baseColorFactor": [0.5, 0.25, 0.1, 1.0],
            "metallicFactor": 0.7,
            "roughnessFactor": 0.4,
        },
        emissiveFactor=[0.1, 0.2, 0.3],
        extensions={
            "KHR_materials_ior": {"ior": 2.0},
            "KHR_materials_specular": {"specularFactor": 0.5},
            "KHR_materials_emissive_strength": {"emissiveStrength": 4.0},
        },
    )
    (material,) = file.load(tmp_path).materials
    assert material.color == (0.5, 0.25, 0.1)
    assert (material.metallic, material.roughness) == (0.7, 0.4)
    np.testing.assert_allclose(material.reflectance, 0.5 * (1 / 3) ** 2)
    np.testing.assert_allclose(material.emission, (0.4, 0.8, 1.2))
    assert not material.two_sided
    assert File().load(tmp_path).materials[0].metallic == 1.0  # the specification's defaults
    assert file.load(tmp_path, two_sided=True).materials[0].two_sided


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("unlit", {}, {"roughness": 1, "metallic": 0, "reflectance": (0, 0, 0)}),
        ("transmission", {"transmissionFactor": 0.5}, {"alpha": 0.55, "roughness": 0.4}),
        (  # of 4 % that the index 1.5 reflects, and of no more than all
            "specular",
            {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 50]},
            {"reflectance": (0.02, 0.01, 0.5), "metallic": 0.7},
        ),
    ],
)
def test_an_extension_changes_what_it_says_and_nothing_else(tmp_path, name, values, expected):
    file = File()
    color = {"baseColorFactor": [0.5, 0.25, 0.1, 1], "metallicFactor": 0.7, "roughnessFactor": 0.4}
    file.material(pbrMetallicRoughness=color, extensions={f"KHR_materials_{name}": values})
    (material,) = file.load(tmp_path).materials
    assert material.color == (0.5, 0.25, 0.1)
    for field, value in expected.items():
        assert getattr(material, field) == pytest.approx(value)


def test_a_texture_of_specular_reflectances_stands_for_its_mean(tmp_path):
    """Its factor is one where the file names none, which by itself is that of a mirror."""
    file = File()
    halves = np.zeros((100, 60, 4), np.uint8)
    halves[:, :30, :3], halves[..., 3] = (255, 128, 0), 51
    glossy = {"specularGlossinessTexture": {"index": file.texture(halves)}}
    file.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    (material,) = file.load(tmp_path).materials
    np.testing.assert_allclose(material.reflectance, 0.5 * linear((1, 128 / 255, 0)), atol=1e-3)
    glossy["specularFactor"] = [0.1, 0.2, 0.3]
    (dim,) = file.load(tmp_path).materials
    np.testing.assert_allclose(dim.reflectance, np.multiply(material.reflectance, (0.1, 0.2, 0.3)))


def test_a_texture_in_ktx2_alone_is_refused_and_one_with_another_image_is_read(tmp_path):
    file = textured(QUARTERS)
    (texture,) = file.header["textures"]
    other = file.load(tmp_path).materials[0].color_map.image.level(0)
    texture["extensions"] = {"KHR_texture_basisu": {"source": 1}}
    file.header["images"].append({"bufferView": 0, "mimeType": "image/ktx2"})
    (both,) = file.load(tmp_path).materials
    np.testing.assert_array_equal(both.color_map.image.level(0), other)
    del texture["source"]
    with pytest.raises(DataError, match="PNG, JPEG or WebP, got texture 0 in KTX2"):
        file.load(tmp_path)
    head = b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(68)
    (tmp_path / "skin.bin").write_bytes(head)
    data = f"data:application/octet-stream;base64,{base64.b64encode(head).decode()}"
    for uri, name in (("skin.bin", "'skin.bin'"), (data, "1")):
        file.header["images"][1] = {"uri": uri}
        file.header["textures"] = [{"source": 1}]
        with pytest.raises(DataError, match=f"got image {name} in KTX2"):
            file.load(tmp_path)


def test_metal_and_roughness_come_from_their_channels(tmp_path):
    file = File()
    number = file.texture(np.full((4, 4, 3), (9, 102, 204)))
    file.material(pbrMetallicRoughness={"metallicRoughnessTexture": {"index": number}})
    surface, _ = seen(file.load(tmp_path))
    np.testing.assert_allclose(surface.roughness, 0.4, atol=1e-3)
    np.testing.assert_allclose(surface.metallic, 0.8, atol=1e-3)


def test_a_normal_map_leans_right_and_up(tmp_path):
    file = File()
    code = np.round((np.array([0.6, 0.0, 0.8]) + 1) / 2 * 255)
    file.material(normalTexture={"index": file.texture(np.full((4, 4, 3), code))})
    surface, _ = seen(file.load(tmp_path))
    np.testing.assert_allclose(surface.normal.mean(axis=1), (0.6, 0, 0.8), atol=0.01)
    file = File()
    code = np.round((np.array([0.0, 0.6, 0.8]) + 1) / 2 * 255)
    file.material(normalTexture={"index": file.texture(np.full((4, 4, 3), code))})
    surface, _ = seen(file.load(tmp_path))
    np.testing.assert_allclose(surface.normal.mean(axis=1), (0, 0.6, 0.8), atol=0.01)


def test_a_texture_of_emission_multiplies_its_factor(tmp_path):
    """Code 128 stands for 0.2159 of the light of 255."""
    file = File()
    number = file.texture(np.full((4, 4, 3), (255, 128, 0)))
    file.material(emissiveTexture={"index": number}, emissiveFactor=[0.5, 1, 1])
    surface, _ = seen(file.load(tmp_path))
    np.testing.assert_allclose(surface.emission.mean(axis=1), (0.5, 0.2159, 0), atol=1e-3)


@pytest.mark.parametrize("other", [True, False], ids=["beside another", "alone"])
def test_a_texture_in_webp_is_read(tmp_path, other):
    file = textured(np.full((4, 4, 3), (255, 0, 0)))
    blue = io.BytesIO()
    Image.new("RGB", (4, 4), (0, 0, 255)).save(blue, "WEBP", lossless=True)
    file.header["images"].append(
        {"bufferView": file.view(blue.getvalue()), "mimeType": "image/webp"}
    )
    (texture,) = file.header["textures"]
    texture["extensions"] = {"EXT_texture_webp": {"source": 1}}
    if not other:
        del texture["source"]
    surface, _ = seen(file.load(tmp_path))
    np.testing.assert_allclose(surface.color.mean(axis=1), (0, 0, 1), atol=1e-3)


@pytest.mark.parametrize(("mode", "share"), [("OPAQUE", 1.0), ("MASK", 0.5), ("BLEND", 0.625)])
def test_alpha_modes(tmp_path, mode, share):
    """A texture half of alpha 1 and half of alpha a quarter."""
    pixels = np.full((16, 16, 4), 255)
    pixels[:, 8:, 3] = 64
    file = textured(pixels)
    file.header["materials"][0]["alphaMode"] = mode
    surface, _ = seen(file.load(tmp_path), samples=4)
    full, _ = seen(textured(pixels).load(tmp_path), samples=4)
    found = surface.color.shape[1] / full.color.shape[1]
    assert found == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(("alpha", "factor", "share"), [(0.6, 1, 1), (0.6, 0.8, 0), (0.4, 1, 0)])
def test_a_mask_has_all_or_nothing_of_vertices_with_alpha(tmp_path, alpha, factor, share):
    """It is there from 0.5 on, of the product (section 3.9.4)."""
    file = File()
    file.attributes["COLOR_0"] = file.accessor(np.float32([(1, 1, 1, alpha)] * 4))
    file.material(alphaMode="MASK", pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, factor]})
    found, _ = seen(file.load(tmp_path), samples=4)
    full, _ = seen(File().load(tmp_path), samples=4)
    assert found.color.shape[1] == share * full.color.shape[1]


def test_one_sided_surfaces_are_gone_from_behind(tmp_path):
    behind = Pose((0.0, 0.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    file = File()
    file.material(doubleSided=False)
    assert seen(file.load(tmp_path), behind)[0].color.size == 0
    assert seen(file.load(tmp_path), FROM_ABOVE)[0].color.size > 0
    file.header["materials"][0]["doubleSided"] = True
    assert seen(file.load(tmp_path), behind)[0].color.size > 0


@pytest.mark.parametrize("distance", [4.0, 40.0, 400.0])
def test_a_far_texture_has_its_mean_light(tmp_path, distance):
    """Within 1 % at any distance, of the light: half of white would be 0.21 as a mean of codes."""
    board = np.indices((64, 64)).sum(axis=0) % 2
    pixels = np.random.default_rng(0).integers(0, 256, (64, 64, 3)) * board[..., None]
    craft = textured(pixels).load(tmp_path)
    light = linear(pixels / 255).mean(axis=(0, 1))
    pose = Pose((0.0, 0.0, distance), (0.0, 1.0, 0.0, 0.0))
    tracer, finish = prepared(craft)
    camera = Camera(32, 32, 12.0 * distance, 12.0 * distance, 16.0, 16.0)
    view = cast_rays(tracer, find_window(craft.mesh.vertices, pose, camera), camera, pose, 2)
    shown = finish.surface(view, view.hits.distance / np.float32(camera.fx), 2).color
    np.testing.assert_allclose(shown.mean(axis=1), light, rtol=0.01)
    np.testing.assert_allclose(Maps(craft).means["color_map"][:, :3].mean(axis=0), light, rtol=0.03)


@pytest.mark.parametrize("distance", [4.0, 10.0, 25.0, 60.0, 150.0])
def test_an_object_that_recedes_from_a_camera_keeps_its_textures_mean(tmp_path, distance):
    """Within 1 %, from 128 pixels across to 3, seen from the front and askew."""
    pixels = np.random.default_rng(0).integers(0, 256, (256, 256, 3))
    pixels[96:160, 64:96] = 255
    craft = textured(pixels).load(tmp_path)
    light = linear(pixels / 255).mean(axis=(0, 1))
    tracer, finish = prepared(craft)
    camera = Camera(512, 384, 256.0, 256.0, 256.0, 192.0)
    for slant in (0.0, 0.5):
        attitude = (np.sin(slant / 2), np.cos(slant / 2), 0.0, 0.0)
        pose = Pose((0.2, 0.1, distance), attitude)
        window = find_window(craft.mesh.vertices, pose, camera)
        samples = sample_count(window, camera)
        view = cast_rays(tracer, window, camera, pose, samples)
        footprint = view.hits.distance / np.float32(camera.fx)
        shown = finish.surface(view, footprint, samples).color
        np.testing.assert_allclose(shown.mean(axis=1), light, rtol=0.01)


def test_nothing_of_a_neighbor_in_the_texture_bleeds_into_a_small_face(tmp_path):
    pixels = np.zeros((64, 64, 3))
    pixels[20:24, 20:24] = (255, 0, 0)
    file = textured(pixels)
    file.attributes["TEXCOORD_0"] = file.accessor(((20.5 + 3 * PLACES) / 64).astype(np.float32))
    pose = Pose((0.0, 0.0, 90.0), (0.0, 1.0, 0.0, 0.0))
    surface, _ = seen(file.load(tmp_path), pose)
    np.testing.assert_allclose(surface.color.mean(axis=1), (1, 0, 0), atol=0.01)


def test_levels_keep_the_mean_and_a_large_texture_is_averaged_down():
    rng = np.random.default_rng(1)
    codes = rng.integers(0, 256, (50, 70, 3), dtype=np.uint8)

    def values(codes):
        return linear(codes / 255).astype(np.float32)

    pyramid = build_pyramid(Image.fromarray(codes), values, most=32)
    assert (pyramid.width, pyramid.height) == (32, 32)
    mean = linear(codes / 255).mean(axis=(0, 1))
    for number in range(6):
        level = pyramid.level(number).astype(np.float64)
        np.testing.assert_allclose(level.mean(axis=(0, 1))[:3], mean, rtol=1e-3)


def test_a_wide_texture_is_averaged_down_to_the_longest_side(tmp_path):
    """Of 8192 columns that are black and white by turns, 4096 have half of the light."""
    columns = np.arange(8192) % 2 * 255
    craft = textured(np.broadcast_to(columns[:, None], (16, 8192, 3))).load(tmp_path)
    image = craft.materials[0].color_map.image
    assert (image.width, image.height) == (4096, 16)
    np.testing.assert_allclose(image.level(0)[..., :3], 0.5, atol=1e-3)


def test_all_that_is_made_of_an_image_counts_toward_the_memory_of_textures(tmp_path, monkeypatch):
    """Of one image colors with two thresholds, normals with two scales, and light, thrice."""
    monkeypatch.setattr("ffpose.render.spacecraft.textures.BUDGET", 1 << 20)
    file = File()
    file.texture(np.random.default_rng(0).integers(0, 256, (256, 256, 3)))
    file.header["samplers"] = [{"wrapS": wrap} for wrap in (10497, 33071, 33648)]
    file.header["textures"] = [{"source": 0, "sampler": number} for number in range(3)]
    primitives = file.header["meshes"][0]["primitives"] = []
    for number in range(3):
        for share in (0.25, 0.5):
            file.material(
                pbrMetallicRoughness={"baseColorTexture": {"index": number}},
                normalTexture={"index": number, "scale": share},
                emissiveTexture={"index": number},
                alphaMode="MASK",
                alphaCutoff=share,
            )
            primitives.append(dict(file.primitive))
    craft = file.load(tmp_path)
    images = {texture.image for material in craft.materials for texture in material.maps}
    assert len(images) == 3 * (2 + 2 + 1)
    assert sum(image.texels.nbytes for image in images) <= 1 << 20
    # Each with sides of 128 would take 175 kB, and all of them 2.6 MB.
    assert {(image.width, image.height) for image in images} == {(64, 64)}


def test_up_and_center_move_the_object_frame(tmp_path):
    file = File()
    file.header["nodes"] = [{"mesh": 0, "translation": [7, 8, 9]}]
    vertices = file.load(tmp_path, up="y").mesh.vertices
    np.testing.assert_allclose(vertices[:, 2], SQUARE[:, 1] + 8, atol=1e-6)
    np.testing.assert_allclose(np.abs(vertices[:, 1]), 9, atol=1e-6)
    centered = file.load(tmp_path, center=True).mesh.vertices
    np.testing.assert_allclose(centered, SQUARE, atol=5e-3)
    with pytest.raises(ValueError, match="mesh up: expected one of x, y, z"):
        file.load(tmp_path, up="north")
