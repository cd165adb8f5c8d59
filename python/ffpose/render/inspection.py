"""A look at a mesh before learning on it: size, materials, twelve views, and what is doubtful."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ffpose._internal.files import atomic_write, write_json
from ffpose.geometry import Camera, Pose
from ffpose.geometry.rotations import from_matrix
from ffpose.imaging.overlay import draw_axes, tiled
from ffpose.render.renderer import draw_alone, prepared
from ffpose.render.shading.rays import cast_rays, find_window
from ffpose.render.shading.reflection import Light
from ffpose.render.shading.tracer import Tracer
from ffpose.render.spacecraft.craft import Craft, bounding_sphere
from ffpose.render.spacecraft.materials import SLOTS
from ffpose.render.spacecraft.meshfile import Up
from ffpose.render.symmetry import find_symmetries

TILE, COLUMNS, CAPTION = 320, 4, 22
"""Side of a view in pixels, views in a row, and height of the text below each."""

DISK = 0.46
"""Radius of the bounding sphere in a view, in its sides."""

AWAY = 8.0
"""Distance of the camera in radii of the bounding sphere: nearly a parallel projection."""

SMALLEST_M, LARGEST_M = 0.05, 150.0
"""Diameters of spacecraft, from a picosatellite's to a station's."""

UNITS = {0.001: "millimeters", 0.01: "centimeters", 0.0254: "inches", 0.3048: "feet"}
"""Units of mesh files, in meters."""

INSIDE = 0.02
"""Share of what is seen that may be the inside of surfaces."""

LEAST_SEEN = 0.01
"""Share of the bounding sphere's disk below which a spacecraft is hardly seen."""

OPAQUE = 0.95
"""Alpha from which a material counts as solid."""

GRAY = 0.05
"""Light of the background."""

WHITE = 1.2
"""Light that is white in the views."""

DIRECTIONS = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
    "+x +y +z": (1, 1, 1),
    "-x +y +z": (-1, 1, 1),
    "-x -y +z": (-1, -1, 1),
    "+x -y +z": (1, -1, 1),
    "+x +y -z": (1, 1, -1),
    "-x -y -z": (-1, -1, -1),
}
"""Where the camera is in each view."""


def inspect_mesh(craft: Craft, out: str | Path, *, y_up: bool = False) -> dict[str, Any]:
    """Describe a spacecraft, and write ``summary.json`` and ``views.png``.

    Args:
        craft: The spacecraft.
        out: The folder to write; created if missing.
        y_up: As of `find_doubts`.

    Returns:
        The contents of ``summary.json``: ``size_m`` by axis, ``triangles``, ``materials``,
        ``center_m`` and ``radius_m`` of the bounding sphere, ``origin_offset_m`` from its center,
        ``inside_seen``, the share of what twelve views show that is the inside of surfaces,
        ``disk_seen``, the share that they show of the sphere's disk,
        ``symmetry``, that of `ffpose.render.symmetry.Symmetries`, None where there is no attitude,
        and ``doubts``, sentences that name the option that mends each.
    """
    summary = _measured(craft)
    summary["doubts"] = _doubts(craft, summary, y_up)
    try:
        summary["symmetry"] = find_symmetries(craft).to_json()
    except ValueError as error:
        summary["symmetry"] = None
        summary["doubts"].append(str(error))
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(folder / "views.png") as path:
        view_sheet(craft).save(path, "PNG")
    write_json(folder / "summary.json", summary)
    return summary


def is_y_up(mesh: Path, up: Up) -> bool:
    """Return whether a mesh file's format has y up, and its axes are those of the object."""
    return mesh.suffix.lower() in (".glb", ".gltf") and up == "z"


def find_doubts(craft: Craft, *, y_up: bool = False) -> list[str]:
    """Return what may be wrong with a mesh, each with the option that mends it if one does.

    ``y_up``: whether `is_y_up` holds of its file.
    """
    return _doubts(craft, _measured(craft), y_up)


def _measured(craft: Craft) -> dict[str, Any]:
    """Return what `inspect_mesh` measures."""
    center, radius = bounding_sphere(craft.corners)
    inside, disk = _shares_seen(craft, center, radius)
    return {
        "size_m": np.ptp(craft.corners, axis=0).tolist(),
        "triangles": len(craft.mesh.faces),
        "materials": [_material(craft, number) for number in range(len(craft.materials))],
        "center_m": center.tolist(),
        "radius_m": radius,
        "origin_offset_m": float(np.linalg.norm(center)),
        "inside_seen": inside,
        "disk_seen": disk,
    }


def view_sheet(craft: Craft) -> Image.Image:
    """Draw a spacecraft from twelve sides, with its axes and a meter bar."""
    center, radius = bounding_sphere(craft.corners)
    return tiled([_tile(craft, name, center, radius) for name in DIRECTIONS], COLUMNS)


def studio_view(craft: Craft, pose: Pose, camera: Camera) -> NDArray[np.uint8]:
    """Render a spacecraft before gray, the sun over the camera's left shoulder.

    Returns:
        (H, W, 3) uint8, RGB.
    """
    back = pose.rotation.T
    sun, below = np.array([-0.45, -0.5, -0.74]), np.array([0.3, 0.8, -0.52])
    light = Light(
        (back @ sun / np.linalg.norm(sun)).astype(np.float32),
        (back @ below / np.linalg.norm(below)).astype(np.float32),
        earth=0.8,
    )
    radiance = draw_alone(craft, pose, camera, light, GRAY)
    level = np.clip(radiance / WHITE, 0, 1) ** (1 / 2.2)
    return np.asarray(np.round(level * 255), np.uint8)


