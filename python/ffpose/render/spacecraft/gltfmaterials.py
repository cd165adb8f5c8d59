"""Materials of glTF 2.0: metallic-roughness with textures, and the extensions that change them.

`READ` are the extensions that are read, and KHR_texture_transform. A texture of specular
reflectances stands for its mean. What is unlit becomes matte: in space it would be dark in the
shadow too. What transmits lets through as much light without bending it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Set
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material
from ffpose.render.spacecraft.meshassets import open_image
from ffpose.render.spacecraft.textures import (
    CLAMP,
    MIRROR,
    REPEAT,
    Convert,
    Key,
    Pyramids,
    Slots,
    Source,
    linear,
)

logger = logging.getLogger(__name__)

Codes = NDArray[np.uint8]
Floats = NDArray[np.float32]
Header = dict[str, Any]

READ = (
    *("KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular"),
    *("KHR_materials_transmission", "KHR_materials_unlit"),
    "KHR_materials_pbrSpecularGlossiness",
)
"""Extensions of materials that are read."""

KTX2 = b"\xabKTX 20\xbb"
"""What files of that format begin with."""

LEFT_OUT = (
    *("KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_diffuse_transmission"),
    *("KHR_materials_dispersion", "KHR_materials_iridescence", "KHR_materials_sheen"),
    *("KHR_materials_variants", "KHR_materials_volume", "KHR_materials_volume_scatter"),
)
"""Extensions of materials without which a file is read too, though it requires them."""

LEFT_OUT_TEXTURES = ("specularColorTexture", "specularTexture", "transmissionTexture")
"""Textures of the extensions that are read of which only the factors are."""

WRAPS = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}
"""Codes of a sampler (section 3.8.4.1)."""

GLASS = 0.9
"""Share of a transmitting surface that is not there: its reflections remain."""

MEAN_SIDE = 64
"""Texels along a side of a texture of which only the mean is used."""

LIGHT = linear(np.arange(256) / 255).astype(np.float32)
"""Linear light of the codes of eight bits."""


class Materials:
    """The materials of a document, each with the sources of its textures' coordinates.

    ``used`` are the numbers of those that something drawn has, None among them for the default one:
    others, as of variants, may lack their images. ``image_bytes`` returns the content of an image
    and its name for errors. What is left out of the materials is told.
    """

    def __init__(
        self,
        header: Header,
        used: Set[int | None],
        image_bytes: Callable[[int], tuple[bytes, str]],
        path: Path,
    ) -> None:
        self._header = header
        self._image_bytes = image_bytes
        self._made: dict[int | None, tuple[Material, tuple[Source, ...]]] = {}
        self._given: dict[int | None, Header] = {
            number: {} if number is None else header["materials"][number] for number in used
        }
        self._slots = {number: self._slots_of(each) for number, each in self._given.items()}
        self._pyramids = Pyramids(self._slots.values(), self._opened)
        left_out = {name for material in self._given.values() for name in _left_out(material)}
        if left_out:
            text = "%s: extensions of materials are left out: %s"
            logger.warning(text, path, ", ".join(sorted(left_out)))

    def get(self, number: int | None) -> tuple[Material, tuple[Source, ...]]:
        """Return a material and the sources of its textures; None is the default one."""
        if number not in self._made:
            maps, sources = self._pyramids.textures(self._slots[number])
            self._made[number] = self._make(self._given[number], maps), sources
        return self._made[number]

    def alphas(self, number: int | None, given: Floats) -> Floats:
        """Return what alphas (V,) of vertices are in a material: those of a mask are 0 or 1."""
        header = self._given[number]
        if header.get("alphaMode", "OPAQUE") == "OPAQUE":
            return np.ones_like(given)
        cutoff = _cutoff(header)
        return given if cutoff is None else (given >= cutoff).astype(np.float32)

    def _make(self, header: Header, maps: dict[str, Any]) -> Material:
        extensions = header.get("extensions", {})
        factors = _factors(header)
        base, rough = factors["slots"]
        if factors.get("glossiness") is not None:
            factors["reflectance"] = self._tinted(factors["reflectance"], rough)
        alpha = factors["color"][3] if header.get("alphaMode", "OPAQUE") != "OPAQUE" else 1.0
        cutoff = _cutoff(header)
        if cutoff is not None:
            alpha = 1.0 if base is not None else float(cutoff <= 1)
        glass = extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0)
        glow = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
        emission = np.asarray(header.get("emissiveFactor", (0, 0, 0)), float) * glow
        shine = factors.get("glossiness")
        roughness = factors["roughness"] if shine is None or rough is None else 1.0
        unlit = "KHR_materials_unlit" in extensions
        return Material(
            three(np.clip(factors["color"][:3], 0, 1)),
            1.0 if unlit else float(max(roughness, LEAST_ROUGHNESS)),
            0.0 if unlit else factors["metallic"],
            three(emission),
            reflectance=(0.0, 0.0, 0.0) if unlit else factors["reflectance"],
            alpha=float(np.clip(alpha * (1 - GLASS * glass), 0, 1)),
            two_sided=bool(header.get("doubleSided", False)),
            **maps,
        )

    def _tinted(
        self, reflectance: tuple[float, float, float], slot: Header | None
    ) -> tuple[float, float, float]:
        """Return a reflectance times the mean light of the texture that it is a factor of."""
        key = self._key(slot, color_of("OPAQUE", None))
        if key is None:
            return reflectance
        pyramid = self._pyramids.build(key, MEAN_SIDE)
        light = pyramid.level(0)[..., :3].mean(axis=(0, 1), dtype=np.float64)
        return three(light * reflectance)

    def _slots_of(self, header: Header) -> Slots:
        """Return what the textures of a material are made of, of those that have an image."""
        found: Slots = {}
        for field, (slot, convert) in _maps(header).items():
            key = self._key(slot, convert)
            if slot is None or key is None:
                continue
            change = slot.get("extensions", {}).get("KHR_texture_transform", {})
            source = Source(
                int(change.get("texCoord", slot.get("texCoord", 0))),
                tuple(change.get("offset", (0.0, 0.0))),
                float(change.get("rotation", 0.0)),
                tuple(change.get("scale", (1.0, 1.0))),
            )
            found[field] = key, source
        return found

    def _key(self, slot: Header | None, convert: Convert) -> Key | None:
        """Return what the pyramid of a slot is made of; None without an image.

        A DataError if it is in KTX2 alone.
        """
        if slot is None:
            return None
        entry = self._header["textures"][slot["index"]]
        extensions = entry.get("extensions", {})
        number = extensions.get("EXT_texture_webp", {}).get("source", entry.get("source"))
        if number is None and "KHR_texture_basisu" in extensions:
            raise self._in_ktx2(f"texture {slot['index']}")
        if number is None:
            return None
        sampler = self._header["samplers"][entry["sampler"]] if "sampler" in entry else {}
        wrap = (WRAPS[sampler.get("wrapS", 10497)], WRAPS[sampler.get("wrapT", 10497)])
        return Key(int(number), convert, wrap)

    def _opened(self, number: int) -> Any:
        """Open an image, of which Pillow reads the head."""
        content, name = self._image_bytes(number)
        if content.startswith(KTX2):
            raise self._in_ktx2(f"image {name}")
        return open_image(content, name)

    def _in_ktx2(self, what: str) -> DataError:
        text = f"expected textures of PNG, JPEG or WebP, got {what} in KTX2 (KHR_texture_basisu)"
        return DataError(f"{text} alone: convert it to one of those")


def _left_out(material: Header) -> Iterator[str]:
    """Yield what of a material's extensions is not read."""
    for name, values in material.get("extensions", {}).items():
        if name in READ:
            yield from (f"{key} of {name}" for key in LEFT_OUT_TEXTURES if key in values)
        elif "_materials_" in name:
            yield name


