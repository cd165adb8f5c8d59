"""Materials of MTL files, their textures, and what stands before a texture's name.

Options are as in ``map_Kd -s 2 2 1 -o 0.5 0 0 -clamp on solar panel.png``. Colors are sRGB, as
textures are. A surface has two sides.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.gltfmaterials import color_of, normals_of, three, values_of
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS, Material
from ffpose.render.spacecraft.meshassets import Assets, open_image
from ffpose.render.spacecraft.parts import GRAY, ROUGHNESS
from ffpose.render.spacecraft.textures import CLAMP, REPEAT, Key, Pyramids, Slots, Source, linear

logger = logging.getLogger(__name__)

Fields = Mapping[str, str]
"""What follows the keywords of a material, which are in small letters."""

VALUES = r"(?:\s+(?:[-+.\d][-+.\de]*|on|off|[rgbmlz]))+"
OPTION = rf"(?:-colorspace\s+\S+|-[a-z]+{VALUES})\s+"
OPTIONS = re.compile(rf"^(?:{OPTION})+")
"""What stands before a texture's name."""

READ = ("-s", "-o", "-clamp", "-bm")
"""Options that are read."""


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


def read_libraries(
    lines: Collection[str], used: Collection[str], assets: Assets
) -> dict[str, Fields]:
    """Read those materials of MTL files, named on lines of an OBJ file, that it uses.

    Those that no MTL file has are told, and gray.
    """
    found: dict[str, Fields] = {}
    for content in assets.libraries(lines):
        fields: dict[str, str] = {}
        for line in content.splitlines():
            text = line.decode(errors="replace").replace("\t", " ").strip()
            key, _, rest = text.partition(" ")
            if key.lower() == "newmtl":
                fields = {}
                found[" ".join(rest.split())] = fields
            elif rest.strip():  # some programs write a key without a value
                fields[key.lower()] = rest.strip()
    unknown = sorted({*used} - {*found, ""})
    if unknown:
        text = "%s: no MTL file has %s: gray"
        logger.warning(text, assets.source, ", ".join(map(repr, unknown)))
    return {name: found.get(name, {}) for name in used}


class MtlMaterials:
    """Materials by their names; textures that are left out are told."""

    def __init__(self, given: Mapping[str, Fields], assets: Assets) -> None:
        self._given, self._assets = given, assets
        self._slots: dict[str, Slots] = {
            name: {
                field: texture_slot(field, fields[field])
                for field in sorted(TEXTURES & fields.keys())
            }
            for name, fields in given.items()
        }
        self._pyramids = Pyramids(self._slots.values(), self._opened)
        texts = (fields[field] for fields in given.values() for field in TEXTURES & fields.keys())
        options = {each.strip() for text in texts for each in _options(text)}
        if others := sorted(each for each in options if each.split()[0] not in READ):
            text = "%s: options of a texture are left out: %s"
            logger.warning(text, assets.source, " ".join(others))
        every = {field for fields in given.values() for field in fields}
        left_out = sorted(f for f in every - TEXTURES if f.startswith("map_") or f in OTHERS)
        if left_out:
            text = "%s: textures of materials are left out: %s"
            logger.warning(text, assets.source, ", ".join(left_out))

    def has_color(self, name: str) -> bool:
        """Return whether a material has a color or a texture of it."""
        return not {"kd", "map_kd"}.isdisjoint(self._given[name])

    def get(self, name: str, *, colored: bool = False) -> tuple[Material, tuple[Source, ...]]:
        """Return a material as the renderer has them, and the sources of its textures.

        One without a color is white for vertices that are ``colored``, else gray.

        Raises:
            DataError: A field has no such numbers; the error names the material.
        """
        try:
            return self._made(name, colored)
        except DataError as error:
            raise DataError(f"material {name!r}: {error.message}", error.file, error.line) from None

    def _made(self, name: str, colored: bool) -> tuple[Material, tuple[Source, ...]]:
        fields, (maps, sources) = self._given[name], self._pyramids.textures(self._slots[name])
        gloss = max(_number_of(fields, "ns", 0.0), 0.0)
        rough = (2 / (gloss + 2)) ** 0.25 if "ns" in fields else ROUGHNESS
        rough = _number_of(fields, "pr", rough)
        alpha = _alpha(fields)
        # Exporters write no emission beside a texture of it.
        glow = _color(fields, "ke", float("map_ke" in maps))
        shine = _color(fields, "ks", 0.5)
        made = Material(
            three(linear(np.clip(_base(fields, colored), 0, 1))),
            float(np.clip(1.0 if "map_pr" in maps else rough, LEAST_ROUGHNESS, 1)),
            float(np.clip(_number_of(fields, "pm", 0.0), 0, 1)),
            three(glow),
            reflectance=three(DIELECTRIC * np.clip(shine, 0, 1)),
            alpha=float(np.clip(alpha, 0, 1)),
            color_map=maps.get("map_kd"),
            roughness_map=maps.get("map_pr"),
            normal_map=maps.get("norm"),
            emission_map=maps.get("map_ke"),
        )
        return made, sources

    def _opened(self, name: str) -> Any:
        """Open an image, of which Pillow reads the head."""
        return open_image(self._assets.get(name), repr(name))


