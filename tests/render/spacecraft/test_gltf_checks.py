"""What a glTF document may not have is refused by name, before anything is made of it."""

import tracemalloc
import warnings
from contextlib import contextmanager

import DracoPy
import numpy as np
import pytest

from ffpose.errors import DataError
from ffpose.render import load_craft
from glb import write_glb

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint16)
MIB = 1 << 20


def tetrahedron():
    """Return the header of a file of one mesh, and what its buffer consists of."""
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "name": "bus",
                "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}],
            }
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [],
    }
    return header, [POINTS.tobytes(), FACES.tobytes()]


def load(folder, header, contents):
    blob = b""
    for content in contents:
        view = {"buffer": 0, "byteOffset": len(blob), "byteLength": len(content)}
        header["bufferViews"].append(view)
        blob += content + bytes(-len(content) % 4)
    header.setdefault("buffers", [{"byteLength": len(blob)}])
    return load_craft(write_glb(folder / "bus.glb", header, blob))


def changed(folder, place, value):
    """Load a file with a value at a place, of which a part may not be there yet."""
    header, contents = tetrahedron()
    *above, last = place
    inner = header
    for key in above:
        inner = inner[key] if isinstance(key, int) else inner.setdefault(key, {})
    inner[last] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load(folder, header, contents)


def refused(folder, *change):
    with pytest.raises(DataError) as caught:
        changed(folder, *change)
    assert caught.value.file == folder / "bus.glb"
    return caught.value.message


