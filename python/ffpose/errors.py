"""Exceptions of ffpose (invalid data by file and line, a missing extra), and checks of choices.

All other errors are Python's own: `ValueError` for a shape or value, `TypeError` for a dtype,
`FileNotFoundError` for a path.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args, get_origin, get_type_hints

type_hints: Any = cache(get_type_hints)  # mypy takes a class for unhashable
"""Function that returns the types of a class's fields by name, computed once for each."""


class DataError(ValueError):
    """The contents of a file are invalid; the message begins with ``file:line:``.

    Attributes:
        file: The invalid file; None until who opened it adds it, and where torch reraises the error
            of a DataLoader's worker with the worker's traceback as the message
            (`without_traceback` extracts the original).
        line: The line in the file, counted from one; None for the file as a whole.
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
    """The optional dependencies of a feature are not installed."""

    @classmethod
    def of(cls, package: str, extra: str) -> MissingExtraError:
        """Return an error that tells how to install ``package``, a dependency of ``extra``."""
        return cls(
            f"this part of ffpose needs {package}, of the extra [{extra}]; install it with: pip "
            f"install 'ffpose[{extra}]'"
        )


def hint(unknown: str, known: Iterable[str]) -> str:
    """Return the most similar of the known names as a question; nothing where none is similar.

    Examples:
        >>> hint("depht", ["depth", "dim"])
        ' (did you mean depth?)'
        >>> hint("colour", ["depth", "dim"])
        ''
    """
    close = difflib.get_close_matches(unknown, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def without_traceback(text: str) -> str:
    r"""Extract the original message from an error that torch reraised from a worker.

    Examples:
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


def explain(error: BaseException) -> str:
    r"""Return an error as one line, with its type in front if it is not meant for users.

    Examples:
        >>> explain(ValueError("count: expected at least 1,\n got 0"))
        'count: expected at least 1, got 0'
        >>> explain(KeyError("fx"))
        "KeyError: 'fx'"
    """
    text = " ".join(without_traceback(str(error)).split())
    if isinstance(error, ValueError | OSError | ImportError | RuntimeError) and text:
        return text
    return f"{type(error).__name__}: {text}"


def require(module: str, extra: str) -> ModuleType:
    """Import a module, such as ``"matplotlib.pyplot"``, of a package that an extra installs.

    Raises:
        MissingExtraError: The module or its package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtraError.of(module.partition(".")[0], extra) from error


def expect(holds: bool, name: str, expected: str, got: object) -> None:
    """Check a condition on a value.

    Raises:
        ValueError: It does not hold; the message says what ``name`` is expected to be, and is.
    """
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {got!r}")


def expect_shape(name: str, values: Any, *sizes: int) -> None:
    """Check that an array or tensor has the shape ``(B, *sizes)``; raises as `expect`."""
    shape = tuple(values.shape)
    if len(shape) != 1 + len(sizes) or shape[1:] != sizes:
        expected = ", ".join(map(str, ("B", *sizes)))
        raise ValueError(f"{name}: expected shape ({expected}), got {shape}")


def expect_least(values: object, prefix: str = "", **least: float) -> None:
    """Check that each field named is at least so large; raises as `expect`."""
    for name, bound in least.items():
        value = getattr(values, name)
        expect(value >= bound, prefix + name, f"{bound} or more", value)


def check_choices(values: object, prefix: str = "") -> None:
    """Check the fields of a dataclass whose type is a `Literal`.

    Raises:
        ValueError: A value is none of its field's; the message begins with ``prefix`` and the name.
    """
    for name, kind in type_hints(type(values)).items():
        value, choices = getattr(values, name, None), get_args(kind)
        if get_origin(kind) is Literal and value not in choices:
            raise ValueError(f"{prefix}{name}: expected one of {', '.join(choices)}, got {value!r}")
