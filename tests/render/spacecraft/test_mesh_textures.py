"""Meshes with materials and textures: their colors, what identifies them, and what is refused."""

import base64
import io
import json
import weakref

import numpy as np
import pytest
from PIL import Image, ImageFile

import glb
from ffpose.datasets.patches import digest
from ffpose.errors import DataError
from ffpose.imaging.patches import PatchSpec
from ffpose.render import SCENES, Scene, load_craft, render, render_layers, write_dataset
from ffpose.render.patches import describe
from ffpose.render.shading.maps import Maps

RED, BLUE = (200, 0, 0), (0, 40, 240)
CODES = 1
"""Rounding."""

CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]] * 2, np.float32)
CORNERS[4:, 2] = 0.5
QUADS = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.uint32)
LEFT = np.array([[0.05, 0.1], [0.45, 0.1], [0.45, 0.9], [0.05, 0.9]], np.float32)
PLACES = np.concatenate([LEFT, LEFT + np.float32([0.5, 0])])
"""Texture coordinates of two quads: the left half of the texture, and the right one."""


def png(pixels):
    file = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
    return file.getvalue()


HALVES = png(np.repeat([[RED, BLUE]], 4, axis=0).repeat(4, axis=1))


def gltf_parts(colors=None, factor=None, textured=True):
    """Header without buffers and images, and the buffer's bytes: positions, faces, places."""
    blobs = [CORNERS.tobytes(), QUADS.tobytes(), PLACES.tobytes()]
    attributes = {"POSITION": 0, "TEXCOORD_0": 2}
    accessors = [
        {"componentType": 5126, "count": 8, "type": "VEC3"},
        {"componentType": 5125, "count": 12, "type": "SCALAR"},
        {"componentType": 5126, "count": 8, "type": "VEC2"},
    ]
    if colors is not None:
        blobs.append(np.tile(np.array(colors, np.float32), (8, 1)).tobytes())
        attributes["COLOR_0"] = 3
        accessors.append({"componentType": 5126, "count": 8, "type": "VEC3"})
    starts = np.cumsum([0, *map(len, blobs)])
    paint = {} if factor is None else {"baseColorFactor": [*factor, 1.0]}
    if textured:
        paint["baseColorTexture"] = {"index": 0}
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": paint, "doubleSided": True}],
        "textures": [{"source": 0}],
        "accessors": [{**each, "bufferView": n} for n, each in enumerate(accessors)],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(start), "byteLength": len(blob)}
            for start, blob in zip(starts, blobs, strict=False)
        ],
    }
    return header, b"".join(blobs)


def data_uri(content, kind):
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def write_gltf(folder, texture=HALVES, **parts):
    """Write ``quads.gltf`` with its buffer and its texture beside it."""
    header, blob = gltf_parts(**parts)
    header["buffers"] = [{"uri": "quads.bin", "byteLength": len(blob)}]
    header["images"] = [{"uri": "two%20halves.png"}]
    (folder / "quads.bin").write_bytes(blob)
    (folder / "two halves.png").write_bytes(texture)
    path = folder / "quads.gltf"
    path.write_text(json.dumps(header))
    return path


def write_embedded(folder, texture=HALVES, **parts):
    """Write ``quads.gltf`` as one file."""
    header, blob = gltf_parts(**parts)
    header["buffers"] = [
        {"uri": data_uri(blob, "application/octet-stream"), "byteLength": len(blob)}
    ]
    header["images"] = [{"uri": data_uri(texture, "image/png")}]
    path = folder / "quads.gltf"
    path.write_text(json.dumps(header))
    return path


