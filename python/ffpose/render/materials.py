"""Surface materials: a microfacet description, and the patterns drawn over it.

Colours are linear RGB reflectances. A metal reflects its own colour, everything else about four
per cent of white; roughness is that of the GGX distribution (alpha = roughness²).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Pattern(IntEnum):
    """What is drawn over a material's base colour."""

    PLAIN = 0
    CELLS = 1
    """Solar cells with their gaps, over a texture coordinate in metres."""
    FOIL = 2
    """Crumpled multilayer foil: the normal is disturbed."""
    BLANKET = 3
    """Quilted cloth: seams, stitches and a soft relief."""
    PANELS = 4
    """Painted plates with thin dark joints."""


@dataclass(frozen=True)
class Material:
    """One surface material.

    Attributes:
        color: linear RGB reflectance, each in 0…1.
        roughness: GGX roughness in (0, 1].
        metallic: 0 for paint, glass and cloth, 1 for bare metal.
        emission: linear RGB radiance given off, in the unit of `ffpose.render.shading`.
        pattern: what is drawn over the colour.
        scale: size of the pattern in metres.
    """

    color: tuple[float, float, float]
    roughness: float = 0.6
    metallic: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: Pattern = Pattern.PLAIN
    scale: float = 1.0
