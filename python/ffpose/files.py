"""Files appear whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ffpose.errors import DataError

_PREFIX = ".ffpose-"
"""Of the folders that files are written in before they are renamed."""


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it to ``path`` when the block ends well.

    The temporary file lies in a new folder beside ``path`` and keeps its name, so that a writer
    that goes by the suffix works, and the rename stays within one file system. When the block
    raises, nothing remains and an older file at ``path`` is as it was. A process that is killed
    leaves that folder (`remove_leftovers`).

    Args:
        path: Where the file shall be; its folder must exist.

    Yields:
        The path to write to.
    """
    target = Path(path)
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=target.parent) as folder:
        temporary = Path(folder) / target.name
        yield temporary
        temporary.replace(target)


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with or without a byte order mark.

    Raises:
        FileNotFoundError: There is no such file.
        DataError: It is not in UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"expected text in UTF-8: {error}", path) from error


def remove_leftovers(folder: str | Path, older_than: float = 3600.0) -> None:
    """Remove what killed processes left of `atomic_write`.

    Args:
        folder: Where the files were to be.
        older_than: Seconds; younger ones may be of a process that is writing now.
    """
    for left in Path(folder).glob(f"{_PREFIX}*"):
        with suppress(FileNotFoundError):  # a writer that lives has just renamed its file
            if time.time() - left.stat().st_mtime > older_than:
                shutil.rmtree(left)


def expect_folder(path: str | Path) -> None:
    """Check, before work is done for it, that ``path`` is a folder or can be made one.

    Raises:
        NotADirectoryError: It, or what shall hold it, is a file.
    """
    there = next(place for place in (Path(path), *Path(path).absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"expected a folder, got the file {there}")
