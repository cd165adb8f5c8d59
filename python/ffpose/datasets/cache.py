"""The frames of a data set, decoded and resized once into a file that every process maps.

The file is a `.npy` array in ``$FFPOSE_CACHE``, or in ``~/.cache/ffpose``; whatever lies there may
be deleted. Its name is the SHA-256 of what its bytes follow from: path, size and time of change of
each image in order, the size that the images must have, size and interpolation of the frames, and
the version of Pillow, which decodes and resizes. Not of the images' bytes: 6 GB, 5,000 images of
1280x960, would be read at each start, a minute from a disk of 100 MB/s, and whoever writes an image
changes its time, which counts nanoseconds. The price: a set that was moved or copied is decoded
again.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import PIL
from numpy.typing import NDArray

from ffpose.datasets.records import Record
from ffpose.files import atomic_write, expect_room, remove_leftovers
from ffpose.geometry import Camera
from ffpose.preprocessing import Preprocessing

FOLDER_VARIABLE = "FFPOSE_CACHE"

FORMAT = 1
"""Of the file's contents; another number makes every cache anew."""

CHUNK = 256
"""Frames that are decoded before they are written, so that a slow disk fills no memory."""

BUILD_LIMIT_S = 86_400.0
"""A file that is older and not finished was left by a process that was killed."""


class MappedFrames:
    """Frames in a file, mapped into memory; pickles as the file's path.

    Processes that map one file share its pages, whether they were forked or spawned.

    Args:
        path: The file, as `cached_frames` writes it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._frames: NDArray[np.uint8] = np.asarray(np.load(path, mmap_mode="r"))

    def __reduce__(self) -> tuple[type[MappedFrames], tuple[Path]]:
        return MappedFrames, (self.path,)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Return frame ``index``, ``(H, W, 3)``, read-only."""
        frame: NDArray[np.uint8] = self._frames[index]
        return frame


def cached_frames(
    records: Sequence[Record], camera: Camera, preprocessing: Preprocessing
) -> MappedFrames:
    """Return the frames of a data set, which are decoded on all cores if no run has done so.

    A file that is not whole is written again. Two processes that write one at the same time do the
    work twice, and leave one file.

    Args:
        records: The images.
        camera: Their camera.
        preprocessing: What makes the frames (`Preprocessing.frame`).

    Raises:
        DataError: As `Record.decode`.
        OSError: The folder cannot be written to, or has no room.
    """
    shape = (len(records), *preprocessing.frame_size(camera.width, camera.height), 3)
    name = _name(records, camera, shape, preprocessing.interpolation)
    path = cache_folder() / f"{name}.npy"
    if not _is_whole(path, shape):
        _write(path, shape, lambda index: preprocessing.frame(records[index].decode(camera)))
    return MappedFrames(path)


def cache_folder() -> Path:
    """Return the folder of ``$FFPOSE_CACHE``, or ``~/.cache/ffpose`` where that is not set."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else Path.home() / ".cache" / "ffpose"


def _name(
    records: Sequence[Record], camera: Camera, shape: tuple[int, ...], interpolation: str
) -> str:
    digest = hashlib.sha256(repr((FORMAT, PIL.__version__, shape, interpolation)).encode())
    digest.update(repr((camera.width, camera.height)).encode())
    for record in records:
        digest.update(repr(record.fingerprint()).encode())
    return digest.hexdigest()


def _is_whole(path: Path, shape: tuple[int, ...]) -> bool:
    """Whether a file holds frames of this shape, and nothing before or after them is missing."""
    try:
        frames = np.load(path, mmap_mode="r")
    except (FileNotFoundError, ValueError, EOFError):  # absent, no array, or cut off
        return False
    if frames.dtype != np.uint8 or frames.shape != shape:
        return False
    return bool(path.stat().st_size == frames.offset + frames.nbytes)


def _write(
    target: Path, shape: tuple[int, ...], decode: Callable[[int], NDArray[np.uint8]]
) -> None:
    folder = target.parent
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder, older_than=BUILD_LIMIT_S)
    frames, need = range(shape[0]), math.prod(shape)
    what = f"the frames of {shape[0]} images ({FOLDER_VARIABLE} names another folder)"
    expect_room(folder, need, what)
    header = {"descr": "|u1", "fortran_order": False, "shape": shape}
    try:
        # Not through a map: on a full disk that kills the process, and a write is an error.
        with (
            atomic_write(target) as path,
            path.open("wb") as file,
            ThreadPoolExecutor() as pool,  # Pillow decodes and resizes without the GIL
        ):
            np.lib.format.write_array_header_1_0(file, header)
            for start in frames[::CHUNK]:
                for frame in pool.map(decode, frames[start : start + CHUNK]):
                    file.write(frame.data)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = f"{os.strerror(error.errno)}: {what} need {need / 1e9:.1f} GB"
            raise OSError(error.errno, message, str(folder)) from error
        raise
