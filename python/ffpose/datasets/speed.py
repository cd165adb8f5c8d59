"""Reader of SPEED: the satellite Tango, rendered and in the laboratory (Kisantal et al., 2020).

A set is a folder with ``train.json``, ``test.json``, ``real.json`` and ``real_test.json``, lists of
objects, and the images in ``images/{split}``. Labels are ``q_vbs2tango``, scalar first, and
``r_Vo2To_vbs_true``, meters: ``p_camera = R(q) p + r``, as `ffpose.geometry` has it. The splits
``test`` and ``real_test`` have no labels. An image is named by its path in ``images``.
"""

from __future__ import annotations

from pathlib import Path

from ffpose._internal.entries import Entry
from ffpose.datasets.parsing import Names, existing_splits, find_image, read_list, split_file
from ffpose.datasets.records import Record
from ffpose.geometry import Camera, Pose

CAMERA = Camera(width=1920, height=1200, fx=3003.413, fy=3003.413, cx=960.0, cy=600.0)
"""The camera of all images, the real ones too."""

FILES = {split: f"{split}.json" for split in ("train", "test", "real", "real_test")}
ORIENTATION_KEYS = ("q_vbs2tango", "q_vbs2tango_true")
"""Key of the quaternion: in SPEED, in SPEED+."""

POSITION_KEY = "r_Vo2To_vbs_true"


def splits(root: Path) -> list[str]:
    """Return the splits of the set, in the order of `FILES`."""
    return existing_splits(root, "SPEED", FILES)


def read(root: Path, split: str) -> list[Record]:
    """Read the images of a split, with labels where it has them."""
    path = split_file(root, "SPEED", FILES, split)
    return read_images(path, root / "images", split, CAMERA)


def read_images(path: Path, folder: Path, prefix: str, camera: Camera) -> list[Record]:
    """Read a list of images in a folder, labeled all or none, whose names begin with ``prefix``."""
    entries, names = read_list(path), Names()
    labeled = _has_label(entries[0])
    records = []
    for entry in entries:
        if _has_label(entry) != labeled:
            words = ("a label", "none") if labeled else ("no label", "one")
            raise entry.error(f"expected {words[0]} as the first image has it, got {words[1]}")
        name = names.add(entry, f"{prefix}/{entry.text('filename')}")
        image = find_image(folder, name, entry)
        records.append(_record(entry, image, name, camera, labeled=labeled))
    return records


def _has_label(entry: Entry) -> bool:
    return any(key in entry.values for key in (*ORIENTATION_KEYS, POSITION_KEY))


def _record(entry: Entry, image: Path, name: str, camera: Camera, *, labeled: bool) -> Record:
    if not labeled:
        return Record(image, name, camera, None, entry.file, entry.line)
    key = ORIENTATION_KEYS[ORIENTATION_KEYS[1] in entry.values]
    w, x, y, z = entry.numbers(key, 4)
    pose = entry.made(Pose, entry.numbers(POSITION_KEY, 3), (w, x, y, z))
    return Record(image, name, camera, pose, entry.file, entry.line, (w, x, y, z))
