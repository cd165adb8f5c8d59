"""Shipped networks, by name: weights, and the graphs that ``make graphs`` exports from them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

FOLDER = Path(str(resources.files("ffpose"))) / "weights"
"""Folder of ``NAME.safetensors`` with their checksums, and of ``NAME.onnx``."""

WEIGHTS, GRAPH = ".safetensors", ".onnx"
"""Suffixes of the files of networks."""


def names() -> list[str]:
    """Return the sorted names of the weights in this installation."""
    return sorted(path.stem for path in FOLDER.glob(f"*{WEIGHTS}"))


def resolve(path_or_name: str | Path, suffix: str = WEIGHTS, *, argument: str = "weights") -> Path:
    """Return the path of a network's file; an existing file has precedence over a name.

    Args:
        path_or_name: A path, which is returned unchanged, or one of `names`, without folder and
            suffix.
        suffix: Of the file that a name stands for, `WEIGHTS` or `GRAPH`.
        argument: Name of the argument, which the error begins with.

    Raises:
        FileNotFoundError: A word without folder and suffix is neither a file nor a name; the
            message lists the names.
    """
    path = Path(path_or_name)
    if path.is_file() or path.suffix or len(path.parts) != 1:
        return path
    if path.name in names():
        return FOLDER / f"{path}{suffix}"
    known = f"one of {', '.join(names())}" if names() else "none is installed by name"
    raise FileNotFoundError(f"{argument}: expected a file or a name ({known}), got {path}")
