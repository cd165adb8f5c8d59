"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
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
def atomic_write(path: str | Path, *, durable: bool = True) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it to ``path`` when the block ends well.

    The temporary file lies in a new folder beside ``path`` and keeps its name, so that a writer
    that goes by the suffix works, and the rename stays within one file system. When the block
    raises, nothing remains and an older file at ``path`` is as it was. A process that is killed
    leaves that folder (`remove_leftovers`).

    Args:
        path: Where the file shall be; its folder must exist.
        durable: Wait until the contents are on the disk before the rename, and the name after it,
            so that a loss of power leaves the old file or the new one. False saves some
            milliseconds a file, for what is checked and made again when it is lost.

    Yields:
        The path to write to.
    """
    target = Path(path)
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=target.parent) as folder:
        temporary = Path(folder) / target.name
        yield temporary
        if durable:
            _sync(temporary)
        temporary.replace(target)
        if durable:
            _sync(target.parent)


def _sync(path: Path) -> None:
    """Wait until a file's contents, or a folder's names, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file in hexadecimal, as ``sha256sum`` prints it."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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


def expect_room(folder: str | Path, need: int, what: str) -> None:
    """Check, before hours of work meet a full disk, that there is room for what will be written.

    Args:
        folder: Where it shall be; it need not exist.
        need: Bytes, at least.
        what: What needs them, for the error.

    Raises:
        OSError: There is no room; ``errno`` is ``ENOSPC``.
    """
    free = shutil.disk_usage(_nearest(folder)).free
    if free < need:
        room = f"need at least {need / 1e9:.1f} GB, got {free / 1e9:.1f} GB free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {what} {room}", str(folder))


def expect_folder(path: str | Path) -> None:
    """Check, before work is done for it, that ``path`` is a folder or can be made one.

    Raises:
        NotADirectoryError: It, or what shall hold it, is a file.
    """
    there = _nearest(path)
    if not there.is_dir():
        raise NotADirectoryError(f"expected a folder, got the file {there}")


def _nearest(path: str | Path) -> Path:
    """Return ``path``, or the nearest of the folders that shall hold it, which exists."""
    return next(place for place in (Path(path), *Path(path).absolute().parents) if place.exists())
