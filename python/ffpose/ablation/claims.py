"""Claims on runs by processes, on one machine or several, that share an ablation folder.

A claim is a file that names the host and the process. It appears with its contents by a hard link,
which one process alone can make, on network file systems too. What a dead process left is taken
over by processes of its host, one at a time; other hosts cannot know that it is dead.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ffpose.errors import DataError

POLL_S = 0.5


@contextmanager
def claimed(path: Path, *, steal: bool = False) -> Iterator[bool]:
    """Claim the work that a file stands for, until the block ends.

    Args:
        path: The file; its folder must exist.
        steal: Take over the claim of another host.

    Yields:
        Whether the work is this process's; if not, another process has claimed it.

    Raises:
        ffpose.DataError: The file holds something else.
    """
    mine = {"host": socket.gethostname(), "pid": os.getpid()}
    held = _create(path, mine) or (_clear(path, mine, steal=steal) and _create(path, mine))
    try:
        yield held
    finally:
        if held:
            _release(path, mine)


@contextmanager
def claimed_in_turn(path: Path, *, steal: bool = False) -> Iterator[None]:
    """Wait until the work that a file stands for is free, and claim it as `claimed` does."""
    while True:
        with claimed(path, steal=steal) as mine:
            if mine:
                yield
                return
        time.sleep(POLL_S)


@contextmanager
def guarded(folder: Path) -> Iterator[None]:
    """Keep the other processes of this host out of what a moment's work changes in a folder."""
    with (folder / ".guard").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _create(path: Path, mine: dict[str, Any]) -> bool:
    """Return whether the claim was made: there was none."""
    with tempfile.TemporaryDirectory(prefix=".ffpose-", dir=path.parent) as folder:
        written = Path(folder) / path.name
        written.write_text(json.dumps(mine) + "\n")
        try:
            path.hardlink_to(written)
        except FileExistsError:
            return False
    return True


def _clear(path: Path, mine: dict[str, Any], *, steal: bool) -> bool:
    """Return whether the claim is gone: released, a dead process's, or stolen."""
    with guarded(path.parent):
        owner = _read(path)
        if owner is None:
            return True
        elsewhere = owner["host"] != mine["host"]
        # A claim of this very process is of an older one with its number.
        if not (steal if elsewhere else owner == mine or not _lives(owner["pid"])):
            return False
        path.unlink()
    return True


def _release(path: Path, mine: dict[str, Any]) -> None:
    """Remove the claim, unless another process has stolen it."""
    with guarded(path.parent), suppress(FileNotFoundError):
        if _read(path) == mine:
            path.unlink()


def _read(path: Path) -> dict[str, Any] | None:
    """Return host and process of a claim; None where there is none."""
    try:
        owner = json.loads(path.read_text())
        return {"host": str(owner["host"]), "pid": int(owner["pid"])}
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"expected the claim of a process, remove it: {error}", path) from error


def _lives(pid: int) -> bool:
    """Return whether a process of this host runs."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is another user's
        return True
    return True
