"""Parts of .obj, .ply and .stl files, as trimesh reads them: colors, MTL materials and textures.

Colors of faces, vertices and MTL files are sRGB, as textures are. A surface has two sides.
"""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose._internal.signals import signals_kept
from ffpose.errors import DataError, require
from ffpose.render.spacecraft.gltfmaterials import color_of, normals_of, three, values_of
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material, Texture
from ffpose.render.spacecraft.meshassets import Assets, one_line, open_image
from ffpose.render.spacecraft.meshchecks import checked
from ffpose.render.spacecraft.mtloptions import texture_options
from ffpose.render.spacecraft.parts import Part, check_shape
from ffpose.render.spacecraft.pyramids import Key, Pyramids
from ffpose.render.spacecraft.stlcolors import stl_colors
from ffpose.render.spacecraft.textures import CLAMP, REPEAT, Source, linear

logger = logging.getLogger(__name__)

ROUGHNESS = 0.55
"""Roughness of what has no material."""


def _rough(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return codes as roughness, of what is as metallic as its factor."""
    values = values_of(codes)
    values[..., 2] = 1
    return values


CONVERTS = {
    "map_kd": color_of("BLEND", None),
    "map_ke": color_of("OPAQUE", None),
    "map_pr": _rough,
}
"""What turns codes into values, by the field of a texture; those of normals have options."""

TEXTURES = {*CONVERTS, "norm"}
"""Fields of textures that are read."""

OTHERS = ("bump", "decal", "disp", "refl")
"""Fields of textures that are not, beside those that begin with ``map_``."""

DIELECTRIC = 0.08
"""Reflectance that an MTL file's ``Ks`` of one stands for; a half is that of paint."""


def read_trimesh(content: bytes, suffix: str, assets: Assets) -> list[Part]:
    """Read the parts of a file of a format such as ``".obj"``.

    A DataError if it is broken, or refers to a file that is missing or cannot be used.
    """
    trimesh = require("trimesh", "render")
    source, log = assets.source, logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)  # errors are told here, once
    try:
        content = checked(content, suffix, assets)
        file = io.BytesIO(content)
        with signals_kept():  # trimesh goes on after whatever is raised while it reads
            scene = trimesh.load(file, suffix[1:], resolver=assets, force="scene", process=False)
        # A .obj, .ply or .stl file has no transforms: every geometry is in its place.
        meshes = [each for each in scene.geometry.values() if isinstance(each, trimesh.Trimesh)]
        meshes = [mesh for mesh in meshes if len(mesh.faces)]
        for mesh in meshes:
            _check(mesh, assets)
        paints = _Paints(meshes, assets)
        parts = [_part(mesh, paints, content) for mesh in meshes]
    except DataError:
        raise
    except Exception as error:  # a broken file makes the readers raise anything
        problem = assets.problems[0] if assets.problems else None
        text = f"expected a triangle mesh, got {one_line(error)}"
        raise problem or DataError(text, source) from error
    finally:
        log.setLevel(level)
    if assets.problems:
        raise assets.problems[0]
    unknown = sorted(name.decode(errors="replace") for name in assets.used - assets.defined)
    if unknown:
        logger.warning("%s: no MTL file has %s: gray", source, ", ".join(map(repr, unknown)))
    return parts


def _check(mesh: Any, assets: Assets) -> None:
    """Raise a DataError unless a mesh is triangles between finite vertices."""
    points, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if points.shape[1:] != (3,) or faces.shape[1:] != (3,):
        got = f"{points.shape[1]} and {faces.shape[1]}"
        raise DataError(f"expected 3 coordinates and 3 corners, got {got}", assets.source)
    check_shape(points, faces, assets.source)


def _part(mesh: Any, paints: _Paints, content: bytes) -> Part:
    visual = mesh.visual
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    normals = None
    if "vertex_normals" in mesh._cache.cache:
        given = np.asarray(mesh.vertex_normals, np.float32)
        length = np.linalg.norm(given, axis=1, keepdims=True)
        normals = np.where(length > 1e-6, given / np.maximum(length, 1e-6), np.nan)
    if visual.kind == "texture":
        material, sources = paints.get(visual.material)
        layers: list[NDArray[np.float32]] = []
        if sources:
            uv = np.zeros((len(vertices), 2)) if visual.uv is None else np.asarray(visual.uv)
            if visual.uv is None:
                paints.miss(visual.material)
            places = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)
            layers = [source.transformed(places) for source in sources]
        colors = visual.vertex_attributes.get("color")
        light = None if colors is None else _light(colors)
        return Part(vertices, faces, material, normals, light, tuple(layers))
    plain = Material((1.0, 1.0, 1.0), ROUGHNESS)
    if visual.kind == "vertex":
        return Part(vertices, faces, plain, normals, _light(visual.vertex_colors))
    colors = visual.face_colors
    codes = mesh.face_attributes.get("stl")  # of a binary file alone
    if codes is not None:
        found = stl_colors(content[:80], codes, colors[0])
        colors = colors if found is None else found
    return Part(vertices, faces, plain, normals, _light(colors)[:, None])


def _light(codes: ArrayLike) -> NDArray[np.float32]:
    """Return sRGB codes (N, 3 or 4) as linear colors (N, 4) without transparency."""
    values = np.asarray(codes)
    top = np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else 1
    light = np.ones((len(values), 4), np.float32)
    light[:, :3] = linear(np.clip(values[:, :3] / top, 0, 1))
    return light