def write_glb(folder, texture=HALVES, **parts):
    """Write ``quads.glb``, with its texture inside."""
    header, blob = gltf_parts(**parts)
    header["images"] = [{"bufferView": len(header["bufferViews"]), "mimeType": "image/png"}]
    header["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(texture)})
    chunk = blob + texture
    chunk += bytes(-len(chunk) % 4)
    header["buffers"] = [{"byteLength": len(chunk)}]
    return glb.write_glb(folder / "quads.glb", header, chunk)


def write_obj(folder, texture=HALVES, paint="map_Kd -s 1 1 1 two.png"):
    """Write ``quads.obj`` with its materials and its texture beside it."""
    lines = ["# café", "mtllib quads.mtl"]
    lines += [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"vt {u} {1 - v}" for u, v in PLACES]
    lines += ["usemtl paint"]
    lines += ["f " + " ".join(f"{n + 1}/{n + 1}" for n in face) for face in QUADS]
    path = folder / "quads.obj"
    path.write_bytes("\n".join(lines).encode("latin-1"))
    (folder / "quads.mtl").write_bytes(f"# é\nnewmtl paint\n{paint}\n".encode("latin-1"))
    (folder / "two.png").write_bytes(texture)
    return path


def linear(codes):
    value = np.asarray(codes) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def codes(light):
    value = np.asarray(light)
    return 255 * np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def face_codes(craft):
    """The sRGB color of each face: the mean of its textures, times factor and vertex colors."""
    light = np.array([craft.materials[number].color for number in craft.mesh.material])
    if any(material.color_map for material in craft.materials):
        light = light * Maps(craft).means["color_map"][:, :3]
    if craft.mesh.colors is not None:
        light = light * craft.mesh.colors[..., :3].mean(axis=1)
    return codes(light)


WRITERS = {"gltf": write_gltf, "embedded": write_embedded, "glb": write_glb, "obj": write_obj}


@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
def test_a_face_has_the_color_of_its_texture(tmp_path, writer):
    craft = load_craft(writer(tmp_path), scale=2.0)
    np.testing.assert_allclose(craft.mesh.vertices[:4], 2 * CORNERS[:4])
    assert len(craft.mesh.faces) == 4
    np.testing.assert_allclose(face_codes(craft), [RED, RED, BLUE, BLUE], atol=CODES)


@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
def test_a_faces_color_is_the_mean_of_the_light_over_it(tmp_path, writer):
    """Half of the light of white is code 188, not 128; palettes and gray images are read too."""
    board = Image.open(io.BytesIO(png(np.indices((64, 64)).sum(axis=0) % 2 * 255))).convert("P")
    file = io.BytesIO()
    board.save(file, "PNG")
    shown = face_codes(load_craft(writer(tmp_path, texture=file.getvalue())))
    np.testing.assert_allclose(shown, 188, atol=CODES + 3)


def test_gltfs_factor_and_vertex_color_multiply_its_texture(tmp_path):
    factor, tint = (0.5, 1.0, 0.25), (1.0, 0.5, 0.5)
    craft = load_craft(write_glb(tmp_path, factor=factor, colors=tint))
    light = linear([RED, RED, BLUE, BLUE]) * factor * tint
    np.testing.assert_allclose(face_codes(craft), codes(light), atol=CODES)
    plain = load_craft(write_glb(tmp_path, factor=factor, textured=False))
    np.testing.assert_allclose(face_codes(plain), codes([factor] * 4), atol=CODES)


@pytest.mark.parametrize(
    ("paint", "light"),
    [
        ("Kd 0.8 0.2 0.4", linear([[204, 51, 102]] * 4)),  # as an sRGB color
        ("Kd 0.5 0.5 0.5\nmap_Kd two.png", linear([RED, RED, BLUE, BLUE]) * linear(127.5)),
        ("Kd 0 0 0\nmap_Kd two.png", linear([RED, RED, BLUE, BLUE])),
        ("map_Kd C:\\work\\two.png", linear([RED, RED, BLUE, BLUE])),
    ],
)
def test_an_mtl_files_color_and_texture(tmp_path, paint, light):
    craft = load_craft(write_obj(tmp_path, paint=paint))
    np.testing.assert_allclose(face_codes(craft), codes(light), atol=CODES)


@pytest.mark.parametrize(
    ("paint", "field", "value"),
    [
        ("Ks 0.5 0.25 1", "reflectance", (0.04, 0.02, 0.08)),  # one stands for 8 %
        ("Ks 0.5 0.25 1 # shiny", "reflectance", (0.04, 0.02, 0.08)),
        ("Ks 0.5", "reflectance", (0.04, 0.04, 0.04)),  # one number stands for three
        ("Ka 0.2\nKe 2 1 0.5 1", "emission", (2, 1, 0.5)),
        ("Ns 30", "roughness", 0.5),  # the fourth root of 2 / (30 + 2)
        ("Ns 30\nPr 0.3", "roughness", 0.3),
        ("Pm 0.75", "metallic", 0.75),
        ("Ke 2 1 0.5", "emission", (2, 1, 0.5)),
        ("map_Ke two.png", "emission", (1, 1, 1)),  # Blender writes no Ke beside a texture
        ("d 0.25", "alpha", 0.25),
        ("Tr 0.75", "alpha", 0.25),
        ("Tr 1.000000\nillum 2\nNs 0.000000", "alpha", 1),  # MeshLab's, of NASA's Hubble
        ("d 0.000000\nillum 2\nmap_Kd two.png", "alpha", 1),  # Blender's, of NASA's Juno
        ("d 0", "alpha", 0),
    ],
)
def test_an_mtl_files_numbers(tmp_path, paint, field, value):
    (material,) = load_craft(write_obj(tmp_path, paint=paint)).materials
    assert getattr(material, field) == pytest.approx(value)


def test_an_mtl_files_textures_of_roughness_and_emission(tmp_path):
    """Code 102 stands for a roughness of 0.4, and for 13.29 % of the light."""
    paint = "Pm 0.75\nPr 0.1\nmap_Pr two.png\nKe 1 0.5 1\nmap_Ke two.png"
    craft = load_craft(write_obj(tmp_path, texture=png(np.full((4, 4), 102)), paint=paint))
    (material,) = craft.materials
    assert (material.roughness, material.metallic, material.emission) == (1, 0.75, (1, 0.5, 1))
    means = Maps(craft).means
    np.testing.assert_allclose(means["roughness_map"][:, 1:3], [[0.4, 1]] * 4, atol=1e-3)
    np.testing.assert_allclose(means["emission_map"][:, :3], 0.1329, atol=1e-3)


def test_an_mtl_files_textures_that_are_left_out_are_told(tmp_path, caplog):
    path = write_obj(tmp_path, paint="map_Bump -bm 0.5 two.png\nmap_d two.png\nrefl two.png")
    load_craft(path)
    left_out = "map_bump, map_d, refl"
    assert caplog.messages == [f"{path}: textures of materials are left out: {left_out}"]


def test_a_texture_is_seen_in_the_image(tmp_path):
    craft = load_craft(write_glb(tmp_path, texture=png(np.full((4, 4, 3), (20, 220, 20)))))
    scene = Scene("quads", craft, (4.0, 4.0), 0.5, eclipse_rate=0.0)
    frame, layers = render(scene, 0, 1, (64, 48)), render_layers(scene, 0, 1, (64, 48))
    red, green, blue = frame.image[layers.mask].mean(axis=0)
    assert green > 1.5 * max(red, blue)


@pytest.mark.parametrize(
    ("writer", "name"),
    [
        (write_gltf, "quads.bin"),
        (write_gltf, "two halves.png"),
        (write_obj, "quads.mtl"),
        (write_obj, "two.png"),
    ],
)
def test_every_file_that_a_mesh_refers_to_identifies_it(tmp_path, writer, name):
    """In the manifest and in the key of cached views."""
    path = writer(tmp_path)
    (tmp_path / "notes.txt").write_text("of no importance")
    spec = PatchSpec(SCENES["soyuz_easy"].camera.resized(64, 48), 4, 32, 6.6)

    def identity():
        scene = Scene("quads", load_craft(path), (4.0, 9.0), 5.0)
        return scene, digest(describe(scene, 0, spec, "object"))

    scene, key = identity()
    write_dataset(scene, tmp_path / "set", 1, size=(32, 24))
    (tmp_path / "notes.txt").write_text("of none either")
    assert identity()[1] == key
    file = tmp_path / name
    changes = {
        ".png": lambda: file.write_bytes(png(np.full((2, 2, 3), 90))),
        ".bin": lambda: file.write_bytes((CORNERS * 2).tobytes() + file.read_bytes()[96:]),
        ".mtl": lambda: file.write_text("newmtl paint\nKd 0.1 0.2 0.3\n"),
    }
    changes[file.suffix]()
    other, changed = identity()
    assert changed != key
    with pytest.raises(ValueError, match=r"expected the same set as before, got scene\.craft"):
        write_dataset(other, tmp_path / "set", 1, size=(32, 24))


def refused(path, text):
    """Expect one line that names the file and says what was wrong."""
    with pytest.raises(DataError, match=text) as met:
        load_craft(path)
    assert "\n" not in str(met.value)


@pytest.mark.parametrize(
    ("writer", "name"),
    [
        (write_gltf, "quads.bin"),
        (write_gltf, "two halves.png"),
        (write_obj, "quads.mtl"),
        (write_obj, "two.png"),
    ],
)
def test_a_file_that_is_missing_is_named(tmp_path, writer, name):
    path = writer(tmp_path)
    (tmp_path / name).unlink()
    named = name.replace(" ", "(%20| )")
    refused(path, rf"quads\.\w+: expected '.*{named}', which it refers to, got no such file")


@pytest.mark.parametrize("lines", ["mtllib quads.mtl two.mtl", "mtllib quads.mtl\nmtllib two.mtl"])
def test_an_obj_file_has_several_mtl_files(tmp_path, lines):
    path = write_obj(tmp_path, paint="Kd 1 0 0")
    (tmp_path / "two.mtl").write_text("newmtl other\nKd 0 0 1\n")
    text = path.read_bytes().replace(b"mtllib quads.mtl", lines.encode())
    path.write_bytes(text + b"\nusemtl other\nf 1 2 3\n")
    colors = {material.color for material in load_craft(path).materials}
    assert colors == {(1, 0, 0), (0, 0, 1)}
    (tmp_path / "two.mtl").unlink()
    refused(path, "expected '.*two.mtl', which it refers to, got no such file")


def test_without_its_mtl_file_an_obj_file_says_how_to_do_without(tmp_path, caplog):
    """What its error says leads on: without the line the mesh is gray, and a warning says so."""
    path = tmp_path / "triangle.obj"
    lines = ["mtllib none.mtl", "usemtl gold", "v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 3"]
    path.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"'none\.mtl'.*delete the line that names it"):
        load_craft(path)
    path.write_text("\n".join(lines[1:]))
    red, green, blue = load_craft(path).materials[0].color
    assert red == green == blue
    assert "triangle.obj: no MTL file has 'gold': gray" in caplog.text


