"""What a folder of images was made from, and the fingerprint of every file in it.

A run that finds images beside its own in the folder leaves its fingerprints in a part,
``manifest_FIRST-LAST.json``, until a run over all images writes them into ``manifest.json``: so a
shard reads and writes no more than its own, and shards never write to one file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ffpose.errors import DataError
from ffpose.files import atomic_write
from ffpose.render.layers import coordinates_limit
from ffpose.render.scene import Scene

FILE_NAME = "manifest.json"
PACKAGES = ("ffpose", "numpy", "embreex", "pillow")
"""Their versions are noted, because the exact bytes may depend on them."""


@dataclass(frozen=True)
class Manifest:
    """The contents of `manifest.json`.

    Attributes:
        parameters: scene, seed, size, and which layers are written: with the index, all that the
            files of an image depend on. With the layer `coordinates`, also the metres that its
            codes stand for (`ffpose.render.coordinates_limit`).
        versions: of the packages that made the images.
        files: SHA-256 of each file by name; empty until a run has finished.
    """

    parameters: dict[str, Any]
    versions: dict[str, str]
    files: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, scene: Scene, seed: int, size: tuple[int, int], labels: tuple[str, ...]
    ) -> Manifest:
        """The manifest of a set that is about to be made."""
        parameters = {
            "scene": scene.parameters(),
            "seed": seed,
            "size": list(size),
            "labels": list(labels),
        }
        if "coordinates" in labels:
            parameters["coordinates_limit_m"] = coordinates_limit(scene.build())
        # Through JSON, so that it compares equal to one that was read.
        return cls(json.loads(json.dumps(parameters)), {name: _version(name) for name in PACKAGES})

    @classmethod
    def read(cls, path: Path) -> Manifest | None:
        """The manifest that a file holds, None if there is no such file.

        Raises:
            DataError: the file is not a manifest.
        """
        if not path.exists():
            return None
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            return cls(content["parameters"], content["versions"], content["files"])
        except (ValueError, KeyError, TypeError) as error:
            raise DataError(
                f"expected a manifest of `ffpose render`, got {error!r}", path
            ) from error

    def write(self, target: Path) -> None:
        """Write the manifest into a file, whole or not at all."""
        content = {"parameters": self.parameters, "versions": self.versions, "files": self.files}
        with atomic_write(target) as path:
            path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def part_name(indices: range) -> str:
    """The file of the part that a run over these indices leaves."""
    return f"manifest_{indices[0]}-{indices[-1]}.json"


def parts(folder: Path, indices: range) -> Iterator[Path]:
    """The parts in a folder that hold something of these indices."""
    for path in folder.glob("manifest_*.json"):
        match = re.fullmatch(r"manifest_(\d+)-(\d+)\.json", path.name)
        if match and int(match[1]) <= indices[-1] and indices[0] <= int(match[2]):
            yield path


def difference(old: Manifest, new: Manifest) -> str | None:
    """What keeps `new` from carrying on with a folder of `old`, None if nothing does."""
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


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
