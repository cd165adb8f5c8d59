"""Datasets on disk, one module for each kind, all in the conventions of `ffpose.geometry`."""

from __future__ import annotations

from pathlib import Path

from ffpose.datasets import urso
from ffpose.datasets.base import SPLITS, Part, PoseDataset, Reader, Sample, Split
from ffpose.datasets.conditions import Conditions, read_conditions
from ffpose.datasets.records import Record
from ffpose.preprocessing import Preprocessing
from ffpose.transforms import Augmentation

__all__ = [
    "KINDS",
    "SPLITS",
    "Conditions",
    "Part",
    "PoseDataset",
    "Record",
    "Sample",
    "Split",
    "list_splits",
    "open_dataset",
    "read_conditions",
]

KINDS: dict[str, Reader] = {"urso": urso}
"""Readers of the supported kinds of datasets, by name."""


def _reader(kind: str) -> Reader:
    if kind not in KINDS:
        raise ValueError(f"dataset kind: expected one of {sorted(KINDS)}, got {kind!r}")
    return KINDS[kind]


def list_splits(kind: str, root: str | Path) -> list[Split]:
    """Return the splits of a dataset, in the order train, val, test.

    Args:
        kind: One of `KINDS`.
        root: The dataset's folder.

    Raises:
        ValueError: ``kind`` is not in `KINDS`.
        FileNotFoundError: The folder does not exist.
    """
    return _reader(kind).splits(Path(root))


def open_dataset(
    kind: str,
    root: str | Path,
    split: Part,
    preprocessing: Preprocessing,
    augmentation: Augmentation | None = None,
    cache: bool = False,
) -> PoseDataset:
    """Open a split, or a whole set, as a torch dataset.

    Args:
        kind: One of `KINDS`.
        root: The dataset's folder.
        split: ``"train"``, ``"val"``, ``"test"``, or ``"all"`` for all splits that exist.
        preprocessing: Conversion from image to network input.
        augmentation: Random augmentation of each sample; None for none.
        cache: Decode and resize every image now, unless cached by an earlier run (`PoseDataset`).

    Returns:
        The dataset. Images are read on access, or now with ``cache``.

    Raises:
        ValueError: ``kind`` or ``split`` is unknown.
        FileNotFoundError: The folder, or a file that lists the split, does not exist.
        DataError: A file is invalid; the error names file and line.
    """
    if split not in (*SPLITS, "all"):
        raise ValueError(f"split: expected one of {(*SPLITS, 'all')}, got {split!r}")
    reader, folder = _reader(kind), Path(root)
    splits = reader.splits(folder) if split == "all" else [split]
    parts = [reader.read(folder, each) for each in splits]
    records = [record for part, _ in parts for record in part]
    return PoseDataset(records, parts[0][1], preprocessing, augmentation, cache)