def _maps(material: Header) -> dict[str, tuple[Header | None, Convert]]:
    """Return slots of textures by their fields of a `Material`, and what turns their codes."""
    factors = _factors(material)
    (base, rough), shine = factors["slots"], factors.get("glossiness")
    normal = material.get("normalTexture")
    return {
        "color_map": (base, color_of(material.get("alphaMode", "OPAQUE"), _cutoff(material))),
        "roughness_map": (rough, values_of if shine is None else _glossy(shine)),
        "normal_map": (normal, normals_of(1.0 if normal is None else normal.get("scale", 1.0))),
        "emission_map": (material.get("emissiveTexture"), color_of("OPAQUE", None)),
    }


def _cutoff(material: Header) -> float | None:
    """Return the alpha of a texture from which a masked material is there; None for others."""
    if material.get("alphaMode", "OPAQUE") != "MASK":
        return None
    return float(material.get("alphaCutoff", 0.5) / max(_factors(material)["color"][3], 1e-6))


def _factors(header: Header) -> dict[str, Any]:
    """Return color with alpha, roughness, metalness, and reflectance at normal incidence.

    ``slots`` are those of the textures of color and roughness.
    """
    extensions = header.get("extensions", {})
    glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
    if glossy is not None:
        return {
            "color": np.asarray(glossy.get("diffuseFactor", (1, 1, 1, 1)), float),
            "roughness": 1.0 - glossy.get("glossinessFactor", 1.0),
            "metallic": 0.0,
            "reflectance": three(np.asarray(glossy.get("specularFactor", (1, 1, 1)), float)),
            "glossiness": glossy.get("glossinessFactor", 1.0),
            "slots": (glossy.get("diffuseTexture"), glossy.get("specularGlossinessTexture")),
        }
    rough = header.get("pbrMetallicRoughness", {})
    specular = extensions.get("KHR_materials_specular", {})
    index = extensions.get("KHR_materials_ior", {}).get("ior", 1.5)
    tint = np.asarray(specular.get("specularColorFactor", (1, 1, 1)), float)
    mirror = ((index - 1) / (index + 1)) ** 2 if index > 0 else 1.0
    reflectance = np.minimum(mirror * tint, 1) * specular.get("specularFactor", 1.0)
    return {
        "color": np.asarray(rough.get("baseColorFactor", (1, 1, 1, 1)), float),
        "roughness": float(rough.get("roughnessFactor", 1.0)),
        "metallic": float(rough.get("metallicFactor", 1.0)),
        "reflectance": three(reflectance),
        "slots": (rough.get("baseColorTexture"), rough.get("metallicRoughnessTexture")),
    }