def test_a_material_that_no_mtl_file_has_is_told(tmp_path, caplog):
    (tmp_path / "paint.mtl").write_text("newmtl red paint\nKd 1 0 0\n")
    path = tmp_path / "triangles.obj"
    path.write_text(
        "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"
        "usemtl red paint\nf 1 2 3\nusemtl Red Paint\nf 1 3 2\n"
    )
    load_craft(path)
    assert caplog.messages == [f"{path}: no MTL file has 'Red Paint': gray"]


def test_textures_of_materials_that_an_obj_file_does_not_use_may_be_missing(tmp_path):
    """Files that several meshes share, and leftovers of a drawing, have such materials."""
    path = write_obj(tmp_path)
    colors, paints = face_codes(load_craft(path)), tmp_path / "quads.mtl"
    other = b"newmtl other\nmap_Kd gone.png\n"
    paints.write_bytes(other + paints.read_bytes() + b"newmtl last one\nmap_Kd gone.png\n")
    np.testing.assert_array_equal(face_codes(load_craft(path)), colors)
    path.write_bytes(path.read_bytes() + b"\nusemtl last  one\nf 1 2 3\n")
    refused(path, "expected 'gone.png', which it refers to, got no such file")


@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("damage", [b"no image", HALVES[:-30]], ids=["text", "cut"])
def test_a_texture_that_cannot_be_decoded_is_refused(tmp_path, writer, damage):
    refused(writer(tmp_path, texture=damage), "expected .*texture.* that can be decoded, got ")


