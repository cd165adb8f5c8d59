"""The weights that come with the package, by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

FOLDER = Path(str(resources.files("ffpose"))) / "weights"
"""Holds ``NAME.safetensors``, and its checksum beside it."""


def names() -> list[str]:
    """Return the names of the weights that this installation holds, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.safetensors"))


def resolve(path_or_name: str | Path) -> Path:
    """Return the file of weights; a file of that path goes before a name.

    Args:
        path_or_name: A path, which is returned as it is, or one of `names`: a word without folder
            and suffix.

    Raises:
        FileNotFoundError: Such a word that is neither a file nor a name; the text lists the names.
    """
    path = Path(path_or_name)
    if path.is_file() or path.suffix or len(path.parts) != 1:
        return path
    if path.name in names():
        return FOLDER / f"{path}.safetensors"
    known = f"one of {', '.join(names())}" if names() else "none is installed by name"
    raise FileNotFoundError(f"weights: expected a file or a name ({known}), got {path}")
