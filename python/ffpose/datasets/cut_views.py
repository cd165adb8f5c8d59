"""Views of an image set on disk, for a network with a second look, and their dense labels.

``ffpose render --labels coordinates`` writes ``N_coordinates.png`` beside ``N_rgb.png``: the object
coordinates of each pixel and, as alpha, the silhouette.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ffpose.datasets.base import PoseDataset
from ffpose.datasets.cache import cache_folder
from ffpose.datasets.records import Record
from ffpose.datasets.view_cache import cached_views, digest
from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose
from ffpose.imaging.images import decode_all, open_image
from ffpose.imaging.views import Arrays, Bytes, Pieces, ViewSpec, cut_pieces, nearest_pixels


def cut_views(
    dataset: PoseDataset, spec: ViewSpec, *, coordinates: bool, cache: bool = False
) -> Arrays:
    """Cut the images of a set on disk into views.

    Args:
        dataset: The images.
        spec: How the network looks.
        coordinates: Read the object's coordinates too, ``N_coordinates.png`` beside ``N_rgb.png``.
        cache: Store the views in the cache folder (`ffpose.datasets.cache`), which later runs and
            other processes share, instead of in memory.

    Raises:
        ffpose.DataError: An image cannot be used, or has no coordinates.
    """
    records, preprocessing = dataset.records, dataset.preprocessing

    def cut(index: int) -> Pieces:
        record = records[index]
        frame = preprocessing.frame(dataset.load_image(index))
        seen = read_coordinates(record, record.camera) if coordinates else None
        return cut_pieces(frame, record.label, spec, seen)

    def pieces() -> Iterator[Pieces]:
        return decode_all(cut, range(len(records)))

    if not cache:
        arrays = {
            name: np.zeros(shape, kind) for name, (shape, kind) in spec.shapes(len(records)).items()
        }
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
    return cached_views(folder, len(records), spec, pieces)


def coordinates_file(record: Record) -> Path:
    """Return the file of an image's object coordinates.

    Raises:
        ffpose.DataError: There is no such file.
    """
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


def read_coordinates(record: Record, camera: Camera) -> Callable[[Pose, Camera], Bytes]:
    """Return the object's coordinates of an image as any camera of the same view sees them.

    Raises:
        ffpose.DataError: There is no such file, or it is another picture.
    """
    path = coordinates_file(record)
    with open_image(path) as image:
        picture = np.asarray(image)
    expected = (camera.height, camera.width, 4)
    if picture.shape != expected or picture.dtype != np.uint8:
        raise DataError(f"expected 8-bit RGBA of {camera.width}x{camera.height} pixels", path)
    return lambda _, window: nearest_pixels(picture, camera, window)
