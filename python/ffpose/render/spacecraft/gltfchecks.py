"""Which numbers a glTF 2.0 document may have: what Python or the renderer would make do with.

Python takes an index of -1 for the last one, and what is not finite spreads through transforms.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ffpose.errors import DataError

COUNTS = {
    "attributes",
    "buffer",
    "bufferView",
    "byteLength",
    "byteOffset",
    "byteStride",
    "children",
    "count",
    "index",
    "indices",
    "joints",
    "material",
    "mesh",
    "node",
    "nodes",
    "sampler",
    "scene",
    "skeleton",
    "skin",
    "source",
    "texCoord",
}
"""Names of what is an index, a number or a size, or consists of indices."""

FACTORS = {
    "baseColorFactor": 1.0,
    "metallicFactor": 1.0,
    "roughnessFactor": 1.0,
    "emissiveFactor": 1.0,
    "diffuseFactor": 1.0,
    "specularFactor": 1.0,
    "glossinessFactor": 1.0,
    "transmissionFactor": 1.0,
    "alphaCutoff": math.inf,
    "emissiveStrength": math.inf,
    "ior": math.inf,
    "specularColorFactor": math.inf,
}
"""Largest values of materials' numbers, of which zero is the smallest."""

ROUNDING = 1e-6
"""What a factor may be out of its range by: exporters compute in float32."""


def check_numbers(header: dict[str, Any], known: tuple[str, ...], path: Path) -> None:
    """Check the numbers of a document.

    Args:
        header: The document.
        known: Beginnings of the names of extensions that are read; others may hold anything.
        path: The file, for errors.

    Raises:
        DataError: A number is not finite, an index, a count or a size is negative, or a factor of
            a material is not in its range.
    """
    stack: list[tuple[str, Any]] = [("", header)]
    while stack:
        name, value = stack.pop()
        if isinstance(value, dict):
            inner = {key: each for key, each in value.items() if key != "extras"}
            if name == "extensions":
                inner = {key: each for key, each in inner.items() if key.startswith(known)}
            stack += [(name if name == "attributes" else key, each) for key, each in inner.items()]
        elif isinstance(value, list):
            stack += [(name, each) for each in value]
        elif isinstance(value, int | float):
            if not math.isfinite(value):
                raise DataError(f"expected a finite {name}, got {value}", path)
            if value < 0 and name in COUNTS:
                raise DataError(f"expected {name} of at least 0, got {value}", path)
            if name in FACTORS and not -ROUNDING <= value <= FACTORS[name] + ROUNDING:
                bound = "0…1" if FACTORS[name] == 1 else "at least 0"
                raise DataError(f"expected {name} of {bound}, got {value}", path)