@contextmanager
def little_memory(most):
    """Expect that no more bytes than these are taken at any time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


PRIMITIVE = ("meshes", 0, "primitives", 0)


@pytest.mark.parametrize(
    "place",
    [
        ("scene",),
        ("nodes", 0, "mesh"),
        (*PRIMITIVE, "material"),
        (*PRIMITIVE, "indices"),
        ("accessors", 0, "bufferView"),
        ("accessors", 1, "count"),
        ("accessors", 1, "byteOffset"),
    ],
)
def test_negative_indices_and_counts_are_refused(tmp_path, place):
    assert refused(tmp_path, place, -1) == f"expected {place[-1]} of at least 0, got -1"


def test_negative_indices_in_lists_and_attributes_are_refused(tmp_path):
    message = "of at least 0, got -1"
    assert refused(tmp_path, ("scenes", 0, "nodes"), [-1]) == f"expected nodes {message}"
    assert refused(tmp_path, ("nodes", 0, "children"), [-1]) == f"expected children {message}"
    place = (*PRIMITIVE, "attributes", "POSITION")
    assert refused(tmp_path, place, -1) == f"expected attributes {message}"
    place = (*PRIMITIVE, "targets")
    assert refused(tmp_path, place, [{"POSITION": -1}]) == f"expected targets {message}"


def test_what_is_not_read_may_hold_anything(tmp_path):
    """VRM has indices of -1 for what a model lacks."""
    for place in (("extras",), ("nodes", 0, "extras"), ("extensions", "VRM")):
        craft = changed(tmp_path, place, {"mesh": -1, "roughnessFactor": 7, "far": np.inf})
        assert len(craft.mesh.faces) == 4


@pytest.mark.parametrize("name", ["KHR_materials_acme", "KHR_materials_ior_2"])
def test_a_required_extension_that_is_not_known_is_named(tmp_path, name):
    message = refused(tmp_path, ("extensionsRequired",), ["KHR_materials_ior", name])
    assert message == f"expected glTF extensions that are known, got one that needs {name}"


def test_what_is_left_out_of_materials_is_told_once(tmp_path, caplog):
    header, contents = tetrahedron()
    material = {
        "KHR_materials_clearcoat": {"clearcoatFactor": 1},
        "KHR_materials_ior": {"ior": 1.4},
        "KHR_materials_transmission": {"transmissionTexture": {"index": 0}},
        "KHR_materials_volume": {"thicknessFactor": 1},
        "KHR_xmp_json_ld": {"packet": 0},
    }
    header["extensionsRequired"] = list(material)
    header["materials"] = [{"extensions": {**material, "ACME_materials_rust": {}}}] * 2
    load(tmp_path, header, contents)
    left_out = "ACME_materials_rust, KHR_materials_clearcoat, KHR_materials_volume"
    left_out += ", transmissionTexture of KHR_materials_transmission"
    file = tmp_path / "bus.glb"
    assert caplog.messages == [f"{file}: extensions of materials are left out: {left_out}"]


MATERIAL = ("materials", 0)
METALLIC = (*MATERIAL, "pbrMetallicRoughness")
GLOSSY = (*MATERIAL, "extensions", "KHR_materials_pbrSpecularGlossiness")


@pytest.mark.parametrize(
    ("place", "value", "nearest", "said"),
    [
        ((*METALLIC, "baseColorFactor"), [0.5, 1.5, 0.5, 1], [0.5, 1, 0.5, 1], "1.5 is out of 0…1"),
        ((*METALLIC, "metallicFactor"), -0.5, 0, "-0.5 is out of 0…1: 0"),
        ((*METALLIC, "roughnessFactor"), 2, 1, "2 is out of 0…1: 1"),
        ((*MATERIAL, "emissiveFactor"), [0, 0, 3], [0, 0, 1], "3 is out of 0…1: 1"),
        ((*MATERIAL, "alphaCutoff"), -1, 0, "-1 is out of at least 0: 0"),
        ((*GLOSSY, "glossinessFactor"), 1.01, 1, "1.01 is out of 0…1: 1"),
        (
            (*MATERIAL, "extensions", "KHR_materials_emissive_strength", "emissiveStrength"),
            -2,
            0,
            "-2 is out of at least 0: 0",
        ),
    ],
)
def test_factors_out_of_range_are_told_and_set_to_its_end(
    tmp_path, caplog, place, value, nearest, said
):
    craft = changed(tmp_path, place, value)
    assert f"{place[-1]} {said}" in caplog.text
    assert repr(craft.materials) == repr(changed(tmp_path, place, nearest).materials)
    unknown = [*value[:-1], np.nan] if isinstance(value, list) else np.nan
    assert refused(tmp_path, place, unknown) == f"expected a finite {place[-1]}, got nan"


def test_factors_at_the_ends_of_their_range_are_read(tmp_path):
    # Public models of a tool that computes in float32 have this color.
    changed(tmp_path, (*METALLIC, "baseColorFactor"), [1.0000001192092896, 0, 1, 1])
    strength = (*MATERIAL, "extensions", "KHR_materials_emissive_strength", "emissiveStrength")
    changed(tmp_path, strength, 50)
    changed(tmp_path, (*MATERIAL, "alphaCutoff"), 2)  # section 3.9.4: all of it is transparent


@pytest.mark.parametrize("name", ["translation", "rotation", "scale", "matrix"])
def test_nodes_at_no_place_are_refused(tmp_path, name):
    values = {"rotation": [0, 0, 0, 1], "matrix": np.eye(4).reshape(-1).tolist()}
    value = values.get(name, [1, 1, 1])
    value[1] = np.nan
    assert refused(tmp_path, ("nodes", 0, name), value) == f"expected a finite {name}, got nan"


def test_copies_at_no_place_are_refused(tmp_path):
    header, contents = tetrahedron()
    places = np.array([[0, 0, 0], [np.nan, 0, 0]], np.float32)
    header["accessors"].append({**header["accessors"][0], "bufferView": 2, "count": 2})
    copies = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}
    header["nodes"][0]["extensions"] = copies
    with pytest.raises(DataError, match="expected finite places of meshes"):
        load(tmp_path, header, [*contents, places.tobytes()])


def draco(content):
    header, _ = tetrahedron()
    for accessor in header["accessors"]:
        del accessor["bufferView"]
    packed = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    header["meshes"][0]["primitives"][0]["extensions"] = packed
    header["extensionsRequired"] = list(packed)
    return header, [content]


def test_draco_is_read_or_refused(tmp_path):
    content = DracoPy.encode(POINTS, FACES, quantization_bits=20)
    mesh = load(tmp_path, *draco(content)).mesh
    found = {tuple(sorted(map(tuple, corners))) for corners in mesh.vertices[mesh.faces].round(4)}
    assert found == {tuple(sorted(map(tuple, corners))) for corners in POINTS[FACES]}
    message = "expected Draco data of mesh 'bus' that can be decoded"
    for broken in (b"no Draco data", content[:20], content[:-8]):
        with pytest.raises(DataError, match=message):
            load(tmp_path, *draco(broken))
    header, contents = draco(content)
    packed = header["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]
    packed["attributes"]["POSITION"] = 7
    with pytest.raises(DataError, match=message):
        load(tmp_path, header, contents)


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize(
    ("name", "target"),
    [("POSITION", False), ("NORMAL", False), ("_WEAR", False), ("POSITION", True)],
)
def test_vertices_are_counted_before_they_are_read(tmp_path, sparse, name, target):
    header, contents = tetrahedron()
    huge = {"componentType": 5126, "count": 1_500_000_000, "type": "VEC3"}
    if sparse:
        huge["sparse"] = {
            "count": 1,
            "indices": {"bufferView": 1, "componentType": 5123},
            "values": {"bufferView": 0},
        }
    header["accessors"].append(huge)
    (mesh,) = header["meshes"]
    if target:
        mesh["primitives"][0]["targets"] = [{name: 2}]
        mesh["weights"] = [0.5]
    else:
        mesh["primitives"][0]["attributes"][name] = 2
    with (
        little_memory(16 * MIB),
        pytest.raises(DataError, match="at most 6000000 vertices, got 1500000000"),
    ):
        load(tmp_path, header, contents)


def copied(header, *counts, mesh=0):
    """Return a node of copies of a mesh, all at one place, by attributes of these counts."""
    names, first = ("TRANSLATION", "ROTATION"), len(header["accessors"])
    for count, kind in zip(counts, ("VEC3", "VEC4"), strict=False):
        header["accessors"].append({"componentType": 5126, "count": count, "type": kind})
    numbers = {name: first + k for k, name in enumerate(names[: len(counts)])}
    return {"mesh": mesh, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": numbers}}}


@pytest.mark.parametrize(
    ("nodes", "copies", "triangles"),
    [(1, 1_500_000_000, 4), (3, 2_000_000, 1000), (2000, 1_000_000, 4)],
    ids=["many copies", "copies of many triangles", "many nodes"],
)
def test_copies_are_counted_before_they_are_placed(tmp_path, nodes, copies, triangles):
    header, contents = tetrahedron()
    header["accessors"].append({"componentType": 5125, "count": 3 * triangles, "type": "SCALAR"})
    header["meshes"][0]["primitives"][0]["indices"] = 2
    header["nodes"] = [copied(header, copies)] * nodes
    header["scenes"] = [{"nodes": list(range(nodes))}]
    message = f"at most 2000000 triangles, got {nodes * copies * triangles}$"
    with little_memory(32 * MIB), pytest.raises(DataError, match=message):
        load(tmp_path, header, contents)


def test_any_number_of_copies_of_what_has_no_faces_takes_no_room(tmp_path):
    header, contents = tetrahedron()
    header["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]})
    header["nodes"].append(copied(header, 1_500_000_000, mesh=1))
    header["scenes"] = [{"nodes": [0, 1]}]
    with little_memory(32 * MIB):
        assert len(load(tmp_path, header, contents).mesh.faces) == 4


def test_copies_whose_attributes_disagree_are_refused(tmp_path):
    header, contents = tetrahedron()
    header["nodes"] = [copied(header, 3, 2)]
    message = "expected as many values of each attribute of a mesh's copies, got 2 and 3"
    with pytest.raises(DataError, match=message):
        load(tmp_path, header, contents)


def test_copies_of_what_draco_compressed_are_counted_by_its_own_triangles(tmp_path, monkeypatch):
    monkeypatch.setattr("ffpose.render.spacecraft.meshfile.MAX_FACES", 10)
    header, contents = draco(DracoPy.encode(POINTS, FACES, quantization_bits=20))
    header["accessors"][1]["count"] = 3  # one triangle of the four
    header["nodes"] = [copied(header, 3)]
    with pytest.raises(DataError, match="at most 10 triangles, got 12"):
        load(tmp_path, header, contents)


def test_draco_keeps_sixteen_bits_what_they_stand_for(tmp_path):
    """DracoPy gives them in 32 bits, of which they would be nothing."""
    half = np.full((4, 4), 32768, np.uint16)
    content = DracoPy.encode(POINTS, FACES, quantization_bits=20, generic_attributes={0: half})
    header, contents = draco(content)
    number = next(
        each["unique_id"]
        for each in DracoPy.decode(content).attributes
        if each["data"].dtype.kind == "u"
    )
    positions = next(
        each["unique_id"]
        for each in DracoPy.decode(content).attributes
        if each["data"].dtype.kind == "f"
    )
    colors = {"componentType": 5123, "normalized": True, "count": 4, "type": "VEC4"}
    header["accessors"].append(colors)
    (primitive,) = header["meshes"][0]["primitives"]
    primitive["attributes"]["COLOR_0"] = 2
    packed = primitive["extensions"]["KHR_draco_mesh_compression"]
    packed["attributes"] = {"POSITION": positions, "COLOR_0": number}
    mesh = load(tmp_path, header, contents).mesh
    np.testing.assert_allclose(mesh.colors[..., :3], 32768 / 65535, atol=1e-6)


def test_a_material_that_nothing_has_may_lack_its_image(tmp_path):
    header, contents = tetrahedron()
    header["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    header["textures"] = [{"source": 0}]
    header["images"] = [{"uri": "nowhere.png"}]
    assert len(load(tmp_path, header, contents).mesh.faces) == 4
    header, contents = tetrahedron()
    header["materials"][0] = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    header["textures"] = [{"source": 0}]
    header["images"] = [{"uri": "nowhere.png"}]
    header["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = 0
    with pytest.raises(DataError, match="nowhere"):
        load(tmp_path, header, contents)
