"""Surface materials: microfacet parameters, procedural patterns, and textures.

Colors are linear RGB reflectances. The specular reflectance is the color for a metal and about
4 % white for everything else; roughness is that of the GGX distribution (alpha = roughness²).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ffpose.render.spacecraft.textures import Texture

SLOTS = ("color_map", "roughness_map", "normal_map", "emission_map")
"""Fields of a `Material` that are textures."""


LEAST_ROUGHNESS = 0.05
"""Roughness below which a sample of the sun's highlight would be a single spark."""


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

    Values multiply the textures' and, with color and alpha, those of `Mesh.colors`.

    Attributes:
        color: Linear RGB reflectance, each in 0…1.
        roughness: GGX roughness in (0, 1].
        metallic: 0 for paint, glass and cloth, 1 for bare metal.
        emission: Emitted linear RGB radiance, in the unit of `ffpose.render.shading.reflection`.
        pattern: Pattern drawn over the color.
        scale: Size of the pattern in meters.
        reflectance: Specular reflectance of what is not metal, at normal incidence, linear RGB.
        alpha: Share of a pixel that the surface covers where it covers all of it geometrically.
        two_sided: Whether the surface is there when seen from its back.
        color_map: Color, multiplied by alpha, and alpha.
        roughness_map: Roughness in the second channel, metalness in the third.
        normal_map: Normals in the tangent frame: right, up and outward in the texture.
        emission_map: Emitted radiance.
    """

    color: tuple[float, float, float]
    roughness: float = 0.6
    metallic: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pattern: Pattern = Pattern.PLAIN
    scale: float = 1.0
    reflectance: tuple[float, float, float] = (0.04, 0.04, 0.04)
    alpha: float = 1.0
    two_sided: bool = True
    color_map: Texture | None = None
    roughness_map: Texture | None = None
    normal_map: Texture | None = None
    emission_map: Texture | None = None

    @property
    def maps(self) -> tuple[Texture, ...]:
        """All textures of the material."""
        found = (getattr(self, slot) for slot in SLOTS)
        return tuple(texture for texture in found if texture is not None)
