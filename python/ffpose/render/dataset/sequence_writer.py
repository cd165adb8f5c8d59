"""Writing the frames of a sequence: a set of the kind ``csv`` with the column ``time``."""

from __future__ import annotations

import csv
import json
import multiprocessing
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffpose._internal.files import atomic_write, expect_room, read_json, remove_leftovers
from ffpose._internal.machine import worker_processes
from ffpose._internal.seeds import refuse_final
from ffpose.errors import DataError
from ffpose.geometry import CAMERA_FILE
from ffpose.render.dataset.pool import PNG_LEVEL, one_thread_each, prepare
from ffpose.render.sequence import SEQUENCE, Sequence, render_frame

FRAMES = "frames.csv"
PARAMETERS = "sequence.json"
COLUMNS = ("image", "time", "tx", "ty", "tz", "qw", "qx", "qy", "qz")
LEAST_BYTES_PER_PIXEL = 0.4


class WrittenFrames(NamedTuple):
    """Result of a run.

    Attributes:
        folder: Folder of the sequence.
        rendered: Number of frames rendered by this run.
        kept: Number of frames of earlier runs that were kept.
        seconds: Wall time.
    """

    folder: Path
    rendered: int
    kept: int
    seconds: float


def frame_name(index: int) -> str:
    """Return the name of a frame's file."""
    return f"frame-{index:06d}.png"


def write_sequence(
    sequence: Sequence,
    out: str | Path,
    *,
    drop: float = 0.0,
    workers: int = 1,
) -> WrittenFrames:
    """Render the frames of a sequence into a folder, with ``frames.csv`` and ``camera.json``.

    The same arguments give the same bytes, for any number of workers and however often the run was
    killed; frames that are there are kept.

    Args:
        sequence: The frames.
        out: Folder to write to; created if it does not exist.
        drop: Share of the frames that are lost, 0 to 1, at random; the first is not.
        workers: Number of processes; 1 renders in the calling process.

    Raises:
        ValueError: A number is out of range, or the folder holds something else.
        DataError: The folder's ``sequence.json`` cannot be read.
        OSError: The folder cannot be written to, or the disk is full.
        MissingExtraError: A package of the extra `render` is not installed.
    """
    begin = time.perf_counter()
    if not 0 <= drop < 1:
        raise ValueError(f"drop: expected a share of at least 0 and below 1, got {drop}")
    if not 1 <= workers <= 1024:
        raise ValueError(f"workers: expected 1…1024, got {workers}")
    refuse_final(sequence.seed)
    prepare(sequence.scene)
    folder = Path(out)
    rng = np.random.default_rng([sequence.seed, SEQUENCE, 4])
    kept = np.flatnonzero(rng.random(len(sequence)) >= drop).tolist()
    wanted = sorted({0, *kept})
    _claim(folder, {**sequence.parameters(), "drop": drop})
    missing = [index for index in wanted if not (folder / frame_name(index)).exists()]
    least = LEAST_BYTES_PER_PIXEL * sequence.camera.width * sequence.camera.height * len(missing)
    expect_room(folder, int(least), f"{len(missing)} frames")
    remove_leftovers(folder)
    for _ in _rendered(sequence, folder, missing, workers):
        pass
    sequence.camera.write(folder / CAMERA_FILE)
    with (
        atomic_write(folder / FRAMES) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for index in wanted:
            when = float(sequence.trajectory.times[index])
            table.writerow([frame_name(index), when, *sequence.pose(index).vector.tolist()])
    seconds = time.perf_counter() - begin
    return WrittenFrames(folder, len(missing), len(wanted) - len(missing), seconds)


def _claim(folder: Path, parameters: dict[str, object]) -> None:
    """Write the parameters of a new sequence, or check those of one that was begun."""
    path = folder / PARAMETERS
    mine = json.loads(json.dumps(parameters))
    if path.exists():
        theirs = read_json(path)
        if not isinstance(theirs, dict):
            raise DataError("expected the parameters of a sequence", path)
        if theirs != mine:
            changed = sorted(key for key in mine if theirs.get(key) != mine[key])
            raise ValueError(
                f"{folder}: expected the same sequence as before, got another in {changed}"
            )
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(
            f"{folder}: expected an empty folder or a sequence that was begun here, "
            f"got files without {PARAMETERS}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(mine) + "\n", encoding="utf-8")


def _rendered(sequence: Sequence, folder: Path, indices: list[int], workers: int) -> Iterator[None]:
    """Render and write frames, and yield as each is done."""
    if workers == 1 or len(indices) < 2:
        for index in indices:
            _write(sequence, folder, index)
            yield
        return
    context = multiprocessing.get_context("spawn")
    with (
        one_thread_each(),
        ProcessPoolExecutor(
            worker_processes(workers, len(indices)), context, _start_worker, (sequence, folder)
        ) as pool,
    ):
        futures = [pool.submit(_worker_write, index) for index in indices]
        try:
            for future in as_completed(futures):
                future.result()
                yield
        finally:
            pool.shutdown(cancel_futures=True)


_worker_job: list[tuple[Sequence, Path]] = []
"""What this worker process renders; sent once, as a spacecraft may be a large mesh."""


def _start_worker(sequence: Sequence, folder: Path) -> None:
    _worker_job[:] = [(sequence, folder)]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent lets every worker finish its frame


def _worker_write(index: int) -> None:
    _write(*_worker_job[0], index)


def _write(sequence: Sequence, folder: Path, index: int) -> None:
    from PIL import Image

    image = Image.fromarray(render_frame(sequence, index))
    with atomic_write(folder / frame_name(index), durable=False) as path:
        image.save(path, "PNG", compress_level=PNG_LEVEL)
