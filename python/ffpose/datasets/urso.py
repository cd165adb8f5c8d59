"""Reader of URSO: spacecraft over Earth, rendered by Unreal Engine 4 (Proença and Gao, ICRA 2020).

`ffpose._internal.urso` describes the format. Images lie in the set's folder or in its ``images``
folder, and the columns of the tables stand in any order.

The camera is URSO's, unless a ``camera.json`` beside the labels holds another (``width``,
``height``, ``fx``, ``fy``, ``cx``, ``cy``), as the sets of ``ffpose render`` have it. Without that
file, smaller images of the same shape are taken as URSO's, resized.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffpose._internal.files import expect_folder, read_text
from ffpose._internal.urso import (
    COLUMNS,
    SPLITS,
    TABLE,
    from_label,
    images_file,
    index_of,
    poses_file,
)
from ffpose.datasets.parsing import read_rows
from ffpose.datasets.records import Record, read_camera
from ffpose.datasets.targets import Target
from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA, Pose

TARGET: Target = "object"

_SAME_LABEL = 1e-5
"""Tolerance between labels in two files, which may print different numbers of digits."""


class _Row(NamedTuple):
    """A row of labels: its line in the file, and its seven numbers."""

    line: int
    values: tuple[float, ...]


def splits(root: Path) -> list[str]:
    """Return the splits of the set, in the order train, val, test.

    Raises:
        FileNotFoundError: The folder does not exist, or lists no split.
        NotADirectoryError: ``root`` is a file.
    """
    _expect_exists(root)
    expect_folder(root)
    found = [split for split in SPLITS if (root / images_file(split)).exists()]
    if not found:
        names = ", ".join(map(images_file, SPLITS))
        raise FileNotFoundError(f"URSO set: expected one of {names} in {root}, got none")
    return found


def read(root: Path, split: str) -> list[Record]:
    """Read the labeled images of a split.

    Raises:
        ValueError: ``split`` is not in `SPLITS`.
        FileNotFoundError: The folder, or a file that lists the split, does not exist.
        NotADirectoryError: The folder is a file.
        DataError: A name or label is invalid, an image is missing or listed twice, labels and names
            do not align, or the camera is unknown. The error names file and line.
    """
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {(*SPLITS, 'all')}, got {split!r}")
    list_file, table_file = root / images_file(split), root / poses_file(split)
    _expect_exists(root)
    expect_folder(root)
    for path in (list_file, table_file):
        _expect_exists(path)
    names, rows = _read_names(list_file), _read_rows(table_file)
    if len(rows) != len(names):
        raise DataError(
            f"expected {len(names)} labels, one for each line of {list_file.name}, got {len(rows)}",
            table_file,
        )
    poses = [_pose(row, table_file) for row in rows]
    _check_alignment(names, rows, table_file, root / TABLE)
    records = [
        Record(
            _find_image(root, name, list_file, line),
            name,
            URSO_CAMERA,
            pose,
            list_file,
            line,
            from_label(*row.values)[1],
        )
        for line, (name, row, pose) in enumerate(zip(names, rows, poses, strict=True), start=1)
    ]
    camera = read_camera(root, records[0], URSO_CAMERA)
    return [replace(record, camera=camera) for record in records]


def _expect_exists(path: Path) -> None:
    if not path.exists():
        raise FileNotFoundError(f"URSO set: expected {path}, got no such file or folder")


def _read_names(path: Path) -> list[str]:
    first_line: dict[str, int] = {}
    for line, text in enumerate(read_text(path).splitlines(), start=1):
        name = text.strip()
        if not name or Path(name).name != name:
            raise DataError(f"expected the name of an image, got {text!r}", path, line)
        if name in first_line:
            raise DataError(f"{name} is on line {first_line[name]} already", path, line)
        first_line[name] = line
    if not first_line:
        raise DataError("expected at least one image, got none", path)
    return list(first_line)


def _read_rows(path: Path) -> list[_Row]:
    table = read_rows(path)
    _, names = next(table, (1, []))
    header = [name.strip() for name in names]
    if any(header.count(name) != 1 for name in COLUMNS):
        raise DataError(f"expected the columns {', '.join(COLUMNS)} once, got {header}", path, 1)
    places = [header.index(name) for name in COLUMNS]
    rows = []
    for line, fields in table:
        if len(fields) != len(header):
            raise DataError(f"expected {len(header)} fields, got {len(fields)}", path, line)
        try:
            values = tuple(float(fields[place]) for place in places)
        except ValueError as error:
            raise DataError(f"expected numbers: {error}", path, line) from error
        rows.append(_Row(line, values))
    return rows


def _pose(row: _Row, path: Path) -> Pose:
    try:
        return Pose.from_urso(**dict(zip(COLUMNS, row.values, strict=True)))
    except ValueError as error:
        raise DataError(str(error), path, row.line) from error


def _check_alignment(names: list[str], rows: list[_Row], path: Path, table: Path) -> None:
    """Check the labels of a split against ``gt.csv``, whose row N labels ``N_rgb.png``."""
    if not table.exists():
        return
    whole = _read_rows(table)
    for name, row in zip(names, rows, strict=True):
        number = index_of(name)
        if number is None:
            continue
        if number >= len(whole):
            raise DataError(f"expected a row for {name}, got {len(whole)} rows", table)
        expected = whole[number]
        # A quaternion and its negative are one attitude.
        signed = [np.multiply(expected.values, [1, 1, 1, *(sign,) * 4]) for sign in (1, -1)]
        if not any(np.allclose(row.values, each, _SAME_LABEL, _SAME_LABEL) for each in signed):
            raise DataError(
                f"expected the label of {name}, {expected.values} as in {table.name} line "
                f"{expected.line}, got {row.values}: names and labels do not align",
                path,
                row.line,
            )


def _find_image(root: Path, name: str, source: Path, line: int) -> Path:
    places = (root / name, root / "images" / name)
    for place in places:
        if place.is_file():
            return place
    raise DataError(f"expected {places[0]} or {places[1]}, got no such file", source, line)
