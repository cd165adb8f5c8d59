"""Reading glTF 2.0: scenes, meshes and physically based materials.

All sets of texture coordinates, sparse values, fractions as whole numbers, transformed textures and
copies of nodes are read, of which libraries read some at most. Sections are those of the
specification (Khronos Group, "glTF 2.0 Specification", 2021). Skins and morph targets are as before
animations; occlusion textures are left out, as light is traced.
"""

from __future__ import annotations

import base64
import json
import logging
import struct
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError, require
from ffpose.render.spacecraft.gltfchecks import check_numbers
from ffpose.render.spacecraft.gltfmaterials import LEFT_OUT, READ, Materials
from ffpose.render.spacecraft.gltftransforms import (
    REST,
    Floats,
    Shape,
    blended,
    cofactors,
    local_transform,
    morphed,
    transforms,
    turned,
)
from ffpose.render.spacecraft.meshassets import MAX_BYTES, Assets, one_line
from ffpose.render.spacecraft.parts import Part, check_shape, unit_normals, used_vertices

logger = logging.getLogger(__name__)

Header = dict[str, Any]

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
"""Extensions of buffer views by which they are compressed."""

KNOWN_EXTENSIONS = {
    *MESHOPT,
    *("KHR_draco_mesh_compression", "KHR_mesh_quantization", "EXT_mesh_gpu_instancing"),
    *("KHR_texture_transform", "EXT_texture_webp", *READ, *LEFT_OUT),
    *("KHR_lights_punctual", "KHR_node_visibility", "KHR_xmp_json_ld"),
}
"""Extensions that are read, that are left out of materials, or that change no surface."""