@cache
def color_of(mode: str, cutoff: float | None) -> Convert:
    """Return what turns codes into light multiplied by alpha, and alpha."""

    def convert(codes: Codes) -> Floats:
        light = LIGHT[codes]
        light[..., 3] = 1
        if mode == "OPAQUE":
            return light
        alpha = codes[..., 3:] * np.float32(1 / 255)
        if cutoff is not None:
            alpha = (alpha >= cutoff).astype(np.float32)
        result: Floats = light * alpha
        return result

    return convert


@cache
def normals_of(scale: float) -> Convert:
    """Return what turns codes into unit normals in the tangent frame."""

    def convert(codes: Codes) -> Floats:
        normal = codes * np.float32(2 / 255) - 1
        normal[..., :2] *= np.float32(scale)
        normal[..., 3] = 0
        x, y, z = (normal[..., k] for k in range(3))
        length = np.sqrt(x * x + y * y + z * z)
        result: Floats = normal / np.maximum(length, np.float32(1e-6))[..., None]
        return result

    return convert


def values_of(codes: Codes) -> Floats:
    """Return codes as fractions of the largest."""
    return codes * np.float32(1 / 255)


@cache
def _glossy(factor: float) -> Convert:
    """Return what turns glossiness in the fourth channel into roughness in the second."""

    def convert(codes: Codes) -> Floats:
        result = np.zeros(codes.shape, np.float32)
        result[..., 1] = 1 - np.float32(factor / 255) * codes[..., 3]
        return result

    return convert


def three(values: Any) -> tuple[float, float, float]:
    """Return three numbers as a color."""
    red, green, blue = (float(value) for value in values)
    return red, green, blue
