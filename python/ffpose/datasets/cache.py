"""A cache of a dataset's decoded and resized frames, in one memory-mapped file.

The file is a `.npy` array in ``$FFPOSE_CACHE``, or in ``~/.cache/ffpose``; everything there may be
deleted at any time. Its name is the SHA-256 of a key: path, size and modification time of each
image in order, the size that it must have, how it is undistorted and scaled, how the frames are
made of it, and the version of Pillow, which decodes and resizes. The key leaves out the images'
contents, because reading 6 GB (5,000 images of 1280x960) at each start would take a minute from a
disk of 100 MB/s, and writing an image changes its modification time, which has a resolution of
nanoseconds. The cost is that a set that was moved or copied is decoded again.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import PIL
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write, expect_room, remove_leftovers
from ffpose.datasets.records import Record
from ffpose.imaging.images import decode_all
from ffpose.imaging.preprocessing import Preprocessing

FOLDER_VARIABLE = "FFPOSE_CACHE"

FORMAT = 2
"""Version of the file format; changing it invalidates every cache."""

BUILD_LIMIT_S = 86_400.0
"""Age in seconds beyond which an unfinished file is taken to be left by a killed process."""


class MappedFrames:
    """Frames in a memory-mapped file, as `cached_frames` writes it; pickled as the file's path.

    Processes that map the same file share its pages, whether forked or spawned.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._frames: NDArray[np.uint8] = np.asarray(np.load(path, mmap_mode="r"))

    def __reduce__(self) -> tuple[type[MappedFrames], tuple[Path]]:
        return MappedFrames, (self.path,)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Return frame ``index``, ``(H, W, 3)``, read-only."""
        return np.asarray(self._frames[index])


def cached_frames(records: Sequence[Record], preprocessing: Preprocessing) -> MappedFrames:
    """Return the cached frames of a dataset; decode them on all cores if there is no cache yet.

    An incomplete file is rewritten. Two processes that build a cache at the same time both do the
    work, and one file remains.

    Raises:
        ValueError: The frames of images of several sizes are not of one size.
        DataError: An image cannot be used, as in `Record.decode`.
        OSError: The folder cannot be written to, or the disk is full.
    """
    cameras = {(record.camera.width, record.camera.height) for record in records}
    sizes = {preprocessing.frame_size(*size) for size in cameras}
    if len(sizes) > 1:
        raise ValueError(f"cache: expected frames of one size, got {sorted(sizes)}")
    shape = (len(records), *sizes.pop(), 3)
    name = _name(records, shape, preprocessing)
    path = cache_folder() / f"{name}.npy"
    if not _is_whole(path, shape):
        _write(path, shape, lambda index: preprocessing.frame(records[index].decode()))
    return MappedFrames(path)


def cache_folder() -> Path:
    """Return the cache folder: ``$FFPOSE_CACHE``, or ``~/.cache/ffpose`` where that is not set."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else Path.home() / ".cache" / "ffpose"


def _name(records: Sequence[Record], shape: tuple[int, ...], preprocessing: Preprocessing) -> str:
    made = {k: v for k, v in preprocessing.to_dict().items() if k not in ("mean", "std")}
    digest = hashlib.sha256(repr((FORMAT, PIL.__version__, shape, made)).encode())
    for record in records:
        digest.update(repr(record.fingerprint()).encode())
    return digest.hexdigest()


def _is_whole(path: Path, shape: tuple[int, ...]) -> bool:
    """Return whether a file is a complete array of frames of this shape."""
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
    need = math.prod(shape)
    what = f"the frames of {shape[0]} images ({FOLDER_VARIABLE} names another folder)"
    expect_room(folder, need, what)
    header = {"descr": "|u1", "fortran_order": False, "shape": shape}
    try:
        # Written, not mapped: a full disk makes a write fail, but kills a process that maps.
        with atomic_write(target) as path, path.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            for frame in decode_all(decode, range(shape[0])):
                file.write(frame.data)
    except OSError as error:
        if _is_whole(target, shape):  # of another process, and mapped: Windows does not replace it
            return
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = f"{os.strerror(error.errno)}: {what} need {need / 1e9:.1f} GB"
            raise OSError(error.errno, message, str(folder)) from error
        raise
