"""``demo.json``: the settings of a demo's folder, so that only the same demo resumes in it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ffpose._internal.files import read_json, write_json
from ffpose.errors import DataError

FILE_NAME = "demo.json"

FOLDERS = ("images", "views", "training", "evaluation")
"""Folders of a demo whose files are reused on resume."""

REMEDY = "remove the folder, or write to another with --out"


@dataclass
class DemoRecord:
    """The settings of a demo's folder, and the time that its images took.

    ``images_rendered`` are those of the finished runs, in ``render_seconds``; ``views_seconds`` is
    0 where there are no training views yet.
    """

    settings: dict[str, Any]
    images_rendered: int = 0
    render_seconds: float = 0.0
    views_seconds: float = 0.0

    @classmethod
    def open(cls, out: Path, settings: Mapping[str, Any]) -> DemoRecord:
        """Read the record of a folder, or make a new one for a new folder.

        Raises:
            ValueError: The folder holds a demo with other settings, so its weights cannot be used.
            DataError: The record cannot be read.
        """
        # Round trip through JSON, so that they compare equal to settings read from a file.
        wanted = json.loads(json.dumps(settings))
        path = out / FILE_NAME
        if not path.exists():
            for name in FOLDERS:
                if (out / name).exists():
                    raise ValueError(
                        f"{out}: expected a new folder or a demo begun there, got {name}/ without "
                        f"{FILE_NAME}; {REMEDY}"
                    )
            return cls(wanted)
        try:
            record = cls(**read_json(path))
            there = dict(record.settings)
        except (TypeError, ValueError) as error:
            text = error.message if isinstance(error, DataError) else str(error)
            raise DataError(f"expected the record of a demo: {text}; {REMEDY}", path) from error
        for name, value in wanted.items():
            if there.get(name) != value:
                raise ValueError(
                    f"{out}: expected {name} {there.get(name)} as the demo there, got {value}; "
                    f"{REMEDY}"
                )
        return record

    def write(self, out: Path) -> None:
        """Write the record into the folder ``out``."""
        write_json(out / FILE_NAME, asdict(self))
