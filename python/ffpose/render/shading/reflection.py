"""Shading of the spacecraft: a Lambertian diffuse term under a GGX microfacet layer.

Radiance is in units of that of a white diffuse surface facing the sun, so the sun's irradiance is
pi. Sources: Walter et al. 2007 (GGX with Smith's shadowing), Schlick 1994 (Fresnel).
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffpose.render.shading.maps import Maps, Points
from ffpose.render.shading.patterns import DRAW, Surface
from ffpose.render.shading.randomization import stops
from ffpose.render.shading.rays import View
from ffpose.render.shading.tracer import Tracer
from ffpose.render.shading.vectors import Floats, column, dot, unit
from ffpose.render.spacecraft.craft import Craft
from ffpose.render.spacecraft.materials import LEAST_ROUGHNESS
from ffpose.render.spacecraft.mesh import Mesh

EARTH_COLOR = (0.26, 0.31, 0.38)
"""Mean radiance of the sunlit Earth below, clouds and sea together."""

HIGHLIGHT_LIMIT = 12.0
"""Largest radiance of one sample, so that a glint does not dominate its pixel."""

BOUNCE = 0.2
"""Fraction of the Earth's light reflected by the spacecraft where it occludes the Earth."""

LEAST_SLANT = 0.125
"""Cosine to which a texture seen from the side is averaged, as if no more slanted."""

VALUES = ("color", "roughness", "metallic", "emission", "reflectance")
"""Fields of a material, and of a `Surface`, that textures and patterns change."""

LIFT_M = 2e-3
"""Offset of a shadow ray's origin from the surface, so that no point shadows itself, meters."""


class Light(NamedTuple):
    """Lights: directions (3,) in the object frame, and intensities.

    Attributes:
        sun: Unit vector to the sun.
        nadir: Unit vector to the Earth's center.
        earth: Radiance of the Earth below, relative to `EARTH_COLOR`.
        horizon: Cosine of the angle between nadir and horizon.
        sunlight: 1, or 0 in the Earth's shadow.
        lamp: Irradiance of a lamp at the camera, relative to the sun's, at a distance of 1 m.
        tint: (3, 1) color of the sun's light.
    """

    sun: Floats
    nadir: Floats
    earth: float = 0.0
    horizon: float = 0.0
    sunlight: float = 1.0
    lamp: float = 0.0
    tint: Floats = np.ones((3, 1), np.float32)


