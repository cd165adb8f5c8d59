"""File utilities: atomic writes, hashes, text and JSON, and checks of folders and free space."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import reprlib
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ffpose.errors import DataError

_PREFIX = ".ffpose-"
"""Prefix of the temporary folders that files are written in before they are renamed."""

_held = set[int]()
"""Descriptors of the folders that `held` keeps."""

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80
_SHORT.maxdict = _SHORT.maxlist = 12


@contextmanager
def atomic_write(path: str | Path, *, durable: bool = True) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename it to ``path`` if the block succeeds.

    The temporary file has the same name as ``path``, whose folder must exist, and lies in a new
    folder beside it, so that writers can choose a format by the suffix and the rename stays within
    one file system. Of a symbolic link, the file that it names is replaced. If the block raises,
    nothing remains and an older file is unchanged. A killed process leaves the temporary folder
    behind (`remove_leftovers`).

    ``durable``: the contents are flushed to disk before the rename and the folder after it, so that
    a power loss leaves either the old file or the new one. Without it a file, that is checked and
    can be made again, takes some milliseconds less.
    """
    target = Path(path).resolve()
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=target.parent) as folder:
        temporary = Path(folder) / Path(path).name
        yield temporary
        if durable:
            _sync(temporary)
        temporary.replace(target)
        if durable:
            _sync(target.parent)


def _sync(path: Path) -> None:
    """Flush a file's contents, or a folder's entries, to disk; Windows opens no folder."""
    windows = os.name == "nt"  # which flushes writers alone
    if windows and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if windows else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def same_place(one: object, other: object) -> bool:
    """Return whether two values are equal, or paths of one file however they are written."""
    if isinstance(one, str | Path) and isinstance(other, str | Path):
        return Path(one).resolve() == Path(other).resolve()
    return one == other


def write_text(path: str | Path, text: str) -> None:
    """Write text in UTF-8 into a file, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value: object, indent: int | None = 2) -> None:
    """Write a value as JSON into a file, whole or not at all."""
    write_text(path, json.dumps(value, indent=indent) + "\n")


def write_csv(path: str | Path, rows: Iterable[Iterable[object]], *, durable: bool = True) -> None:
    """Write a table with its header, as `atomic_write`; numbers keep every digit."""
    with (
        atomic_write(path, durable=durable) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file, lineterminator="\n").writerows(rows)


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file in hexadecimal, as ``sha256sum`` prints it."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; a DataError if it is none."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"expected text in UTF-8: {error}", path) from error


def read_json(path: Path) -> Any:
    """Read a JSON file in UTF-8.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: The file is not in UTF-8, an object has a key twice, or as in `json_errors`.
    """
    text = read_text(path)
    with json_errors(path):
        return distinct_keys(path).decode(text)


def distinct_keys(path: Path, line: int | None = None) -> json.JSONDecoder:
    """Return a decoder that raises a `DataError` where an object of the file has a key twice."""

    def distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name, value in pairs:
            if name in values:
                raise DataError(f"expected each key once, got {shortened(name)} twice", path, line)
            values[name] = value
        return values

    return json.JSONDecoder(object_pairs_hook=distinct)


@contextmanager
def json_errors(path: Path, line: int | None = None) -> Iterator[None]:
    """Turn the errors of Python's JSON decoder within the block into a `DataError` of a file.

    That is text which is no JSON, or is nested more deeply than Python's recursion limit, or has an
    integer of more digits than Python converts. ``line`` is where the text begins.
    """
    try:
        yield
    except json.JSONDecodeError as error:
        raise DataError(f"not JSON: {error.msg}", path, error.lineno) from error
    except RecursionError as error:
        raise DataError("expected JSON of few levels, got too many", path, line) from error
    except DataError:
        raise
    except ValueError as error:
        raise DataError(f"expected numbers of few digits: {error}", path, line) from error


def shortened(value: object) -> str:
    """Return the representation of a value from a file, with an ellipsis where it is long.

    Examples:
        >>> shortened([0.5, "a"]), len(shortened("a" * 9999))
        ("[0.5, 'a']", 80)
    """
    return _SHORT.repr(value)


@contextmanager
def held(folder: str | Path) -> Iterator[None]:
    """Keep an existing folder for this process within the block, where `flock` does so.

    Windows has none, nor have some file systems: nothing is kept there. The end of the process,
    however it ends, gives the folder back, as those that it forks do not keep it; nothing is
    written into it.

    Raises:
        OSError: Another process keeps it.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    _held.add(descriptor)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OSError(
                f"expected no other run at work in {folder}, got one: wait for its end, or write to"
                " another folder"
            ) from error
        except OSError:
            pass  # this file system has no locks
        yield
    finally:
        if descriptor in _held:  # not where a fork of this process has left the block
            _held.remove(descriptor)
            os.close(descriptor)


def _let_go() -> None:
    while _held:
        os.close(_held.pop())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


def remove_leftovers(folder: str | Path, older_than: float = 3600.0) -> None:
    """Remove temporary folders that killed processes left behind in `atomic_write`.

    Younger ones than so many seconds may belong to a running process.
    """
    for left in Path(folder).glob(f"{_PREFIX}*"):
        with suppress(FileNotFoundError):  # a running writer has just renamed its file
            if time.time() - left.stat().st_mtime > older_than:
                shutil.rmtree(left)


def expect_room(folder: str | Path, need: int, what: str) -> None:
    """Check that a folder's disk has ``need`` bytes free for ``what``; or raise ENOSPC."""
    free = shutil.disk_usage(_nearest(folder)).free
    if free < need:
        room = f"need at least {need / 1e9:.1f} GB, got {free / 1e9:.1f} GB free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {what} {room}", str(folder))


def expect_folder(path: str | Path) -> None:
    """Check in advance that ``path`` is a folder or can be created; or raise NotADirectoryError."""
    there = _nearest(path)
    if not there.is_dir():
        raise NotADirectoryError(f"expected a folder, got the file {there}")


def expect_writable(folder: str | Path) -> None:
    """Check in advance that ``folder`` can be written to, and created if it does not exist.

    A file without a name is made in it, or in its nearest parent that exists: what may be done in
    `/proc`, or on a disk without room, is not what permissions say.

    Raises:
        OSError: It cannot be written to, or a file is in its place (NotADirectoryError).
    """
    expect_folder(folder)
    there = _nearest(folder)
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise OSError(
            f"expected a folder that can be written to, got {there}: {error.strerror}"
        ) from error


def expect_place(path: Path | None) -> None:
    """Check in advance that a file can be written in an existing folder; or raise an OSError."""
    if path is None:
        return
    expect_folder(path.parent)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"expected an existing folder for {path}, got {path.parent}")
    if path.exists() and not path.is_file():
        raise OSError(f"expected a file to write, got {path}, which is none")
    expect_writable(path.parent)


def _nearest(path: str | Path) -> Path:
    """Return ``path`` if it exists, else its nearest existing parent."""
    return next(place for place in (Path(path), *Path(path).absolute().parents) if place.exists())
