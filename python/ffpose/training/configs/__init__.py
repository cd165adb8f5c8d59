"""Configurations of published trainings that come with ffpose, for ``ffpose train --config``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

FOLDER = Path(str(resources.files(__name__)))
"""Folder of the configurations, ``NAME.yaml``."""


def names() -> list[str]:
    """Return the sorted names of the configurations."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def resolve(path_or_name: str | Path) -> Path:
    """Return the path of a configuration; an existing file has precedence over a name.

    Raises:
        FileNotFoundError: It is neither a file nor one of `names`; the message lists them.
    """
    path = Path(path_or_name)
    if path.is_file():
        return path
    if str(path) in names():
        return FOLDER / f"{path}.yaml"
    expected = f"a YAML file or a name (one of {', '.join(names())})"
    raise FileNotFoundError(f"config: expected {expected}, got {path}")
