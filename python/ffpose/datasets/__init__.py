"""Datasets on disk, one module for each kind, all in the conventions of `ffpose.geometry`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ffpose.datasets import cambridge, csv_set, sevenscenes, speed, speedplus, urso
from ffpose.datasets.base import Part, PoseDataset, Reader, Sample
from ffpose.datasets.conditions import Conditions, read_conditions
from ffpose.datasets.records import AS_ON_DISK, Decoding, Record
from ffpose.errors import expect
from ffpose.geometry import Target
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.transforms import Augmentation

__all__ = [
    "AS_ON_DISK",
    "KINDS",
    "Conditions",
    "Decoding",
    "Part",
    "PoseDataset",
    "Record",
    "Sample",
    "Target",
    "list_splits",
    "open_dataset",
    "read_conditions",
    "read_records",
]

KINDS: dict[str, Reader] = {
    "urso": urso,
    "speed": speed,
    "speedplus": speedplus,
    "cambridge": cambridge,
    "sevenscenes": sevenscenes,
    "csv": csv_set,
}
"""Readers of the supported kinds of datasets, by name."""


def _reader(kind: str) -> Reader:
    expect(kind in KINDS, "dataset kind", f"one of {sorted(KINDS)}", kind)
    return KINDS[kind]


def list_splits(kind: str, root: str | Path) -> list[str]:
    """Return the splits of a dataset of one of `KINDS`, those for training first.

    Raises:
        ValueError: ``kind`` is not in `KINDS`.
        FileNotFoundError: The folder does not exist.
    """
    return _reader(kind).splits(Path(root))


def read_records(
    kind: str, root: str | Path, split: Part, decoding: Decoding = AS_ON_DISK
) -> list[Record]:
    """Read what a split, or a whole set, consists of; splits without labels too.

    Args:
        kind: One of `KINDS`.
        root: The dataset's folder.
        split: One of `list_splits`, or ``"all"`` for all of them.
        decoding: Conversion from image files to images.

    Raises:
        ValueError: ``kind`` or ``split`` is unknown.
        FileNotFoundError: The folder, or a file that lists the split, does not exist.
        DataError: A file is invalid, or of all splits two have an image in common; the error names
            file and line.
    """
    reader, folder = _reader(kind), Path(root)
    splits = reader.splits(folder) if split == "all" else [split]
    parts = {each: reader.read(folder, each) for each in splits}
    if split == "all":
        _expect_apart(parts)
    return [record.decoded_by(decoding) for part in parts.values() for record in part]


def _expect_apart(parts: Mapping[str, Sequence[Record]]) -> None:
    """Refuse splits that share images, which would count twice, or be learned and held out."""
    found: dict[Path, str] = {}
    for split, records in parts.items():
        for record in records:
            other = found.setdefault(record.image, split)
            if other != split:
                raise record.error(
                    f"expected splits without common images, of which all are asked for, got"
                    f" {record.name} in {other} and {split}"
                )


def open_dataset(
    kind: str,
    root: str | Path,
    split: Part,
    preprocessing: Preprocessing,
    augmentation: Augmentation | None = None,
    cache: bool = False,
    decoding: Decoding = AS_ON_DISK,
) -> PoseDataset:
    """Open a labeled split, or a whole set, as a torch dataset.

    Args:
        kind: One of `KINDS`.
        root: The dataset's folder.
        split: One of `list_splits`, or ``"all"`` for all of them.
        preprocessing: Conversion from image to network input.
        augmentation: Random augmentation of each sample; None for none.
        cache: Decode and resize every image now, unless cached by an earlier run (`PoseDataset`).
        decoding: Conversion from image files to images.

    Returns:
        The dataset. Images are read on access, or now with ``cache``.

    Raises:
        ValueError: ``kind`` or ``split`` is unknown.
        FileNotFoundError: The folder, or a file that lists the split, does not exist.
        DataError: A file is invalid, or the split has no labels; the error names file and line.
    """
    records = read_records(kind, root, split, decoding)
    return PoseDataset(records, preprocessing, augmentation, cache)
