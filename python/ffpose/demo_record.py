"""``demo.json``: what the folder of a demo was begun with, so that it is taken up and not mixed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ffpose.errors import DataError
from ffpose.files import atomic_write

FILE_NAME = "demo.json"

FOLDERS = ("images", "views", "training", "evaluation")
"""Of a demo: their files are taken up, so they must be its own."""


@dataclass
class DemoRecord:
    """What a demo's folder was begun with, and what its images cost.

    Attributes:
        settings: What the demo was asked to do.
        images_rendered: How many images the runs that ended have rendered.
        render_seconds: The time they took for it.
        views_seconds: The time that the views of a training took; 0 where there are none yet.
    """

    settings: dict[str, Any]
    images_rendered: int = 0
    render_seconds: float = 0.0
    views_seconds: float = 0.0

    @classmethod
    def open(cls, out: Path, settings: Mapping[str, Any]) -> DemoRecord:
        """Return the record of a folder, a new one where nothing was begun there.

        Args:
            out: The folder.
            settings: What the demo is asked to do, as JSON can hold it.

        Raises:
            ValueError: The folder holds a demo of other settings, whose weights are not this one's.
            DataError: The record cannot be read.
        """
        # Through JSON, so that they compare equal to settings that were read.
        wanted = json.loads(json.dumps(settings))
        path = out / FILE_NAME
        if not path.exists():
            for name in FOLDERS:
                if (out / name).exists():
                    raise ValueError(
                        f"{out}: expected a new folder or a demo begun there, got {name}/ without "
                        f"{FILE_NAME}; remove the folder, or write to another with --out"
                    )
            return cls(wanted)
        try:
            record = cls(**json.loads(path.read_text()))
            there = dict(record.settings)
        except (ValueError, TypeError) as error:
            raise DataError(f"expected the record of a demo: {error}", path) from error
        for name, value in wanted.items():
            if there.get(name) != value:
                raise ValueError(
                    f"{out}: expected {name} {there.get(name)} as the demo there, got {value}; "
                    "remove the folder, or write to another with --out"
                )
        return record

    def write(self, out: Path) -> None:
        """Write the record into the folder ``out``."""
        with atomic_write(out / FILE_NAME) as path:
            path.write_text(json.dumps(asdict(self), indent=2) + "\n")
