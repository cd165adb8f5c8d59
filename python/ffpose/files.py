"""Files appear whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it to ``path`` when the block ends well.

    The temporary file lies in a new folder beside ``path`` and keeps its name, so that a writer
    that goes by the suffix works, and the rename stays within one file system. When the block
    raises, nothing remains and an older file at ``path`` is as it was.

    Args:
        path: Where the file shall be; its folder must exist.

    Yields:
        The path to write to.
    """
    target = Path(path)
    with tempfile.TemporaryDirectory(prefix=".", dir=target.parent) as folder:
        temporary = Path(folder) / target.name
        yield temporary
        temporary.replace(target)


def expect_folder(path: str | Path) -> None:
    """Check, before work is done for it, that ``path`` is a folder or can be made one.

    Raises:
        NotADirectoryError: It, or what shall hold it, is a file.
    """
    there = next(place for place in (Path(path), *Path(path).absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"expected a folder, got the file {there}")
