"""Shipped networks, by name: weights, and the graphs that ``make graphs`` exports from them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

FOLDER = Path(str(resources.files("ffpose"))) / "weights"
"""Folder of ``NAME.safetensors`` with their checksums, and of ``NAME.onnx``."""

INITIAL = FOLDER / "initial"
"""Folder of weights that a training may start from, but that pose no spacecraft."""

WEIGHTS, GRAPH = ".safetensors", ".onnx"
"""Suffixes of the files of networks."""


def names(folder: Path | None = None) -> list[str]:
    """Return the sorted names of the weights in this installation, in `FOLDER` or another."""
    return sorted(path.stem for path in (folder or FOLDER).glob(f"*{WEIGHTS}"))


def resolve(path_or_name: str | Path, suffix: str = WEIGHTS) -> Path:
    """Return the path of a network's file; an existing file has precedence over a name.

    A path is returned unchanged; one of `names`, without folder and suffix, stands for the file of
    that ``suffix``.

    Raises:
        FileNotFoundError: A word without folder and suffix is neither a file nor a name; the
            message lists the names.
    """
    return _resolved(path_or_name, [FOLDER], suffix, "weights")


def resolve_initial(path_or_name: str | Path) -> Path:
    """Return the path of weights that a training starts from, as `resolve`; `INITIAL` has more."""
    return _resolved(path_or_name, [FOLDER, INITIAL], WEIGHTS, "init")


def _resolved(path_or_name: str | Path, folders: list[Path], suffix: str, argument: str) -> Path:
    path = Path(path_or_name)
    if path.is_file() or path.suffix or len(path.parts) != 1:
        return path
    for folder in folders:
        if path.name in names(folder):
            return folder / f"{path}{suffix}"
    there = sorted(name for folder in folders for name in names(folder))
    known = f"one of {', '.join(there)}" if there else "none is installed by name"
    text = f"{argument}: expected a file or a name ({known}), got {path}"
    if path.name in names(INITIAL):
        text += ", which poses no spacecraft: a training starts from it, --init"
    raise FileNotFoundError(text)
