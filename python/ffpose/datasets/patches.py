"""Training patches of an image set on disk, with their dense labels, and the cache of any patches.

The patches of a set (`ffpose.imaging.patches`) lie in one folder of memory-mapped arrays, whose
name is a digest of all that they depend on; any number of runs and processes map one copy.

``ffpose render --labels coordinates`` writes ``N_coordinates.png`` beside ``N_rgb.png``: the object
coordinates of each pixel and, as alpha, the silhouette.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose import __version__
from ffpose._internal.files import expect_room, remove_leftovers
from ffpose.datasets.base import PoseDataset
from ffpose.datasets.cache import BUILD_LIMIT_S, cache_folder
from ffpose.datasets.records import Record
from ffpose.errors import DataError
from ffpose.geometry import Camera
from ffpose.imaging.images import decode_all, open_image
from ffpose.imaging.patches import (
    Arrays,
    Bytes,
    Patches,
    PatchSpec,
    extract_patches,
    nearest_pixels,
)

ARRAYS = ("frames", "windows", "coordinates", "labels")


def dataset_patches(
    dataset: PoseDataset, spec: PatchSpec, *, coordinates: bool, cache: bool = False
) -> Arrays:
    """Extract the patches of the images of a set on disk, as ``spec`` says.

    With ``coordinates`` the object's coordinates are read too, ``N_coordinates.png`` beside
    ``N_rgb.png``. With ``cache`` the patches are stored in the cache folder
    (`ffpose.datasets.cache`), which later runs and other processes share, instead of in memory.

    Raises:
        ffpose.DataError: An image cannot be used, or has no coordinates.
    """
    records, preprocessing = dataset.records, dataset.preprocessing

    def extract(index: int) -> Patches:
        record = records[index]
        frame = preprocessing.frame(dataset.load_image(index))
        seen = read_coordinates(record) if coordinates else None
        return extract_patches(frame, record.label, spec, seen)

    def pieces() -> Iterator[Patches]:
        return decode_all(extract, range(len(records)))

    if not cache:
        arrays = spec.empty(len(records))
        for row, piece in enumerate(pieces()):
            piece.store(arrays, row)
        return arrays
    sources: dict[str, Any] = {
        "images": [record.fingerprint() for record in records],
        "labels": [record.label.vector.tolist() for record in records],
        "coordinates": [_written(coordinates_file(r)) for r in records] if coordinates else None,
        "preprocessing": preprocessing.to_dict(),
        "spec": asdict(spec),
    }
    folder = cache_folder() / f"views-{digest(sources)}"
    return cached_patches(folder, len(records), spec, pieces)


def coordinates_file(record: Record) -> Path:
    """Return the file of an image's object coordinates, or raise a DataError if there is none."""
    path = record.image.with_name(record.image.name.replace("_rgb.", "_coordinates."))
    if path == record.image or not path.is_file():
        raise record.error(
            f"dense supervision expected {path.name}, which ffpose render --labels coordinates "
            "writes, got none; --object-loss.coordinates 0 --object-loss.mask 0 does without, and "
            "--object-loss.keypoints 1 --data.keypoints FILE learns the object's keypoints instead"
        )
    return path


def _written(path: Path) -> tuple[int, int]:
    """Return a file's size and time of modification, which change with its content."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns


def read_coordinates(record: Record) -> Callable[[Camera], Bytes]:
    """Return the object's coordinates of an image as any camera of the same view sees them.

    A DataError if there is no such file, or it is another picture.
    """
    path, camera = coordinates_file(record), record.camera
    with open_image(path) as image:
        picture = np.asarray(image)
    expected = (camera.height, camera.width, 4)
    if picture.shape != expected or picture.dtype != np.uint8:
        raise DataError(f"expected 8-bit RGBA of {camera.width}x{camera.height} pixels", path)
    return partial(nearest_pixels, picture, camera)


def cached_patches(
    folder: Path,
    count: int,
    spec: PatchSpec,
    pieces: Callable[[], Iterable[Patches]],
    begun: Arrays = MappingProxyType({}),
) -> dict[str, NDArray[Any]]:
    """Return the patches of ``count`` images in a folder; write them where it does not exist yet.

    The folder is named by all that they depend on. ``pieces`` yields them in order, but for those
    of the first images in ``begun``, which are copied.
    """
    if not folder.exists():
        _store(folder, count, spec, pieces(), begun)
    return open_patches(folder)


def open_patches(folder: Path) -> dict[str, NDArray[Any]]:
    """Return the patches in a folder, for reading, or raise a DataError if it is damaged."""
    try:
        return {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in ARRAYS}
    except (OSError, ValueError, EOFError) as error:
        text = f"expected patches, remove the folder to make them anew: {error}"
        raise DataError(text, folder) from error


def digest(described: dict[str, Any]) -> str:
    """Return a name for what ``described`` determines in this version of ffpose."""
    text = json.dumps({**described, "ffpose": __version__}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _store(
    folder: Path, count: int, spec: PatchSpec, pieces: Iterable[Patches], begun: Arrays
) -> None:
    """Write the patches to a temporary folder and rename it, so that all exist or none."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder.parent, older_than=BUILD_LIMIT_S)
    need = sum(
        math.prod(shape) * np.dtype(kind).itemsize for shape, kind in spec.shapes(count).values()
    )
    expect_room(folder.parent, need, f"patches of {count} images")
    with tempfile.TemporaryDirectory(prefix=".ffpose-", dir=folder.parent) as place:
        unfinished = Path(place) / folder.name
        unfinished.mkdir()
        # Its arrays are closed before the folder is renamed, as Windows renames no mapped files.
        arrays = {
            name: np.lib.format.open_memmap(unfinished / f"{name}.npy", "w+", dtype, shape)
            for name, (shape, dtype) in spec.shapes(count).items()
        }
        _reserve(unfinished)
        for name, first in begun.items():
            arrays[name][: len(first)] = first
        for row, piece in enumerate(pieces, start=len(begun.get("labels", ()))):
            piece.store(arrays, row)
        for array in arrays.values():
            array.flush()
        del arrays, array
        try:
            unfinished.rename(folder)
        except OSError:
            if not folder.exists():  # otherwise another process was faster
                raise


def _reserve(folder: Path) -> None:
    """Give files their room on the disk: a mapped one that finds none later kills the process."""
    if sys.platform == "linux":  # others have no posix_fallocate
        for path in folder.iterdir():
            with path.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
