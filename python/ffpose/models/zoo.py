"""Shipped weights, by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

FOLDER = Path(str(resources.files("ffpose"))) / "weights"
"""Folder of the shipped weights, ``NAME.safetensors`` with their checksums."""


def names() -> list[str]:
    """Return the sorted names of the weights in this installation."""
    return sorted(path.stem for path in FOLDER.glob("*.safetensors"))


def resolve(path_or_name: str | Path) -> Path:
    """Return the path of a weights file; an existing file has precedence over a name.

    Args:
        path_or_name: A path, which is returned unchanged, or one of `names`, without folder and
            suffix.

    Raises:
        FileNotFoundError: A word without folder and suffix is neither a file nor a name; the
            message lists the names.
    """
    path = Path(path_or_name)
    if path.is_file() or path.suffix or len(path.parts) != 1:
        return path
    if path.name in names():
        return FOLDER / f"{path}.safetensors"
    known = f"one of {', '.join(names())}" if names() else "none is installed by name"
    raise FileNotFoundError(f"weights: expected a file or a name ({known}), got {path}")
