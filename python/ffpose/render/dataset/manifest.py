"""The manifest of a rendered set: its parameters, package versions, and a hash of every file.

A run over part of a set (a shard) writes its hashes to a file of its own,
``manifest_FIRST-LAST.json``. A later run over the whole set merges these into ``manifest.json``.
So a shard reads and writes its own files alone, and no two shards write to one file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from ffpose._internal.files import read_json, shortened, write_json
from ffpose._internal.machine import package_versions
from ffpose.errors import DataError
from ffpose.render.layers import coordinates_limit, depth_step
from ffpose.render.scene import Scene

FILE_NAME = "manifest.json"
PACKAGES = ("ffpose", "numpy", "embreex", "pillow")
"""Packages whose versions are recorded, because the exact bytes may depend on them."""


@dataclass(frozen=True)
class Manifest:
    """The contents of `manifest.json`.

    Attributes:
        parameters: Scene, seed, size, and which layers are written: with the index, all that the
            files of an image depend on. With the layers `coordinates` and `depth`, also the
            meters that their codes stand for (`ffpose.render.coordinates_limit`, `depth_step`).
        versions: Version of each of `PACKAGES` when the images were made.
        files: SHA-256 of each file by name; empty until a run has finished.
    """

    parameters: dict[str, Any]
    versions: dict[str, str]
    files: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, scene: Scene, seed: int, size: tuple[int, int], labels: tuple[str, ...]
    ) -> Manifest:
        """Build the manifest of a set that is about to be rendered."""
        parameters = {
            "scene": scene.parameters(),
            "seed": seed,
            "size": list(size),
            "labels": list(labels),
        }
        if "coordinates" in labels:
            parameters["coordinates_limit_m"] = coordinates_limit(scene.build())
        if "depth" in labels:
            parameters["depth_step_m"] = depth_step(scene)
        # Through JSON, so that it compares equal to one that was read.
        return cls(json.loads(json.dumps(parameters)), versions_of(scene))

    @classmethod
    def read(cls, path: Path) -> Manifest | None:
        """Read a manifest, or return None if there is no such file; a DataError if it is none."""
        if not path.exists():
            return None
        content = read_json(path)
        names = [each.name for each in fields(cls)]
        parts = [content.get(name) for name in names] if isinstance(content, dict) else [None]
        if not all(isinstance(part, dict) for part in parts):
            expected = f"expected a manifest of `ffpose render`, the objects {', '.join(names)}"
            raise DataError(f"{expected}; got {shortened(content)}", path)
        return cls(*parts)

    def write(self, target: Path) -> None:
        """Write the manifest into a file, whole or not at all."""
        write_json(target, asdict(self), 1)


def versions_of(scene: Scene) -> dict[str, str]:
    """Return the versions of the packages that the bytes of a set's images may depend on."""
    return package_versions(*PACKAGES, *(("mitsuba",) if scene.renderer == "mitsuba" else ()))


def part_name(indices: range) -> str:
    """Return the name of the partial manifest that a run over these indices writes."""
    return f"manifest_{indices[0]}-{indices[-1]}.json"


def parts(folder: Path, indices: range) -> Iterator[Path]:
    """Yield the partial manifests in a folder that cover some of these indices."""
    for path in folder.glob("manifest_*.json"):
        match = re.fullmatch(r"manifest_(\d+)-(\d+)\.json", path.name)
        if match and int(match[1]) <= indices[-1] and indices[0] <= int(match[2]):
            yield path


def difference(old: Manifest, new: Manifest) -> str | None:
    """Describe why a run with `new` cannot resume a folder of `old`; None if it can."""
    mine, theirs = _flat(new.parameters | new.versions), _flat(old.parameters | old.versions)
    changed = [
        f"{key} {theirs.get(key)!r} there, {mine.get(key)!r} now"
        for key in sorted(mine.keys() | theirs.keys())
        if mine.get(key) != theirs.get(key)
    ]
    return "; ".join(changed[:4]) + ("; …" if len(changed) > 4 else "") if changed else None


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat
