"""Parts of the readers: tables, lists in JSON and names, with errors by file and line."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath

from ffpose._internal.entries import Entry
from ffpose._internal.files import distinct_keys, expect_folder, json_errors, read_text, shortened
from ffpose.errors import DataError, expect

BETWEEN = re.compile(r"[\s,]*")
"""What stands between the members of a list in JSON."""


class Names:
    """Names of images or points, each there once."""

    def __init__(self) -> None:
        self._first_line: dict[str, int | None] = {}

    def once(self, entry: Entry, name: str) -> str:
        """Return a name, or raise a DataError if it was there before."""
        if name in self._first_line:
            raise entry.error(f"{name} is on line {self._first_line[name]} already")
        self._first_line[name] = entry.line
        return name

    def add(self, entry: Entry, name: str) -> str:
        """Return the path of an image with slashes, which must not leave the folder, `once`."""
        path = PurePosixPath(name.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or not path.parts:
            raise entry.error(f"expected the path of an image within its folder, got {name!r}")
        return self.once(entry, str(path))


def find_image(folder: Path, name: str, entry: Entry) -> Path:
    """Return the path of an image, or raise a DataError if there is no such file."""
    path = folder / name
    if not path.is_file():
        raise entry.error(f"expected the image {path}, got no such file")
    return path


def expect_set(root: Path, kind: str) -> None:
    """Check that ``root`` is a folder; errors as in `existing_splits`."""
    if not root.exists():
        raise FileNotFoundError(f"{kind} set: expected {root}, got no such file or folder")
    expect_folder(root)


def existing_splits(root: Path, kind: str, files: Mapping[str, str]) -> list[str]:
    """Return the splits whose files exist, of those that list each, relative to the folder.

    Raises:
        FileNotFoundError: The folder does not exist, or contains no such file.
        NotADirectoryError: ``root`` is a file.
    """
    expect_set(root, kind)
    found = [split for split, file in files.items() if (root / file).is_file()]
    if not found:
        names = ", ".join(files.values())
        raise FileNotFoundError(f"{kind} set: expected one of {names} in {root}, got none")
    return found


def expect_split(split: str, known: Iterable[str]) -> None:
    """Check the name of a split, or raise a ValueError."""
    expect(split in known, "split", f"one of {(*known, 'all')}", split)


def split_file(root: Path, kind: str, files: Mapping[str, str], split: str) -> Path:
    """Return the file that lists a split; errors as in `Reader.read`."""
    expect_split(split, files)
    expect_set(root, kind)
    path = root / files[split]
    if not path.is_file():
        raise FileNotFoundError(f"{kind} set: expected {path}, got no such file")
    return path


def find_tables(root: Path) -> list[Path]:
    """Return the CSV files of a folder, sorted; hidden ones, as macOS leaves, are none."""
    there = (path for path in root.glob("*.csv") if path.is_file())
    return sorted(path for path in there if not path.name.startswith("."))


def read_table(
    path: Path, columns: Sequence[str], *perhaps: Sequence[str], others: bool = False
) -> list[Entry]:
    """Read a CSV file with a header, and rows of as many fields; lines may end as on Windows.

    Args:
        path: The file.
        columns: Columns that must be there, in any order.
        *perhaps: Columns that may be there besides, all or none of each group.
        others: Whether any other columns may be there.

    Raises:
        FileNotFoundError: The file does not exist.
        DataError: It is empty, a column is missing, unknown or there twice, a row is short or long,
            or there are none; or as in `read_rows`.
    """
    table = read_rows(path)
    _, names = next(table, (1, []))
    header = [name.strip() for name in names]
    if len(set(header)) != len(header) or not header:
        raise DataError(f"expected a header of distinct columns, got {header}", path, 1)
    known = set(columns).union(*(group for group in perhaps if set(group) <= set(header)))
    if not set(columns) <= set(header) or not (others or set(header) <= known):
        expected = ", and perhaps ".join(map(", ".join, (columns, *perhaps)))
        raise DataError(f"expected the columns {expected}, got {', '.join(header)}", path, 1)
    rows = []
    for line, fields in table:
        if len(fields) != len(header):
            expected = f"expected {len(header)} fields, got {len(fields)}"
            raise DataError(expected, path, line)
        rows.append(Entry(dict(zip(header, fields, strict=True)), path, line))
    if not rows:
        raise DataError("expected at least one row, got none", path)
    return rows


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file; blank ones at its end, which editors leave, do not count."""
    return read_text(path).rstrip().splitlines()


def read_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a CSV file, each one line of `read_lines`, with its number.

    A DataError if a line is not CSV: a quote stays open, or closes within a field, or a field is
    longer than `csv.field_size_limit`.
    """
    for number, line in enumerate(read_lines(path), start=1):
        try:  # Line by line: an open quote must not take the next lines for its field.
            fields = next(csv.reader([line], strict=True), [])
        except csv.Error as error:
            raise DataError(f"expected a row of CSV in one line: {error}", path, number) from error
        yield number, fields


def read_list(path: Path) -> list[Entry]:
    """Read a JSON file that holds a list of objects, at least one, or raise a DataError."""
    text = read_text(path)
    if not text.lstrip().startswith("["):
        raise DataError("expected a list of objects in JSON", path, 1)
    entries: list[Entry] = []
    line, counted, place = 1, 0, _next_member(text, text.index("[") + 1)
    while text[place : place + 1] not in ("]", ""):
        line, counted = line + text.count("\n", counted, place), place
        with json_errors(path, line):
            values, end = distinct_keys(path, line).raw_decode(text, place)
        if not isinstance(values, dict):
            raise DataError(f"expected an object, got {shortened(values)}", path, line)
        entries.append(Entry(values, path, line))
        place = _next_member(text, end)
    with json_errors(path):
        json.loads(text)  # what stands between the members, and after them
    if not entries:
        raise DataError("expected at least one image, got none", path)
    return entries


def _next_member(text: str, place: int) -> int:
    """Return where the next member of a list begins, or its end."""
    between = BETWEEN.match(text, place)
    assert between is not None  # it may be empty
    return between.end()