class MaterialTable:
    """Lookup tables of the spacecraft's materials, for many points at once."""

    def __init__(self, craft: Craft) -> None:
        table = craft.materials
        self._values: dict[str, Floats] = {
            name: np.array([getattr(material, name) for material in table], np.float32).T
            for name in VALUES
        }
        self._uv = craft.mesh.uv.astype(np.float32)
        self._normals = craft.mesh.corner_normals
        self._sides = _sides(craft.mesh)
        self._material = craft.mesh.material
        self._pattern = np.array([m.pattern for m in table])
        self._scale = np.array([m.scale for m in table], dtype=np.float32)
        self._tints = craft.mesh.colors
        self._mapped = [number for number, m in enumerate(table) if m.maps]
        self.maps = Maps(craft)

    def varied(self, spread: float, rng: np.random.Generator) -> MaterialTable:
        """Return a copy with every material's color and roughness varied by random stops."""
        color, rough = (
            self._values[name] * stops(spread, self._values[name].shape, rng)
            for name in ("color", "roughness")
        )
        varied = {"color": np.minimum(color, 1), "roughness": np.clip(rough, LEAST_ROUGHNESS, 1)}
        other = copy.copy(self)
        other._values = self._values | varied
        return other

    def surface(self, view: View, footprint: Floats, samples: int = 1) -> Surface:
        """Evaluate materials, textures and patterns at the points of a view.

        Detail finer than ``footprint`` (N,), the width of a pixel at each point in meters, is
        averaged; there are ``samples`` rays along each side of a pixel.
        """
        face = view.hits.face
        weights = view.hits.weights
        normal = _blend(self._normals.take(face, axis=0), weights)
        turned = dot(self._sides.take(face, axis=1), view.rays) > 0
        number = self._material.take(face)
        values = {name: table.take(number, axis=-1) for name, table in self._values.items()}
        surface = Surface(normal=normal, **values)
        if self._tints is not None:
            surface.color[:] *= _blend(self._tints[..., :3].take(face, axis=0), weights)
        if self._mapped:
            self._draw_maps(
                surface, number, Points(face, weights, footprint * np.float32(1 / samples)), view
            )
        # Open surfaces are seen from both sides.
        normal[:, turned] *= -1
        uv = _blend(self._uv.take(face, axis=0), weights)
        place, kinds, scale = view.place, self._pattern.take(number), self._scale.take(number)
        for kind, draw in DRAW.items():
            at = np.flatnonzero(kinds == kind)
            if at.size:
                draw(surface, at, uv[:, at] / scale[at], place[:, at], footprint[at] / scale[at])
        return surface._replace(normal=_face_eye(unit(surface.normal), view.rays))

    def _draw_maps(
        self, surface: Surface, number: NDArray[np.int32], points: Points, view: View
    ) -> None:
        """Multiply a surface's values by those of the textures of its materials."""
        slant = np.abs(dot(surface.normal, view.rays))
        widened = points.footprint / np.maximum(slant, np.float32(LEAST_SLANT))
        points = points._replace(footprint=np.asarray(widened, np.float32))
        for mapped in self._mapped:
            found = np.flatnonzero(number == mapped)
            if not found.size:
                continue
            whole = found.size == number.size
            some = points if whole else points.some(found)
            at = slice(None) if whole else found  # of a slice there are no copies
            values = self.maps.values(mapped, some)
            if "color_map" in values:
                color = values["color_map"]
                surface.color[:, at] *= color[:3] / np.maximum(color[3], np.float32(1e-3))
            if "roughness_map" in values:
                _, rough, metallic, _ = values["roughness_map"]
                surface.roughness[at] = np.maximum(surface.roughness[at] * rough, LEAST_ROUGHNESS)
                surface.metallic[at] *= metallic
            if "normal_map" in values:
                bend = values["normal_map"]
                surface.roughness[at] = _widened(surface.roughness[at], bend)
                normal = unit(surface.normal[:, at])
                surface.normal[:, at] = self.maps.bent(mapped, some, normal, bend)
            if "emission_map" in values:
                surface.emission[:, at] *= values["emission_map"][:3]


def _widened(roughness: Floats, bend: Floats) -> Floats:
    """Return the roughness where normals of a map differ within a texel.

    Their mean is shorter and the highlight is wider (Toksvig 2005, "Mipmapping normal maps").
    """
    length = np.clip(np.sqrt(dot(bend[:3], bend[:3])), 0.1, 1)
    slope = np.square(np.square(roughness)) + 2 * (1 - length) / length
    return np.asarray(np.sqrt(np.sqrt(np.minimum(slope, 1))))


def sun_visible(tracer: Tracer, place: Floats, normal: Floats, light: Light) -> Floats:
    """Return 1 where the sun reaches the points (3, N), else 0; (N,)."""
    lit = np.zeros(place.shape[1], dtype=np.float32)
    turned = np.flatnonzero(dot(light.sun, normal) > 0)
    if light.sunlight > 0 and turned.size:
        start = place[:, turned] + normal[:, turned] * np.float32(LIFT_M)
        lit[turned] = ~tracer.blocked(start.T, light.sun)
    return lit


def earth_visible(
    tracer: Tracer, place: Floats, normal: Floats, light: Light, rng: np.random.Generator
) -> Floats:
    """Estimate the fraction (N,) of the Earth's light that reaches the points (3, N).

    Two random rays for each point scatter about the bisector of nadir and normal, where most of
    that light comes from. An occluded point still gets `BOUNCE` from the lit surfaces around it.
    """
    if light.earth == 0:
        return np.zeros(place.shape[1], dtype=np.float32)
    start = place + normal * np.float32(LIFT_M)
    scatter = np.float32(0.4) * rng.standard_normal(place.shape, dtype=np.float32)
    middle = light.nadir[:, None] + normal
    blocked = np.zeros(place.shape[1], dtype=np.float32)
    for toward in (middle + scatter, middle - scatter):
        blocked += tracer.blocked(start.T, unit(toward).T)
    return np.asarray(1 - np.float32((1 - BOUNCE) / 2) * blocked)