def _view(name: str, center: NDArray[np.float64], radius: float) -> tuple[Pose, Camera]:
    """Return pose and camera of a view: z is up in it, or y where it looks along z."""
    toward = np.array(DIRECTIONS[name], float)
    toward /= np.linalg.norm(toward)
    forward = -toward
    upward = np.array([0.0, 1.0, 0.0] if abs(toward[2]) > 0.99 else [0.0, 0.0, 1.0])
    right = np.cross(forward, upward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    eye = center + toward * AWAY * radius
    focal = DISK * TILE * math.sqrt(AWAY**2 - 1)
    camera = Camera(TILE, TILE, focal, focal, TILE / 2, TILE / 2)
    return Pose(-rotation @ eye, from_matrix(rotation)), camera


def _tile(craft: Craft, name: str, center: NDArray[np.float64], radius: float) -> Image.Image:
    pose, camera = _view(name, center, radius)
    image = Image.fromarray(studio_view(craft, pose, camera))
    if np.linalg.norm(center) < 2 * radius:
        image = draw_axes(image, pose, camera, 0.5 * radius, width=2)
    tile = Image.new("RGB", (TILE, TILE + CAPTION), "white")
    tile.paste(image)
    draw, font = ImageDraw.Draw(tile), ImageFont.load_default(13)
    bar = _round_length(0.6 * radius)
    pixels = bar * camera.fx / (AWAY * radius)
    draw.line([(8, TILE - 10), (8 + pixels, TILE - 10)], fill="white", width=3)
    draw.text((8, TILE - 28), f"{bar:g} m", fill="white", font=font)
    draw.text((4, TILE + 3), f"from {name}", fill="black", font=font)
    return tile


def _round_length(length: float) -> float:
    """Return the longest of 1, 2 or 5 times a power of ten that is no longer than a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= length * (1 + 1e-9))


def _shares_seen(craft: Craft, center: NDArray[np.float64], radius: float) -> tuple[float, float]:
    """Return, from all views, the shares of hits on the back of a face, and of the disk hit."""
    tracer, normals = Tracer(craft.mesh), craft.mesh.face_normals
    back = count = shown = 0
    for name in DIRECTIONS:
        pose, camera = _view(name, center, radius)
        window = find_window(craft.corners, pose, camera)
        if window is None:
            continue
        seen = cast_rays(tracer, window, camera, pose, 1)
        facing = np.einsum("ij,ji->i", normals[seen.hits.face], seen.rays)
        back, count = back + int((facing > 0).sum()), count + len(facing)
        shown += len(cast_rays(prepared(craft)[0], window, camera, pose, 1).hits.ray)
    return back / max(count, 1), shown / (len(DIRECTIONS) * math.pi * (DISK * TILE) ** 2)


def _material(craft: Craft, number: int) -> dict[str, Any]:
    material, its = craft.materials[number], craft.mesh.material == number
    colors = craft.mesh.colors
    tint = np.ones(3) if colors is None or not its.any() else colors[its, :, :3].mean(axis=(0, 1))
    return {
        "triangles": int(its.sum()),
        "color": (tint * material.color).tolist(),
        "roughness": material.roughness,
        "metallic": material.metallic,
        "alpha": material.alpha,
        "two_sided": material.two_sided,
        "textures": {
            slot.removesuffix("_map"): [texture.image.width, texture.image.height]
            for slot in SLOTS
            if (texture := getattr(material, slot)) is not None
        },
    }


def _doubts(craft: Craft, summary: dict[str, Any], y_up: bool) -> list[str]:
    doubts = []
    across = 2 * summary["radius_m"]
    if not SMALLEST_M <= across <= LARGEST_M:
        fits = {scale: unit for scale, unit in UNITS.items() if 0.3 <= across * scale <= LARGEST_M}
        fits = fits or {_round_length(5 / across): ""}
        ways = [
            f"--mesh-scale {scale:g} makes it {across * scale:.3g} m"
            + (f" if the file is in {unit}" if unit else "")
            for scale, unit in fits.items()
        ]
        doubts.append(
            f"the mesh is {across:.3g} m across, spacecraft are {SMALLEST_M:g} to "
            f"{LARGEST_M:g}: {', '.join(ways)}"
        )
    if summary["origin_offset_m"] > summary["radius_m"]:
        doubts.append(
            f"the origin lies {summary['origin_offset_m']:.3g} m from the middle of the bounding "
            f"sphere, outside of it (radius {summary['radius_m']:.3g} m): --mesh-center moves it"
        )
    thin = sum(each["triangles"] for each in summary["materials"] if each["alpha"] < OPAQUE)
    if thin > summary["triangles"] / 2:
        doubts.append(
            f"{thin} of {summary['triangles']} triangles are of materials that one sees through, "
            f"alpha below {OPAQUE:g}: if the spacecraft is solid, make them opaque in the file"
        )
    if summary["disk_seen"] < LEAST_SEEN:
        doubts.append(
            f"the spacecraft covers {summary['disk_seen']:.1%} of its bounding sphere's disk, "
            "which thin or far parts widen: delete what is no part of it from the file, or let it "
            "learn nearer, --distance NEAR FAR"
        )
    share = summary["inside_seen"]
    if share > INSIDE:
        hidden = not all(material.two_sided for material in craft.materials)
        what = "most faces are inside out" if share > 0.5 else "faces are inside out or missing"
        doubts.append(
            f"{what}: {share:.0%} of what is seen is the back of a surface, "
            + (
                "which one-sided materials do not show: --mesh-two-sided shows it"
                if hidden
                else "which is drawn as its front is"
            )
        )
    if y_up:
        doubts.append(
            "glTF files have y up, and their axes are the object frame's: --mesh-up y turns y to z"
        )
    return doubts