def paint_gltf(folder, count):
    """Write a file of so many materials of color and roughness, each with a texture of its own."""
    path, numbers = write_gltf(folder), range(count)
    header = json.loads(path.read_text())
    (primitive,) = header["meshes"][0]["primitives"]
    header["meshes"][0]["primitives"] = [{**primitive, "material": n} for n in numbers]
    header["images"] = [{"uri": f"{n}.png"} for n in numbers]
    header["textures"] = [{"source": n} for n in numbers]
    slots = ("baseColorTexture", "metallicRoughnessTexture")
    header["materials"] = [
        {"pbrMetallicRoughness": {slot: {"index": n} for slot in slots}} for n in numbers
    ]
    path.write_text(json.dumps(header))
    return path


def paint_obj(folder, count):
    """Write a file of so many materials of color and roughness, each with a texture of its own."""
    path = write_obj(folder)
    before, _, faces = path.read_text("latin-1").partition("usemtl paint\n")
    path.write_text(before + "".join(f"usemtl {n}\n{faces}\n" for n in range(count)), "latin-1")
    (folder / "quads.mtl").write_text(
        "".join(f"newmtl {n}\nmap_Kd {n}.png\nmap_Pr {n}.png\n" for n in range(count))
    )
    return path


@pytest.mark.parametrize("writer", [paint_gltf, paint_obj], ids=["gltf", "obj"])
def test_one_image_at_a_time_is_decoded(tmp_path, writer, monkeypatch):
    """Decoded, twenty textures of 8192 x 8192 would take 5 GB."""
    for number in range(6):
        pixels = np.random.default_rng(number).integers(0, 256, (64, 64, 3))
        (tmp_path / f"{number}.png").write_bytes(png(pixels))
    path, images, alive, load = writer(tmp_path, 6), [], [], ImageFile.ImageFile.load

    def counted(image):
        pixels = load(image)
        images.append(weakref.ref(image))
        alive.append(len({id(each()) for each in images if each() is not None}))
        return pixels

    monkeypatch.setattr(ImageFile.ImageFile, "load", counted)
    materials = load_craft(path).materials
    assert len({texture.image for material in materials for texture in material.maps}) == 12
    assert set(alive) == {1}