def _base(fields: Fields, colored: bool) -> NDArray[np.float64]:
    """Return the sRGB color that a texture or the colors of vertices are multiplied by."""
    white = colored or "map_kd" in fields
    color = _color(fields, "kd", 1.0 if white else GRAY)
    # Exporters write black beside a texture to be seen as it is.
    return color if color.any() or "map_kd" not in fields else np.ones(3)


def _alpha(fields: Fields) -> float:
    """Return the alpha that that of a texture of color is multiplied by."""
    alpha = _number_of(fields, "d", 1 - _number_of(fields, "tr", 0.0))
    # MeshLab writes opacity as Tr, and Blender zero beside a texture to have the alpha of that.
    seen = alpha > 0 or ("d" in fields and "map_kd" not in fields)
    return alpha if seen else 1.0


def _color(fields: Fields, key: str, missing: float) -> NDArray[np.float64]:
    """Return the first three numbers of a field, for which a single one may stand."""
    words = fields.get(key, "").partition("#")[0].split()[:3]
    if not words or words[0] in ("spectral", "xyz"):
        return np.full(3, missing)
    return np.array(np.broadcast_to(_finite(key, words), 3))


def _number_of(fields: Fields, key: str, missing: float) -> float:
    """Return the last number of a field: an option may precede it."""
    words = fields.get(key, "").partition("#")[0].split()
    return _finite(key, words[-1:])[0] if words else missing


def _finite(key: str, words: list[str]) -> list[float]:
    """Return one number or three."""
    try:
        numbers = [_number(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3):
        raise DataError(f"expected one number or three after {key}, got {' '.join(words)!r}")
    return numbers


def texture_slot(field: str, text: str) -> tuple[Key, Source]:
    """Read a texture's name and the options before it.

    A DataError if a value is not what its option has.
    """
    scale, offset, wrap, bump = (1.0, 1.0), (0.0, 0.0), REPEAT, 1.0
    options = _options(text)
    for part in options:
        key, *values = part.split()
        try:
            if key == "-s":  # two shows the texture twice
                scale = _pair(values, 1.0)
            elif key == "-o":
                offset = _pair(values, 0.0)
            elif key == "-clamp":
                wrap = {"on": CLAMP, "off": REPEAT}[values[0]]
            elif key == "-bm":
                bump = _number(values[0])
        except (KeyError, ValueError):
            expected = "on or off" if key == "-clamp" else "finite numbers"
            got = f"after {key} of a texture, got {' '.join(values)!r}"
            raise DataError(f"expected {expected} {got}") from None
    convert = normals_of(bump) if field == "norm" else CONVERTS[field]
    # Options count from the lower left of the texture, its coordinates from the upper left.
    place = Source(offset=(offset[0], 1 - scale[1] - offset[1]), scale=scale)
    return Key(text.removeprefix("".join(options)), convert, (wrap, wrap)), place


def _options(text: str) -> list[str]:
    """Return the options before a texture's name."""
    found = OPTIONS.match(text)
    return re.findall(OPTION, found[0]) if found else []


def _pair(values: list[str], missing: float) -> tuple[float, float]:
    """Return the first two of up to three numbers."""
    across, up, *_ = [*map(_number, values), missing]
    return across, up


def _number(value: str) -> float:
    number = float(value)
    if not abs(number) <= float(np.finfo(np.float32).max):
        raise ValueError(value)
    return number
