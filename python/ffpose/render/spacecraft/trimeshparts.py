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
from ffpose.render.spacecraft.meshchecks import checked, named_materials
from ffpose.render.spacecraft.mtloptions import Options, texture_options
from ffpose.render.spacecraft.parts import Part, check_shape
from ffpose.render.spacecraft.stlcolors import stl_colors
from ffpose.render.spacecraft.textures import (
    CLAMP,
    REPEAT,
    Pyramid,
    Source,
    build_pyramid,
    largest_side,
    linear,
)

logger = logging.getLogger(__name__)

ROUGHNESS = 0.55
"""Roughness of what has no material."""

CONVERTS = {
    "map_kd": color_of("BLEND", None),
    "map_ke": color_of("OPAQUE", None),
    "map_pr": values_of,
}
"""What turns codes into values, by the key of a texture; those of normals have options."""

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
        content = checked(content, suffix, source)
        if suffix == ".obj":
            assets.used, assets.libraries = named_materials(content)
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
    unknown = sorted(
        name.decode(errors="replace") for name in (assets.used or set()) - assets.defined
    )
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
    """The materials of an MTL file."""

    def __init__(self, meshes: list[Any], assets: Assets) -> None:
        self._assets = assets
        self._made: dict[int, tuple[Material, tuple[Source, ...]]] = {}
        self._images: dict[str, Any] = {}
        self._options: dict[str, Options] = {}
        self._pyramids: dict[Any, Pyramid] = {}
        materials = [mesh.visual.material for mesh in meshes if mesh.visual.kind == "texture"]
        sizes: dict[Any, tuple[int, int]] = {}
        for material in materials:
            if getattr(material, "image", None) is not None:
                sizes[id(material.image)] = material.image.size
            for key in ("map_ke", "norm", "map_pr"):
                if key in getattr(material, "kwargs", {}):
                    sizes[key, " ".join(material.kwargs[key])] = self._opened(material, key).size
        self._most = largest_side(list(sizes.values()))

    def get(self, material: Any) -> tuple[Material, tuple[Source, ...]]:
        """Return a material as the renderer has them, and the sources of its textures."""
        if id(material) not in self._made:
            self._made[id(material)] = self._make(material)
        return self._made[id(material)]

    def miss(self, material: Any) -> None:
        """Warn of a texture without coordinates, of which one point colors everything."""
        text = "%s: material %r has a texture and no texture coordinates: of one color"
        logger.warning(text, self._assets.source, material.name)

    def _make(self, material: Any) -> tuple[Material, tuple[Source, ...]]:
        sources: dict[Source, int] = {}
        if hasattr(material, "to_simple"):  # of a .ply file that names a texture
            material = material.to_simple()
        given, image = material.kwargs, material.image
        color = _triple(given.get("kd"))
        if color is None:
            # Trimesh's gray of a material without a color, and white beside a texture.
            color = np.ones(3) if image is not None else np.asarray(material.diffuse[:3]) / 255
        elif image is not None and not color.any():
            color = np.ones(3)  # exporters write black beside a texture to be seen as it is
        gloss = _number(given.get("ns"))
        rough = ROUGHNESS if gloss is None else (2 / (max(gloss, 0) + 2)) ** 0.25
        if "pr" in given:
            rough = _number(given["pr"]) or 0.0
        shine = _triple(given.get("ks"))
        alpha = _number(given.get("d"), 1 - (_number(given.get("tr"), 0.0) or 0.0))
        glow = _triple(given.get("ke"))
        made = Material(
            three(linear(np.clip(color, 0, 1))),
            float(np.clip(1.0 if "map_pr" in given else rough, LEAST_ROUGHNESS, 1)),
            float(np.clip(_number(given.get("pm"), 0.0) or 0.0, 0, 1)),
            three(np.zeros(3) if glow is None else glow),
            reflectance=three(DIELECTRIC * np.clip((0.5,) * 3 if shine is None else shine, 0, 1)),
            alpha=float(np.clip(1.0 if alpha is None else alpha, 0, 1)),
            color_map=self._texture("map_kd", image, _file_name(image), sources),
            roughness_map=self._named("map_pr", material, sources),
            normal_map=self._named("norm", material, sources),
            emission_map=self._named("map_ke", material, sources),
        )
        return made, tuple(sources)

    def _named(self, key: str, material: Any, sources: dict[Source, int]) -> Texture | None:
        if key not in material.kwargs:
            return None
        name = " ".join(material.kwargs[key])
        return self._texture(key, self._opened(material, key), name, sources)

    def _opened(self, material: Any, key: str) -> Any:
        name = " ".join(material.kwargs[key])
        if name not in self._images:
            self._images[name] = open_image(self._assets.get(name), self._assets.source, repr(name))
        return self._images[name]

    def _texture(
        self, key: str, image: Any, name: str, sources: dict[Source, int]
    ) -> Texture | None:
        """Return a texture of a key, and note where its coordinates come from."""
        if image is None:
            return None
        if name not in self._options:
            self._options[name] = texture_options(name, self._assets.source)
        options = self._options[name]
        convert = normals_of(options.multiplier) if key == "norm" else CONVERTS[key]
        made = (id(image), key, options.clamp, options.multiplier)
        if made not in self._pyramids:
            wrap = (CLAMP, CLAMP) if options.clamp else (REPEAT, REPEAT)
            try:
                self._pyramids[made] = build_pyramid(image, convert, self._most, wrap)
            except (OSError, SyntaxError, ValueError) as error:
                text = f"expected a texture that can be decoded, got {one_line(error)}"
                raise DataError(text, self._assets.source) from error
        return Texture(self._pyramids[made], sources.setdefault(options.source(), len(sources)))


def _file_name(image: Any) -> str:
    """Return the name of an image as an MTL file has it, with options."""
    return "" if image is None else str(image.info.get("file_path", ""))


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
