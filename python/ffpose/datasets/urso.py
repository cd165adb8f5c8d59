"""Reader of URSO: spacecraft over Earth, rendered by Unreal Engine 4 (Proença and Gao, ICRA 2020).

`ffpose._internal.urso` describes the format. Images lie in the set's folder or in its ``images``
folder, and the columns of the tables stand in any order.

The camera is URSO's, unless a ``camera.json`` beside the labels holds another (``width``,
``height``, ``fx``, ``fy``, ``cx``, ``cy``), as the sets of ``ffpose render`` have it. Without that
file, smaller images of the same shape are taken as URSO's, resized.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ffpose._internal.entries import Entry
from ffpose._internal.urso import COLUMNS, LISTS, TABLE, TABLES, from_label, index_of
from ffpose.datasets.parsing import (
    Names,
    existing_splits,
    read_lines,
    read_table,
    split_file,
)
from ffpose.datasets.records import Record, with_camera
from ffpose.errors import DataError
from ffpose.geometry import URSO_CAMERA, Pose

_SAME_LABEL = 1e-5
"""Tolerance between labels in two files, which may print different numbers of digits."""


def splits(root: Path) -> list[str]:
    """Return the splits of the set, in the order train, val, test."""
    return existing_splits(root, "URSO", LISTS)


def read(root: Path, split: str) -> list[Record]:
    """Read the labeled images of a split, whose names and labels must align."""
    list_file, table_file = (split_file(root, "URSO", files, split) for files in (LISTS, TABLES))
    names, rows = _read_names(list_file), read_table(table_file, COLUMNS, others=True)
    if len(rows) != len(names):
        raise DataError(
            f"expected {len(names)} labels, one for each line of {list_file.name}, got {len(rows)}",
            table_file,
        )
    labels = [from_label(*row.parsed(COLUMNS)) for row in rows]
    poses = [row.made(Pose, *label) for row, label in zip(rows, labels, strict=True)]
    if (root / TABLE).exists():
        _check_alignment(names, rows, root / TABLE)
    records = []
    for line, (name, pose, (_, q)) in enumerate(zip(names, poses, labels, strict=True), start=1):
        image = _find_image(root, name, list_file, line)
        records.append(Record(image, name, URSO_CAMERA, pose, list_file, line, q))
    return with_camera(records, root, URSO_CAMERA)


def _read_names(path: Path) -> list[str]:
    names, known = [], Names()
    for line, text in enumerate(read_lines(path), start=1):
        name = text.strip()
        if not name or Path(name).name != name:
            raise DataError(f"expected the name of an image, got {text!r}", path, line)
        names.append(known.once(Entry({}, path, line), name))
    if not names:
        raise DataError("expected at least one image, got none", path)
    return names


def _check_alignment(names: list[str], rows: list[Entry], table: Path) -> None:
    """Check the labels of a split against ``gt.csv``, whose row N labels ``N_rgb.png``."""
    whole = read_table(table, COLUMNS, others=True)
    for name, row in zip(names, rows, strict=True):
        number = index_of(name)
        if number is None:
            continue
        if number >= len(whole):
            raise DataError(f"expected a row for {name}, got {len(whole)} rows", table)
        got, expected = row.parsed(COLUMNS), whole[number].parsed(COLUMNS)
        # A quaternion and its negative are one attitude.
        signed = [np.multiply(expected, [1, 1, 1, *(sign,) * 4]) for sign in (1, -1)]
        if not any(np.allclose(got, each, _SAME_LABEL, _SAME_LABEL) for each in signed):
            raise row.error(
                f"expected the label of {name}, {expected} as in {table.name} line "
                f"{whole[number].line}, got {got}: names and labels do not align"
            )


def _find_image(root: Path, name: str, source: Path, line: int) -> Path:
    places = (root / name, root / "images" / name)
    for place in places:
        if place.is_file():
            return place
    raise DataError(f"expected {places[0]} or {places[1]}, got no such file", source, line)