def test_gltf_that_is_none_or_needs_what_is_not_known_is_refused(tmp_path):
    path = write_gltf(tmp_path)
    header = json.loads(path.read_text())
    needed = ["KHR_materials_unlit", "ACME_curved_space"]
    path.write_text(json.dumps({**header, "extensionsRequired": needed}))
    refused(path, "expected glTF extensions that are known, got one that needs ACME_curved_space")
    for text in ("{", "[]", '{"images": [{}]}', '{"asset": 3}', '{"asset": {}, "nodes": 3}'):
        path.write_text(text)
        refused(path, r"quads\.gltf: expected a glTF document, got (\w+Error|one without 'asset')")
    old = {"meshes": {"body": {}}, "nodes": {}}
    for document in ({**header, "asset": {"version": "1.0"}}, old, {**old, "asset": {}}):
        path.write_text(json.dumps(document))
        refused(path, "expected glTF 2.0, got 1.0")


def test_a_file_outside_of_the_meshs_folder_is_not_read(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.png").write_bytes(HALVES)
    path = write_gltf(inner)
    header = json.loads(path.read_text())
    for name in ("../secret.png", str(tmp_path / "secret.png")):
        path.write_text(json.dumps({**header, "images": [{"uri": name}]}))
        refused(path, r"expected files in its folder, got '.*secret\.png', which is outside")


def test_a_file_that_is_cut_short_is_refused(tmp_path):
    path = write_glb(tmp_path)
    path.write_bytes(path.read_bytes()[:-300])
    refused(path, r"quads\.glb: expected .* bytes, got \d+")
    path = write_gltf(tmp_path)
    (tmp_path / "quads.bin").write_bytes((tmp_path / "quads.bin").read_bytes()[:-40])
    refused(path, r"quads\.gltf: expected a buffer of 208 bytes, got 168")


def test_a_cycle_of_nodes_and_endless_copies_are_refused(tmp_path, monkeypatch):
    path = write_gltf(tmp_path)
    header = json.loads(path.read_text())
    nodes = [{"children": [1]}, {"mesh": 0, "children": [0]}]
    path.write_text(json.dumps({**header, "nodes": nodes}))
    refused(path, "expected a tree of nodes, got node 0 in a cycle or twice")
    monkeypatch.setattr("ffpose.render.spacecraft.meshfile.MAX_FACES", 4000)
    many = [{"children": list(range(1, 1002))}, *({"mesh": 0} for _ in range(1001))]
    path.write_text(json.dumps({**header, "nodes": many}))
    refused(path, "expected at most 4000 triangles, got 4004")


@pytest.mark.parametrize("writer", [write_gltf, write_glb])
def test_texture_coordinates_that_are_no_numbers_are_refused(tmp_path, writer, monkeypatch):
    monkeypatch.setitem(globals(), "PLACES", np.full_like(PLACES, np.nan))
    refused(writer(tmp_path), "expected finite texture coordinates")
