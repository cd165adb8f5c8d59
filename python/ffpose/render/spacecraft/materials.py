"""Surface materials: microfacet parameters and procedural patterns.

Colors are linear RGB reflectances. The specular reflectance is the color for a metal and about
4 % white for everything else; roughness is that of the GGX distribution (alpha = roughness²).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Pattern(IntEnum):
    """Procedural pattern drawn over a material's base color."""

    PLAIN = 0
    CELLS = 1
    """Solar cells with gaps between them."""
    FOIL = 2
    """Crumpled multilayer insulation foil: perturbed normals."""
    BLANKET = 3
    """Quilted cloth: seams, stitches and a soft relief."""
    PANELS = 4
    """Painted panels with thin dark joints."""


@dataclass(frozen=True)
class Material:
    """One surface material.

    Attributes:
        color: Linear RGB reflectance, each in 0…1.
        roughness: GGX roughness in (0, 1].
        metallic: 0 for paint, glass and cloth, 1 for bare metal.
        emission: Emitted linear RGB radiance, in the unit of `ffpose.render.shading.reflection`.
        pattern: Pattern drawn over the color.
        scale: Size of the pattern in meters.
    """

    color: tuple[float, float, float]
    roughness: float = 0.6
    metallic: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: Pattern = Pattern.PLAIN
    scale: float = 1.0
