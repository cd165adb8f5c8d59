"""Writing the frames of a sequence: a set of the kind ``csv`` with the column ``time``."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from functools import partial
from pathlib import Path

import numpy as np

from ffpose._internal.files import (
    atomic_write,
    expect_room,
    read_json,
    remove_leftovers,
    write_csv,
    write_json,
)
from ffpose._internal.seeds import refuse_final
from ffpose.errors import DataError, expect
from ffpose.geometry import CAMERA_FILE, POSE_COLUMNS
from ffpose.render.dataset.manifest import versions_of
from ffpose.render.dataset.writer import (
    LEAST_BYTES_PER_PIXEL,
    PNG_LEVEL,
    Written,
    prepare,
    readable,
)
from ffpose.render.processes import in_processes
from ffpose.render.sequence import SEQUENCE, Sequence, render_frame

FRAMES = "frames.csv"
PARAMETERS = "sequence.json"
COLUMNS = ("image", "time", *POSE_COLUMNS)


def frame_name(index: int) -> str:
    """Return the name of a frame's file."""
    return f"frame-{index:06d}.png"


def write_sequence(
    sequence: Sequence,
    out: str | Path,
    *,
    drop: float = 0.0,
    workers: int = 1,
) -> Written:
    """Render the frames of a sequence into a folder, with ``frames.csv`` and ``camera.json``.

    The same arguments give the same bytes, for any number of workers and however often the run was
    killed; intact frames in the folder are kept. A share ``drop`` of the frames is lost, 0 to 1, at
    random; the first is not.

    Raises:
        ValueError: A number is out of range, or the folder holds something else.
        DataError: The folder's ``sequence.json`` cannot be read.
        OSError: The folder cannot be written to, or the disk is full.
        MissingExtraError: A package of the extra `render` is not installed.
    """
    begin = time.perf_counter()
    expect(0 <= drop < 1, "drop", "a share of at least 0 and below 1", drop)
    expect(1 <= workers <= 1024, "workers", "1…1024", workers)
    refuse_final(sequence.seed)
    prepare(sequence.scene)
    folder = Path(out)
    rng = np.random.default_rng([sequence.seed, SEQUENCE, 4])
    kept = np.flatnonzero(rng.random(len(sequence)) >= drop).tolist()
    wanted = sorted({0, *kept})
    about = {**sequence.parameters(), "drop": drop, "versions": versions_of(sequence.scene)}
    about = json.loads(json.dumps(about))
    begun = _begun(folder, about)
    size = sequence.camera.width, sequence.camera.height
    missing = [index for index in wanted if not readable(folder / frame_name(index), size)]
    least = LEAST_BYTES_PER_PIXEL * math.prod(size) * len(missing)
    expect_room(folder, int(least), f"{len(missing)} frames")
    if not begun:  # last of the checks, as a folder with parameters accepts no other sequence
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / PARAMETERS, about, None)
    remove_leftovers(folder)
    deque(in_processes(partial(_write, sequence, folder), missing, workers), maxlen=0)
    sequence.camera.write(folder / CAMERA_FILE)
    times = sequence.trajectory.times
    rows = ([frame_name(n), float(times[n]), *sequence.pose(n).vector.tolist()] for n in wanted)
    write_csv(folder / FRAMES, [COLUMNS, *rows])
    seconds = time.perf_counter() - begin
    return Written(folder, len(missing), len(wanted) - len(missing), seconds, closed=True)


def _begun(folder: Path, mine: dict[str, object]) -> bool:
    """Return whether the sequence of these parameters was begun in a folder, else it is empty."""
    path = folder / PARAMETERS
    if path.exists():
        theirs = read_json(path)
        if not isinstance(theirs, dict):
            raise DataError("expected the parameters of a sequence", path)
        if theirs != mine:
            keys = mine.keys() | theirs.keys()
            changed = sorted(key for key in keys if theirs.get(key) != mine.get(key))
            raise ValueError(
                f"{folder}: expected the same sequence as before, got another in {changed}"
            )
        return True
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(
            f"{folder}: expected an empty folder or a sequence that was begun here, "
            f"got files without {PARAMETERS}"
        )
    return False


def _write(sequence: Sequence, folder: Path, index: int) -> None:
    from PIL import Image

    image = Image.fromarray(render_frame(sequence, index))
    with atomic_write(folder / frame_name(index), durable=False) as path:
        image.save(path, "PNG", compress_level=PNG_LEVEL)
