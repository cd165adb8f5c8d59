"""Errors that are ours: bad data named by file and line, and an extra that is not installed.

Everything else is Python's own: `ValueError` for a shape or value, `TypeError` for a dtype,
`FileNotFoundError` for a path.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType


class DataError(ValueError):
    """A file holds what cannot be used; the text begins with ``file:line:``.

    Attributes:
        file: The file that is to be mended; None only where torch raises the error of a
            DataLoader's worker again, with the worker's whole traceback as its text
            (`without_traceback` finds the error's own).
        line: Its line, counted from one; None where the file as a whole is meant.
    """

    def __init__(
        self, message: str, file: str | Path | None = None, line: int | None = None
    ) -> None:
        super().__init__(message, file, line)
        self.message = message
        self.file = None if file is None else Path(file)
        self.line = line

    def __str__(self) -> str:
        if self.file is None:
            return self.message
        place = str(self.file) if self.line is None else f"{self.file}:{self.line}"
        return f"{place}: {self.message}"


class MissingExtraError(ImportError):
    """A feature was used whose optional dependencies are not installed."""

    @classmethod
    def of(cls, package: str, extra: str) -> MissingExtraError:
        """Return the error that says how ``package`` is installed, which ``extra`` brings."""
        return cls(
            f"this part of ffpose needs {package}, of the extra [{extra}]; install it with: pip "
            f"install 'WHEEL[{extra}]', WHEEL being the file that `make wheel` leaves in dist/"
        )


def without_traceback(text: str) -> str:
    r"""Return the text of an error, which torch buries in a traceback if a worker raised it.

    Example:
        >>> without_traceback(
        ...     "Caught ValueError in DataLoader worker process 0.\n"
        ...     "Original Traceback (most recent call last):\n"
        ...     '  File "worker.py", line 1, in fetch\n'
        ...     "ValueError: a.png: truncated"
        ... )
        'a.png: truncated'
    """
    _, mark, traceback = text.partition("\nOriginal Traceback (most recent call last):\n")
    if not mark:
        return text
    lines = traceback.splitlines()
    frames = [place for place, line in enumerate(lines) if line.startswith("  ")]
    return "\n".join(lines[frames[-1] + 1 :]).partition(": ")[2] if frames else text


def require(module: str, extra: str) -> ModuleType:
    """Import an optional dependency.

    Args:
        module: What to import, for example ``"matplotlib.pyplot"``.
        extra: The extra of this package that brings it, for example ``"pose"``.

    Returns:
        The module.

    Raises:
        MissingExtraError: The module, or a package that holds it, is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtraError.of(module.partition(".")[0], extra) from error