class _Paints:
    """The materials of an MTL file; textures that are left out are told."""

    def __init__(self, meshes: list[Any], assets: Assets) -> None:
        self._assets = assets
        self._made: dict[int, tuple[Material, tuple[Source, ...]]] = {}
        self._unnamed: list[Any] = []
        textured = [mesh.visual.material for mesh in meshes if mesh.visual.kind == "texture"]
        self._given = {id(material): _simple(material) for material in textured}
        self._names = {number: self._named(each) for number, each in self._given.items()}
        used = [pair for names in self._names.values() for pair in names.items()]
        self._options = {
            name: texture_options(str(name), assets.source)
            for name in dict.fromkeys(name for _, name in used)
        }
        keys = [self._key(field, name) for field, name in used]
        self._pyramids = Pyramids(keys, self._opened, assets.source)
        fields = {field for material in self._given.values() for field in material.kwargs}
        left_out = sorted(f for f in fields - TEXTURES if f.startswith("map_") or f in OTHERS)
        if left_out:
            text = "%s: textures of materials are left out: %s"
            logger.warning(text, assets.source, ", ".join(left_out))

    def get(self, material: Any) -> tuple[Material, tuple[Source, ...]]:
        """Return a material as the renderer has them, and the sources of its textures."""
        number = id(material)
        if number not in self._made:
            self._made[number] = self._make(self._given[number], self._names[number])
        return self._made[number]

    def miss(self, material: Any) -> None:
        """Warn of a texture without coordinates, of which one point colors everything."""
        text = "%s: material %r has a texture and no texture coordinates: of one color"
        logger.warning(text, self._assets.source, material.name)

    def _make(
        self, material: Any, names: dict[str, str | int]
    ) -> tuple[Material, tuple[Source, ...]]:
        sources: dict[Source, int] = {}
        given = material.kwargs
        color = _triple(given.get("kd"))
        if color is None:
            # Trimesh's gray of a material without a color, and white beside a texture.
            gray = np.asarray(material.diffuse[:3]) / 255
            color = np.ones(3) if "map_kd" in names else gray
        elif "map_kd" in names and not color.any():
            color = np.ones(3)  # exporters write black beside a texture to be seen as it is
        gloss = _number(given.get("ns"))
        rough = ROUGHNESS if gloss is None else (2 / (max(gloss, 0) + 2)) ** 0.25
        if "pr" in given:
            rough = _number(given["pr"]) or 0.0
        shine = _triple(given.get("ks"))
        alpha = _number(given.get("d"), 1 - (_number(given.get("tr"), 0.0) or 0.0))
        glow = _triple(given.get("ke"))
        if glow is None:
            glow = np.full(3, float("map_ke" in names))  # exporters write none beside a texture
        made = Material(
            three(linear(np.clip(color, 0, 1))),
            float(np.clip(1.0 if "map_pr" in names else rough, LEAST_ROUGHNESS, 1)),
            float(np.clip(_number(given.get("pm"), 0.0) or 0.0, 0, 1)),
            three(glow),
            reflectance=three(DIELECTRIC * np.clip((0.5,) * 3 if shine is None else shine, 0, 1)),
            alpha=float(np.clip(1.0 if alpha is None else alpha, 0, 1)),
            color_map=self._texture("map_kd", names, sources),
            roughness_map=self._texture("map_pr", names, sources),
            normal_map=self._texture("norm", names, sources),
            emission_map=self._texture("map_ke", names, sources),
        )
        return made, tuple(sources)

    def _named(self, material: Any) -> dict[str, str | int]:
        """Return the names of a material's textures by their fields, numbers of those without."""
        given = material.kwargs
        names: dict[str, str | int] = {
            field: " ".join(given[field]) for field in sorted(TEXTURES) if field in given
        }
        if material.image is not None:  # that of map_Kd is open
            names["map_kd"] = material.image.info.get("file_path") or len(self._unnamed)
            if isinstance(names["map_kd"], int):
                self._unnamed.append(material.image)
        return names

    def _opened(self, name: str | int) -> Any:
        """Open an image, of which Pillow reads the head."""
        if isinstance(name, int):
            return self._unnamed[name]
        return open_image(self._assets.get(name), self._assets.source, repr(name))

    def _key(self, field: str, name: str | int) -> Key:
        """Return what the pyramid of a field's texture is made of."""
        options = self._options[name]
        convert = normals_of(options.multiplier) if field == "norm" else CONVERTS[field]
        return Key(name, convert, (CLAMP, CLAMP) if options.clamp else (REPEAT, REPEAT))

    def _texture(
        self, field: str, names: dict[str, str | int], sources: dict[Source, int]
    ) -> Texture | None:
        """Return the texture of a field, and note where its coordinates come from."""
        if field not in names:
            return None
        name = names[field]
        layer = sources.setdefault(self._options[name].source(), len(sources))
        return Texture(self._pyramids.get(self._key(field, name)), layer)


def _simple(material: Any) -> Any:
    """Return a material as those of MTL files are, which that of a .ply file may not be."""
    return material.to_simple() if hasattr(material, "to_simple") else material


def _number(words: Any, missing: float | None = None) -> float | None:
    """Return the number that an MTL file's words stand for."""
    if words is None or (isinstance(words, list) and not words):
        return missing
    return float(words[-1] if isinstance(words, list) else words)


def _triple(words: Any) -> NDArray[np.float64] | None:
    """Return three numbers; a single one stands for three."""
    if words is None:
        return None
    return np.array(np.broadcast_to(np.asarray(words, dtype=np.float64), 3))