def reflected(
    surface: Surface, view: View, light: Light, sunlit: Floats, earthlit: Floats
) -> Floats:
    """Compute the radiance (3, N) reflected toward the camera.

    ``sunlit`` and ``earthlit`` (N,) are the fractions of each light that reach the points, 0…1.
    """
    rays = view.rays
    plain = surface.color * (1 - surface.metallic)
    mirror = surface.reflectance * (1 - surface.metallic) + surface.color * surface.metallic
    direct = np.maximum(dot(light.sun, surface.normal), 0) * sunlit
    out = plain + _highlight(surface, rays, light.sun, mirror)
    out *= direct * light.tint
    out += _earth_shine(surface, rays, light, plain, mirror) * earthlit
    if light.lamp > 0:
        facing = -dot(rays, surface.normal)
        lamp = np.float32(light.lamp) * facing / view.hits.distance**2
        glint = _lobe(surface, facing) / _reach(surface, facing) ** 2
        out += (plain + mirror * glint) * lamp
    np.minimum(out, np.float32(HIGHLIGHT_LIMIT), out=out)
    out += surface.emission
    return out


def _highlight(surface: Surface, rays: Floats, sun: Floats, mirror: Floats) -> Floats:
    """Evaluate the GGX lobe times pi, because the sun's irradiance is pi."""
    half = unit(sun[:, None] - rays)
    facing = np.maximum(dot(half, surface.normal), 0)
    cos_view = np.maximum(-dot(rays, surface.normal), np.float32(1e-3))
    cos_sun = np.maximum(dot(sun, surface.normal), np.float32(1e-3))
    lobe = _lobe(surface, facing) / (_reach(surface, cos_view) * _reach(surface, cos_sun))
    grazing = (1 - np.clip(dot(sun, half), 0, 1)) ** 5
    return np.asarray((mirror + (1 - mirror) * grazing) * lobe)


def _lobe(surface: Surface, facing: Floats) -> Floats:
    """Evaluate GGX's density of microfacets that face the half vector, times pi."""
    slope = surface.roughness**4
    return np.asarray(slope / (facing * facing * (slope - 1) + 1) ** 2)


def _reach(surface: Surface, cosine: Floats) -> Floats:
    """Evaluate the denominator of Smith's shadowing for one direction, without twice the cosine."""
    slope = surface.roughness**4
    return np.asarray(cosine + np.sqrt(slope + (1 - slope) * cosine * cosine))


def _earth_shine(
    surface: Surface, rays: Floats, light: Light, plain: Floats, mirror: Floats
) -> Floats:
    """Compute the Earth's light: a wide lamp for the diffuse term, a blurred disk in the mirror."""
    wide = np.float32(0.5 * (1 - light.horizon))
    diffuse = np.clip(dot(light.nadir, surface.normal) * (1 - wide) + wide, 0, 1)
    cos_view = dot(rays, surface.normal)
    mirrored = dot(light.nadir, rays - 2 * cos_view * surface.normal)
    blur = np.float32(0.02) + surface.roughness
    seen = np.clip((mirrored - np.float32(light.horizon)) / blur + np.float32(0.5), 0, 1)
    grazing = (1 - np.clip(-cos_view, 0, 1)) ** 5 * (1 - surface.roughness)
    glossy = (mirror + (1 - mirror) * grazing) * seen
    out: Floats = plain * diffuse
    out += glossy
    out *= column(EARTH_COLOR) * np.float32(light.earth)
    return out


def _sides(mesh: Mesh) -> Floats:
    """Return normals (3, F) of the triangles themselves, on the side of their corners' normals.

    Where a surface is smooth, the normals at its points may face away from a camera that sees its
    front.
    """
    sides = mesh.face_normals.T.astype(np.float32)
    outward = dot(sides, mesh.corner_normals.sum(axis=1).T)
    return np.asarray(np.where(outward < 0, -sides, sides))


def _face_eye(normal: Floats, rays: Floats) -> Floats:
    """Tilt unit normals (3, N) that face away from the camera until they are seen edge-on."""
    tilt = np.maximum(dot(normal, rays) + np.float32(0.02), 0)
    return unit(normal - tilt * rays)


def _blend(corners: Floats, weights: Floats) -> Floats:
    """Interpolate corner values (N, 3, K) by barycentric weights (3, N); returns (K, N)."""
    first, second, third = weights
    return np.asarray(first * corners[:, 0].T + second * corners[:, 1].T + third * corners[:, 2].T)
