"""A set of images of one's own spacecraft, as a JSON file that stands wherever a set's name does.

The file names the mesh, by a path relative to itself, and the ranges of the poses; the name of the
spacecraft in manifests and caches holds the SHA-256 of all that the mesh consists of, so no image
of another version of it is taken for one of this.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import MISSING, asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from ffpose._internal.files import read_json, shortened, write_json
from ffpose.errors import DataError, expect
from ffpose.geometry import Camera
from ffpose.render.scene import SCENES, Scene, lamp_for
from ffpose.render.spacecraft.meshfile import Up, load_craft

SUFFIX = ".json"

TYPES: dict[str, tuple[type, ...]] = {
    "name": (str,),
    "mesh": (str,),
    "mesh_scale": (int, float),
    "distance_m": (list,),
    "attitude_range_deg": (list,),
    "camera": (dict,),
    "mesh_up": (str,),
    "mesh_center": (bool,),
    "mesh_two_sided": (bool,),
}
"""Types of the values in the file, by key."""


@dataclass(frozen=True)
class SceneFile:
    """Definition of a set of scenes of a mesh, as its file has it.

    Attributes:
        name: Name of the set.
        mesh: Mesh file, in the file relative to its folder.
        mesh_scale: Meters per unit of the mesh.
        distance_m: ``(least, most)`` distance of the object's origin from the camera.
        attitude_range_deg: As of `ffpose.render.Scene`.
        camera: Camera of the images.
        mesh_up: Axis of the mesh file that becomes the object's z.
        mesh_center: Whether the origin is moved to the middle of the bounding sphere.
        mesh_two_sided: Whether the back of one-sided surfaces is shown.
    """

    name: str
    mesh: Path
    mesh_scale: float
    distance_m: tuple[float, float]
    attitude_range_deg: tuple[float, float, float]
    camera: Camera
    mesh_up: Up = "z"
    mesh_center: bool = False
    mesh_two_sided: bool = False

    def scene(self) -> Scene:
        """Return the set, with the mesh read.

        Raises:
            ffpose.DataError: The file is no mesh that can be read.
            ValueError: An option of the mesh, or a range of the set, is out of its limits.
        """
        craft = load_craft(
            self.mesh,
            self.mesh_scale,
            self.mesh_up,
            center=self.mesh_center,
            two_sided=self.mesh_two_sided,
        )
        return Scene(
            self.name,
            craft,
            self.distance_m,
            self.distance_m[1],  # as far off the axis as the frame goes
            attitude_range_deg=self.attitude_range_deg,
            camera=self.camera,
            lamp=lamp_for(craft),
        )

    def write(self, path: Path) -> None:
        """Write the file."""
        mesh = self.mesh.resolve()
        with suppress(ValueError):  # Windows: on another drive
            mesh = Path(os.path.relpath(mesh, path.resolve().parent))
        write_json(path, asdict(self) | {"mesh": mesh.as_posix()}, 1)


def find_scene(
    scene: Scene | str | Path, attitude_range_deg: tuple[float, float, float] | None = None
) -> Scene:
    """Return a set by its name, or by its file, whose name ends with ``.json``.

    Args:
        scene: One of `ffpose.render.SCENES`, a file, or the set itself.
        attitude_range_deg: Limits of the absolute roll, pitch and yaw, degrees; None for the set's.

    Raises:
        ValueError: The name is not known.
        FileNotFoundError: There is no such file.
        ffpose.DataError: The file, or the mesh that it names, cannot be used.
    """
    if isinstance(scene, Scene):
        found = scene
    elif Path(scene).suffix == SUFFIX:
        found = _opened(Path(scene))
    else:
        known = f"one of {', '.join(SCENES)}, or a scene.json; a mesh is --mesh's"
        expect(scene in SCENES, "scene", known, scene)
        found = SCENES[str(scene)]
    if attitude_range_deg is None:
        return found
    return replace(found, attitude_range_deg=attitude_range_deg)


def _opened(path: Path) -> Scene:
    """Return the set of a file, opened once: until its mesh changes, not what that refers to."""
    file = read_scene_file(path)
    status = file.mesh.stat() if file.mesh.exists() else None
    try:
        return _opened_once(file, None if status is None else (status.st_mtime_ns, status.st_size))
    except DataError:
        raise
    except ValueError as error:
        raise DataError(str(error), path) from error


@lru_cache(maxsize=4)
def _opened_once(file: SceneFile, _: tuple[int, int] | None) -> Scene:
    return file.scene()


def read_scene_file(path: Path) -> SceneFile:
    """Read the file.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: It is not JSON, or has other keys or values.
    """
    values = read_json(path)
    needed = {field.name for field in fields(SceneFile) if field.default is MISSING}
    if not isinstance(values, dict) or not needed <= set(values) <= set(TYPES):
        raise DataError(f"expected the keys {', '.join(TYPES)}, got {shortened(values)}", path)
    try:
        for name, value in values.items():
            kinds = TYPES[name]
            expect(type(value) in kinds, name, f"a value of type {kinds[-1].__name__}", value)
        read = {
            "mesh": path.parent / values["mesh"],
            "mesh_scale": float(values["mesh_scale"]),
            "distance_m": _numbers(values, "distance_m", 2),
            "attitude_range_deg": _numbers(values, "attitude_range_deg", 3),
            "camera": Camera(**values["camera"]),
        }
    except (OverflowError, TypeError, ValueError) as error:
        raise DataError(str(error), path) from error
    return SceneFile(**values | read)


def _numbers(values: dict[str, Any], name: str, count: int) -> tuple[float, ...]:
    numbers = values[name]
    if len(numbers) != count or any(type(number) not in (int, float) for number in numbers):
        raise ValueError(f"{name}: expected {count} numbers, got {shortened(numbers)}")
    return tuple(map(float, numbers))