CORNERS = 3
"""Corners of a triangle."""

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have faces (section 3.7.2.1)."""

SETS = ("TEXCOORD_", "JOINTS_", "WEIGHTS_")
"""Beginnings of the names of attributes of which a primitive may have several."""

CODES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Key(NamedTuple):
    """A primitive in a shape: numbers of mesh and primitive, and the weights of morph targets."""

    mesh: int
    primitive: int
    weights: tuple[float, ...] = ()


class Placed(NamedTuple):
    """A primitive in the scene.

    Attributes:
        key: The primitive, and its shape.
        places: (N, 4, 4) where its copies are, or (J, 4, 4) the joint matrices of its skin.
        skinned: Whether each vertex moves with joints of a skin.
    """

    key: Key
    places: Floats
    skinned: bool = False

    @property
    def copies(self) -> int:
        """How many there are."""
        return 1 if self.skinned else len(self.places)


def read_gltf(content: bytes, assets: Assets, most_faces: int) -> list[Part]:
    """Read the default scene of a .gltf or .glb file of at most so many triangles.

    They are counted before they are read; each may have vertices of its own.

    Raises:
        DataError: The file is no glTF 2.0, is cut short, has a cycle of nodes, too many triangles
            or vertices, or numbers that are not allowed, needs an extension that is not known, or
            refers to a file that is missing or cannot be used.
        MissingExtraError: The file is compressed and the library that reads it is not installed.
    """
    document = _Document(content, assets)
    placed = document.placed(most_faces)
    drawn = sorted({item.key for item in placed})
    document.check_count(document.vertex_count(drawn), CORNERS * most_faces, "vertices")
    shapes = {key: document.shape(key) for key in drawn}
    # What Draco compressed may have more triangles than the document states.
    count = sum(item.copies * len(shapes[item.key]["faces"]) for item in placed)
    document.check_count(count, most_faces, "triangles")
    of = {key: document.primitive(key).get("material") for key in drawn}
    materials = Materials(document.header, set(of.values()), document.image_bytes, assets.source)
    missing = {
        (key.mesh, name)
        for key in drawn
        for source in materials.get(of[key])[1]
        if (name := f"TEXCOORD_{source.set}") not in shapes[key]
    }
    for mesh, name in sorted(missing):
        text = "%s: mesh %d has a texture and no %s: of one color"
        logger.warning(text, assets.source, mesh, name)
    return [
        _part(shapes[item.key], materials, of[item.key], item)
        for item in placed
        if len(shapes[item.key]["faces"])
    ]


def _part(shape: Shape, materials: Materials, number: int | None, item: Placed) -> Part:
    """Return a primitive in its places, with its material and the coordinates of its textures."""
    material, sources = materials.get(number)
    points, layers = shape["POSITION"], []
    for source in sources:
        coordinates = shape.get(f"TEXCOORD_{source.set}", np.zeros((len(points), 2), np.float32))
        layers.append(np.tile(source.transformed(coordinates), (item.copies, 1)))
    places = blended(shape, item.places)[None] if item.skinned else item.places[:, None]
    turns = places[..., :3, :3]
    vertices = turned(points, turns) + places[..., :3, 3]
    mirrored = np.median(np.linalg.det(turns), axis=1)[:, None, None] < 0
    faces = np.where(mirrored, shape["faces"][:, ::-1], shape["faces"])
    faces = faces + len(points) * np.arange(item.copies)[:, None, None]
    normals = shape.get("NORMAL")
    if normals is not None:
        normals = unit_normals(turned(normals.astype(np.float64), cofactors(turns)).reshape(-1, 3))
    colors = shape.get("COLOR_0")
    if colors is not None:  # within 0…1 once all morph targets have moved them (section 3.7.2.1)
        colors = np.pad(colors, ((0, 0), (0, 4 - colors.shape[1])), constant_values=1)
        colors = np.tile(np.nan_to_num(colors).clip(0, 1), (item.copies, 1))
        colors[:, 3] = materials.alphas(number, colors[:, 3])
    vertices, faces = vertices.reshape(-1, 3), faces.reshape(-1, CORNERS)
    return Part(vertices, faces, material, normals, colors, tuple(layers))


class _Document:
    """A glTF file: its header, and what the header refers to."""

    def __init__(self, content: bytes, assets: Assets) -> None:
        self.header, self._chunk = _split(content)
        check_numbers(self.header, KNOWN_EXTENSIONS, assets.source)
        self._assets = assets
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}
        old = isinstance(self.header.get("meshes"), dict)  # which may do without an asset
        version = "1.0" if old else str(self.header["asset"].get("version", "2.0"))
        if not version.startswith("2."):
            raise DataError(f"expected glTF 2.0, got {version}")
        for name in map(str, self.header.get("extensionsRequired", [])):
            if name not in KNOWN_EXTENSIONS:
                text = f"expected glTF extensions that are known, got one that needs {name}"
                raise DataError(text)

    def placed(self, most_faces: int) -> list[Placed]:
        """Return the primitives of the default scene that have faces, from its roots (section 3.5).

        A DataError if all copies together have too many triangles, before they are placed.
        """
        nodes, (places, hidden) = self.header.get("nodes", []), self._places()
        shown = [number for number in places if "mesh" in nodes[number] and number not in hidden]
        copies = Counter[int]()
        for number in shown:
            copies[nodes[number]["mesh"]] += self._copies(nodes[number])
        faces = {mesh: self._face_counts(mesh) for mesh in copies}
        count = sum(times * sum(faces[mesh].values()) for mesh, times in copies.items())
        self.check_count(count, most_faces, "triangles")
        placed, joints = list[Placed](), dict[int, Floats]()
        for number in shown:
            node = nodes[number]
            if not faces[node["mesh"]]:
                continue  # there may be any number of copies of nothing
            mesh = self.header["meshes"][node["mesh"]]
            weights = tuple(node.get("weights", mesh.get("weights", ())))
            where = self._finite(places[number] @ self._instances(node))
            for primitive in faces[node["mesh"]]:
                key = Key(node["mesh"], primitive, weights if any(weights) else ())
                if "skin" in node and "JOINTS_0" in self.primitive(key)["attributes"]:
                    if node["skin"] not in joints:
                        matrices = self._joint_matrices(node["skin"], places)
                        joints[node["skin"]] = self._finite(matrices)
                    placed.append(Placed(key, joints[node["skin"]], True))
                else:
                    placed.append(Placed(key, where))
        return placed

    def check_count(self, count: int, most: int, what: str) -> None:
        """Raise a DataError if there is more of something than there may be."""
        if count > most:
            raise DataError(f"expected at most {most} {what}, got {count}")

    def _finite(self, places: Floats) -> Floats:
        """Return places (N, 4, 4), which must be finite."""
        if not np.isfinite(places).all():
            raise DataError("expected finite places of meshes, got NaN or infinity")
        return places

    def _places(self) -> tuple[dict[int, Floats], set[int]]:
        """Return the places (4, 4) of the default scene's nodes, and which of them are hidden."""
        nodes = self.header.get("nodes", [])
        scenes = self.header.get("scenes")
        if scenes:
            roots = scenes[self.header.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [number for number in range(len(nodes)) if number not in children]
            if nodes and not roots:
                raise DataError("expected a tree of nodes, got a cycle")
        stack = [(number, np.eye(4), False) for number in reversed(roots)]
        places: dict[int, Floats] = {}
        hidden: set[int] = set()
        while stack:
            number, above, unseen = stack.pop()
            if number in places:
                raise DataError(f"expected a tree of nodes, got node {number} in a cycle or twice")
            node = nodes[number]
            shown = node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True)
            if unseen or not shown:
                hidden.add(number)
            place = places[number] = above @ local_transform(node)
            children = reversed(node.get("children", []))
            stack += [(child, place, number in hidden) for child in children]
        return places, hidden

    def _joint_matrices(self, number: int, places: dict[int, Floats]) -> Floats:
        """Return where the joints of a skin take its vertices (J, 4, 4) (section 3.7.3.1)."""
        skin = self.header["skins"][number]
        missing = [joint for joint in skin["joints"] if joint not in places]
        if missing:
            text = f"expected joints of skin {number} in the scene, got node {missing[0]}"
            raise DataError(f"{text}, which is not")
        joints = np.stack([places[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" not in skin:
            return joints
        columns = self.values(skin["inverseBindMatrices"])[: len(joints)]
        if len(columns) < len(joints):
            text = f"expected {len(joints)} bind matrices of skin {number}, got {len(columns)}"
            raise DataError(text)
        return joints @ columns.astype(np.float64).reshape(-1, 4, 4).swapaxes(1, 2)

    def primitive(self, key: Key) -> Header:
        """Return the header of a primitive."""
        found: Header = self.header["meshes"][key.mesh]["primitives"][key.primitive]
        return found

    def _face_counts(self, mesh: int) -> dict[int, int]:
        """Return the numbers of triangles of a mesh's primitives that have any."""
        counts: dict[int, int] = {}
        for number, primitive in enumerate(self.header["meshes"][mesh]["primitives"]):
            mode, attributes = primitive.get("mode", TRIANGLES), primitive["attributes"]
            if "POSITION" in attributes and mode in (TRIANGLES, STRIP, FAN):
                accessor = primitive.get("indices", attributes["POSITION"])
                count = int(self.header["accessors"][accessor]["count"])
                counts[number] = count // 3 if mode == TRIANGLES else count - 2
        return {number: count for number, count in counts.items() if count > 0}

    def vertex_count(self, keys: list[Key]) -> int:
        """Return the number of vertices of primitives: values of their longest attributes."""
        counts: dict[tuple[Any, ...], int] = {}
        for key in keys:
            attributes = self.primitive(key)["attributes"]
            all_of_them = [attributes, *(target for _, target in self._targets(key))]
            numbers = [number for each in all_of_them for number in each.values()]
            longest = max(self.header["accessors"][number]["count"] for number in numbers)
            # Primitives may share their vertices, where no morph target moves them.
            place = key if key.weights else (attributes["POSITION"],)
            counts[place] = max(counts.get(place, 0), longest)
        return sum(counts.values())

    def _targets(self, key: Key) -> list[tuple[float, dict[str, int]]]:
        """Return the weight and the attributes of each morph target whose weight is not zero."""
        targets = self.primitive(key).get("targets", [])
        if key.weights and targets and len(key.weights) != len(targets):
            text = f"expected weights of {len(targets)} morph targets, got {len(key.weights)}"
            raise DataError(text)
        pairs = zip(key.weights, targets, strict=False)
        return [(float(weight), each) for weight, each in pairs if weight != 0]

    def shape(self, key: Key) -> Shape:
        """Read a primitive: its faces (F, 3), and by name the attributes of vertices they use."""
        primitive = self.primitive(key)
        packed = self._decoded(primitive, key.mesh)
        shape = {}
        for name, number in primitive["attributes"].items():
            if name in ("POSITION", "NORMAL", "COLOR_0") or name.startswith(SETS):
                normalized = bool(self.header["accessors"][number].get("normalized"))
                shape[name] = (
                    _fractions(packed[name], normalized) if name in packed else self.values(number)
                )
        shape["POSITION"] = shape["POSITION"].astype(np.float64)
        for name, values in shape.items():
            if len(values) != len(shape["POSITION"]):
                text = f"expected {len(shape['POSITION'])} values of {name}, got {len(values)}"
                raise DataError(text)
        for weight, target in self._targets(key):
            for name in shape.keys() & target.keys():
                if name.startswith(("JOINTS_", "WEIGHTS_")):
                    continue  # which have no targets
                deltas = self.values(target[name])
                if len(deltas) != len(shape[name]):
                    text = f"expected {len(shape[name])} values of {name} in a morph target"
                    raise DataError(f"{text}, got {len(deltas)}")
                shape[name] = morphed(name, shape[name], deltas, weight)
        points = shape["POSITION"]
        if "faces" in packed:
            faces = packed["faces"]
        else:
            order = np.arange(len(points))
            if "indices" in primitive:
                order = self.values(primitive["indices"])[:, 0]
            if primitive.get("mode", TRIANGLES) == TRIANGLES and len(order) % CORNERS:
                text = f"expected triangles of {CORNERS} corners, got {len(order)} corners"
                raise DataError(text)
            faces = _triangles(order, primitive.get("mode", TRIANGLES))
        check_shape(points, faces)
        used, faces = used_vertices(faces, len(points))
        return {name: values[used] for name, values in shape.items()} | {"faces": faces}

    def _decoded(self, primitive: Header, mesh: int) -> Shape:
        """Return the faces and attributes that Draco compressed."""
        header = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if header is None:
            return {}
        draco = require("DracoPy", "render")
        content = self.view(header["bufferView"])
        try:
            found = draco.decode(content)
            values = {each["unique_id"]: np.asarray(each["data"]) for each in found.attributes}
            shape = {
                name: self._narrowed(values[number], primitive["attributes"][name])
                for name, number in header["attributes"].items()
            }
            return shape | {"faces": np.asarray(found.faces).reshape(-1, 3)}
        except Exception as error:  # DracoPy has exceptions of its own, and others for what lacks
            name = self.header["meshes"][mesh].get("name", mesh)
            text = f"expected Draco data of mesh {name!r} that can be decoded"
            raise DataError(f"{text}, got {one_line(error)}") from error

    def _narrowed(self, values: NDArray[Any], accessor: int) -> NDArray[Any]:
        """Return whole numbers that Draco decoded in the type that they have without it.

        DracoPy gives those of 16 bits in 32, which normalized ones are fractions of.
        """
        code = CODES[self.header["accessors"][accessor]["componentType"]]
        return values.astype(code) if values.dtype.kind == "u" else values

    def buffer(self, number: int) -> bytes:
        """Return a buffer: in the file, or beside it."""
        if number not in self._buffers:
            entry = self.header["buffers"][number]
            content = self.resource(entry["uri"]) if "uri" in entry else self._chunk
            if len(content) < entry["byteLength"]:
                text = f"expected a buffer of {entry['byteLength']} bytes, got {len(content)}"
                raise DataError(text)
            self._buffers[number] = content
        return self._buffers[number]

    def resource(self, uri: str) -> bytes:
        """Return what a URI names: a file, or the data that it consists of."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition("base64,")[2])
        return self._assets.get(uri)

    def view(self, number: int) -> bytes:
        """Return the bytes of a buffer view, decompressed where the file requires that."""
        if number not in self._views:
            view = self.header["bufferViews"][number]
            required = set(MESHOPT).intersection(self.header.get("extensionsRequired", []))
            packed = [view["extensions"][n] for n in required if n in view.get("extensions", {})]
            self._views[number] = (
                self._unpacked(packed[0], view["byteLength"]) if packed else self._slice(view)
            )
        return self._views[number]

    def _slice(self, view: Header) -> bytes:
        """Return the part of a buffer that a buffer view or its compression names."""
        start = view.get("byteOffset", 0)
        content = self.buffer(view["buffer"])[start : start + view["byteLength"]]
        if len(content) < view["byteLength"]:
            raise DataError(f"expected {view['byteLength']} bytes of a buffer, got {len(content)}")
        return content

    def _unpacked(self, packed: Header, length: int) -> bytes:
        """Return what meshoptimizer compressed."""
        meshopt = require("meshopt", "meshopt")
        count, stride = packed["count"], packed["byteStride"]
        if count * stride != length:
            text = f"expected {length} bytes in a compressed buffer, got {count} times {stride}"
            raise DataError(text)
        if length > MAX_BYTES:
            text = f"expected at most {MAX_BYTES} bytes in a compressed buffer, got {length}"
            raise DataError(text)
        content, kind = self._slice(packed), packed.get("filter")
        found: bytes = meshopt.decode_gltf_buffer(
            content, count, stride, packed["mode"], kind
        ).tobytes()
        return found

    def image_bytes(self, number: int) -> tuple[bytes, str]:
        """Return an image, and its name for an error."""
        image = self.header["images"][number]
        if "uri" in image:
            uri = image["uri"]
            return self.resource(uri), str(number) if uri.startswith("data:") else repr(uri)
        return self.view(image["bufferView"]), str(number)

    def values(self, number: int) -> NDArray[Any]:
        """Return the values (N, K) of an accessor, of which sparse ones replace some (3.6.2)."""
        accessor = self.header["accessors"][number]
        count, width, code = accessor["count"], WIDTHS[accessor["type"]], accessor["componentType"]
        values = np.zeros((count, width), CODES[code])
        if "bufferView" in accessor:
            values = self._elements(accessor, count, width, code)
        if "sparse" in accessor:
            sparse, values = accessor["sparse"], values.copy()
            where, count = sparse["indices"], sparse["count"]
            places = self._elements(where, count, 1, where["componentType"])
            values[places[:, 0]] = self._elements(sparse["values"], count, width, code)
        return _fractions(values, bool(accessor.get("normalized")))

    def _elements(self, at: Header, count: int, width: int, code: int) -> NDArray[Any]:
        """Return values (count, width) that stand in a buffer view."""
        kind, view = np.dtype(CODES[code]), self.header["bufferViews"][at["bufferView"]]
        steps = view.get("byteStride") or width * kind.itemsize, kind.itemsize
        content, start = self.view(at["bufferView"]), at.get("byteOffset", 0)
        values: NDArray[Any] = np.ndarray((count, width), kind, content, start, steps)
        return values

    def _copies(self, node: Header) -> int:
        """Return how often a node shows its mesh; a DataError if its attributes disagree."""
        counts = {self.header["accessors"][n]["count"] for n in _instancing(node).values()}
        if len(counts) > 1:
            text = "expected as many values of each attribute of a mesh's copies"
            got = " and ".join(map(str, sorted(counts)))
            raise DataError(f"{text}, got {got}")
        return int(counts.pop()) if counts else 1

    def _instances(self, node: Header) -> Floats:
        """Return the places (N, 4, 4) of a node's mesh in the node, which an extension repeats."""
        numbers = _instancing(node)
        given = {name: self.values(numbers[name]) for name in REST if name in numbers}
        return transforms(given, self._copies(node))


def _instancing(node: Header) -> dict[str, int]:
    """Return the attributes of a node's copies of its mesh; none where a skin places it."""
    extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if extension is None or "skin" in node:
        return {}
    return {name.lower(): number for name, number in extension["attributes"].items()}


def _triangles(order: NDArray[Any], mode: int) -> NDArray[Any]:
    """Return the triangles (F, 3) of a primitive's vertices in order (section 3.7.2.1)."""
    if mode == TRIANGLES:
        return order.reshape(-1, 3)
    if mode == FAN:  # all begin at its first vertex
        return np.stack([order[1:-1], order[2:], np.full(len(order) - 2, order[0])], axis=1)
    faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    faces[1::2] = faces[1::2, ::-1]
    return faces


def _split(content: bytes) -> tuple[Header, bytes]:
    """Return header and binary chunk of a .glb file, or the header that a .gltf file is."""
    if content[:4] != b"glTF":
        header = json.loads(content)
        return header, b""
    _, size, length = struct.unpack_from("<III", content, 4)
    if size > len(content):
        raise ValueError(f"expected {size} bytes, got {len(content)}: the file is cut short")
    header = json.loads(content[20 : 20 + length])
    return header, content[20 + length + 8 :]


def _fractions(values: NDArray[Any], normalized: bool) -> NDArray[Any]:
    """Return whole numbers that stand for 0…1 or −1…1 as such (section 3.6.2.2)."""
    if not normalized or values.dtype.kind == "f":
        return values
    return np.maximum(values / np.float32(np.iinfo(values.dtype).max), -1).astype(np.float32)
