"""Rows of tables and objects in JSON, whose values are checked with errors by file and line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from ffpose._internal.files import read_json, shortened
from ffpose.errors import DataError

Made = TypeVar("Made")


class Entry(NamedTuple):
    """A row of a table or a member of a list, and its line in the file.

    Attributes:
        values: The values by name: strings in a table, anything in JSON.
        file: The file.
        line: The line that it begins on, counted from one; None for the file as a whole.
    """

    values: Mapping[str, Any]
    file: Path
    line: int | None

    def error(self, message: str) -> DataError:
        """Return an error that names the file, and the line if it is known."""
        return DataError(message, self.file, self.line)

    def text(self, key: str) -> str:
        """Return a value that must be a text of at least one character."""
        value = self._value(key)
        if not isinstance(value, str) or not value.strip():
            raise self.error(f"{key}: expected a name, got {shortened(value)}")
        return value.strip()

    def number(self, key: str) -> float:
        """Return a finite number."""
        return self._finite(key, self._value(key))

    def whole(self, key: str) -> int:
        """Return a whole number below 2⁵³, which may be written with a fraction of zero."""
        value = self._value(key)
        if type(value) not in (int, float) or value % 1 != 0:
            raise self.error(f"{key}: expected a whole number, got {shortened(value)}")
        if value >= 2**53:  # above, not every whole number is a float
            raise self.error(f"{key}: expected less than 2⁵³, got {shortened(value)}")
        return int(value)

    def numbers(self, key: str, count: int) -> tuple[float, ...]:
        """Return a list of ``count`` finite numbers."""
        value = self._value(key)
        if not isinstance(value, list) or len(value) != count:
            raise self.error(f"{key}: expected {count} numbers, got {shortened(value)}")
        return tuple(self._finite(key, each) for each in value)

    def parsed(self, keys: Sequence[str]) -> tuple[float, ...]:
        """Return values that a table holds as text, which must be finite numbers."""
        return tuple(map(self._parsed, keys))

    def _parsed(self, key: str) -> float:
        text = self._value(key)
        try:
            return self._finite(key, float(text))
        except ValueError as error:
            raise self.error(f"{key}: expected a finite number, got {shortened(text)}") from error

    def _value(self, key: str) -> Any:
        if key not in self.values:
            raise self.error(f"expected the key {key}, got {', '.join(self.values) or 'none'}")
        return self.values[key]

    def _finite(self, key: str, value: object) -> float:
        if type(value) in (int, float):
            with suppress(OverflowError):  # an integer of hundreds of digits
                number = float(value)  # type: ignore[arg-type]  # a number by then
                if math.isfinite(number):
                    return number
        raise self.error(f"{key}: expected a finite number, got {shortened(value)}")

    def made(self, kind: Callable[..., Made], *values: object) -> Made:
        """Return what values make; what is wrong with them becomes an error of this entry."""
        try:
            return kind(*values)
        except ValueError as error:
            raise self.error(str(error)) from error


def read_object(path: Path, expected: str = "expected an object of keys and values") -> Entry:
    """Read a JSON file that holds one object, or raise a DataError that says what is expected."""
    values = read_json(path)
    if not isinstance(values, dict):
        raise DataError(f"{expected}; got {shortened(values)}", path)
    return Entry(values, path, None)
