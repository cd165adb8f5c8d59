"""Which numbers a glTF 2.0 document may have: what Python or the renderer would make do with.

Python takes an index of -1 for the last one, and what is not finite spreads through transforms.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

from ffpose.errors import DataError

logger = logging.getLogger(__name__)

COUNTS = {
    *("attributes", "buffer", "bufferView", "byteLength", "byteOffset", "byteStride", "count"),
    *("scene", "node", "nodes", "children", "mesh", "indices", "index", "skin", "skeleton"),
    *("joints", "material", "sampler", "source", "targets", "texCoord"),
}
"""Names of what is an index, a number or a size, or consists of indices."""

BY_NAME = ("attributes", "targets")
"""Those among them of which any name has an index."""

SHARES = ("baseColor", "metallic", "roughness", "emissive", "diffuse", "specular", "glossiness")
FACTORS = {
    **{f"{name}Factor": 1.0 for name in (*SHARES, "transmission")},
    **dict.fromkeys(("alphaCutoff", "emissiveStrength", "ior", "specularColorFactor"), math.inf),
}
"""Largest values of materials' numbers, of which zero is the smallest."""

ROUNDING = 1e-6
"""By how much a factor is out of its range without a word: exporters compute in float32."""


def check_numbers(header: dict[str, Any], known: Collection[str], path: Path) -> None:
    """Check the numbers of a document; factors out of their range are told and set to its end.

    Public files have such factors, by a slip of who drew the material; all else of them is right.
    Extensions that are not ``known`` are not read, and may hold anything. A DataError if a number
    is not finite, or an index, a count or a size is negative.
    """
    stack: list[tuple[str, Any]] = [("", header)]
    while stack:
        name, part = stack.pop()
        for key, value in part.items() if isinstance(part, dict) else enumerate(part):
            if key == "extras" or (name == "extensions" and key not in known):
                continue
            inner = key if isinstance(key, str) and name not in BY_NAME else name
            if isinstance(value, dict | list):
                stack.append((inner, value))
            elif isinstance(value, int | float):
                part[key] = _checked(inner, value, path)


def _checked(name: str, value: float, path: Path) -> float:
    """Return a number that may stand there."""
    if not math.isfinite(value):
        raise DataError(f"expected a finite {name}, got {value}")
    if value < 0 and name in COUNTS:
        raise DataError(f"expected {name} of at least 0, got {value}")
    if name not in FACTORS or 0 <= value <= FACTORS[name]:
        return value
    nearest = min(max(value, 0.0), FACTORS[name])
    if abs(nearest - value) > ROUNDING:
        bound = "0…1" if FACTORS[name] == 1 else "at least 0"
        logger.warning("%s: %s %g is out of %s: %g", path, name, value, bound, nearest)
    return nearest
