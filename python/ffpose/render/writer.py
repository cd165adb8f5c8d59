"""Writes sets of images in URSO's layout, by any number of processes, and carries on after a kill.

A folder holds ``N_rgb.png``, the label files of `ffpose.render.tables` and ``manifest.json``.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ffpose.errors import require
from ffpose.files import atomic_write
from ffpose.geometry import Camera
from ffpose.render.layers import layer_names, render_layers, write_layers
from ffpose.render.manifest import Manifest, difference, sha256
from ffpose.render.renderer import camera_of, label, render
from ffpose.render.scene import Scene, get_scene
from ffpose.render.tables import image_name, write_tables

MAX_COUNT = 10_000_000
PNG_LEVEL = 3
"""Noise hardly compresses; higher levels cost time and save nothing."""


class Job(NamedTuple):
    """What every image of a run has in common."""

    scene: Scene
    seed: int
    size: tuple[int, int]
    folder: Path
    layers: bool


class Written(NamedTuple):
    """What a run did.

    Attributes:
        folder: where the set is.
        rendered: images made now.
        kept: valid images of earlier runs that were left as they were.
        seconds: wall time.
    """

    folder: Path
    rendered: int
    kept: int
    seconds: float


def write_dataset(
    scene: Scene | str,
    out: str | Path,
    count: int,
    seed: int = 0,
    *,
    start: int = 0,
    size: tuple[int, int] | None = None,
    workers: int = 1,
    layers: bool = False,
    progress: bool = False,
) -> Written:
    """Render the images `start` … `start + count − 1` of a set into a folder.

    The same arguments give the same bytes, whatever the number of workers and however often the
    run was killed and begun again; images that are already there are checked and kept. Shards of
    one set may write to one folder; afterwards one run over the whole range (which finds all
    images there) closes the set.

    Args:
        scene: a set, or the name of one (`ffpose.render.SCENES`).
        out: the folder; it is made if it does not exist.
        count: number of images, at least 1.
        seed: seed of the set, at least 0.
        start: index of the first image.
        size: (width, height) in pixels; default is that of the scene's camera.
        workers: processes; 1 renders in this one.
        layers: write mask, depth and keypoints of each image too (`ffpose.render.layers`).
        progress: show images per second and the time left on standard error.

    Raises:
        ValueError: unknown set, absurd number, or a folder that holds another set.
        DataError: the folder's manifest cannot be read.
        OSError: the folder cannot be written to, or the disk is full.
    """
    begin = time.perf_counter()
    scene = get_scene(scene) if isinstance(scene, str) else scene
    _check_range(count=(count, 1, MAX_COUNT), start=(start, 0, MAX_COUNT))
    _check_range(seed=(seed, 0, 2**63 - 1), workers=(workers, 1, 1024))
    camera = camera_of(scene, size)
    job = Job(scene, seed, (camera.width, camera.height), Path(out), layers)
    manifest = _open_folder(job)

    wanted = range(start, start + count)
    hashes = dict(_valid_images(job, wanted, manifest.files))
    missing = [index for index in wanted if index not in hashes]
    with _bar(count, len(hashes), progress) as advance:
        for index, digest in _render_all(job, missing, workers):
            hashes[index] = digest
            advance()
    _close_folder(job, manifest, hashes, camera)
    seconds = time.perf_counter() - begin
    return Written(job.folder, len(missing), count - len(missing), seconds)


def _check_range(**values: tuple[int, int, int]) -> None:
    """Check each (value, least, most)."""
    for name, (value, least, most) in values.items():
        if not least <= value <= most:
            raise ValueError(f"{name}: expected {least}…{most}, got {value}")


def _open_folder(job: Job) -> Manifest:
    """Make or check the folder; returns the manifest to carry on with."""
    job.folder.mkdir(parents=True, exist_ok=True)
    manifest = Manifest.of(job.scene, job.seed, job.size, job.layers)
    old = Manifest.read(job.folder)
    if old is None:
        if _indices(job.folder):
            raise ValueError(
                f"{job.folder}: expected an empty folder or a set that was begun here, "
                "got images without a manifest"
            )
        manifest.write(job.folder)
        return manifest
    changed = difference(old, manifest)
    if changed:
        raise ValueError(f"{job.folder}: expected the same set as before, got {changed}")
    return old


def _close_folder(job: Job, manifest: Manifest, hashes: dict[int, str], camera: Camera) -> None:
    """Write labels and manifest of all images that are there, those of other shards included."""
    others = [index for index in _indices(job.folder) if index not in hashes]
    hashes = hashes | dict(_valid_images(job, others, manifest.files))
    indices = sorted(hashes)
    poses = [label(job.scene, job.seed, index) for index in range(indices[-1] + 1)]
    tables = write_tables(job.folder, poses, indices, camera)
    files = {image_name(index): hashes[index] for index in indices}
    layers = [name for index in indices for name in layer_names(index)] if job.layers else []
    files |= {name: sha256(job.folder / name) for name in [*layers, *tables]}
    Manifest(manifest.parameters, manifest.versions, files).write(job.folder)


def _indices(folder: Path) -> list[int]:
    """Indices of the images in a folder, in order."""
    matches = (re.fullmatch(r"(\d+)_rgb\.png", path.name) for path in folder.iterdir())
    return sorted(int(match[1]) for match in matches if match)


def _valid_images(
    job: Job, indices: Sequence[int], known: dict[str, str]
) -> Iterator[tuple[int, str]]:
    """Index and SHA-256 of the images that are there and whole."""
    present = set(_indices(job.folder))
    for index in indices:
        if index not in present or not _has_layers(job, index):
            continue
        path = job.folder / image_name(index)
        digest = sha256(path)
        expected = known.get(path.name)
        if digest == expected or (expected is None and _readable(path, job.size)):
            yield index, digest


def _has_layers(job: Job, index: int) -> bool:
    names = layer_names(index) if job.layers else []
    return all((job.folder / name).exists() for name in names)


def _readable(path: Path, size: tuple[int, int]) -> bool:
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            return image.size == size
    except (OSError, SyntaxError):  # Pillow reports some broken files as SyntaxError
        return False


def _render_all(job: Job, indices: Sequence[int], workers: int) -> Iterator[tuple[int, str]]:
    """Render images; yields index and SHA-256 of each as it is done."""
    require("PIL", "render")
    if workers == 1 or len(indices) < 2:
        for index in indices:
            yield index, _render_one(job, index)
        return
    context = multiprocessing.get_context("spawn")
    with (
        _one_thread_each(),
        ProcessPoolExecutor(
            min(workers, len(indices)),
            mp_context=context,
            initializer=_start_worker,
            initargs=(job,),
        ) as pool,
    ):
        futures = {pool.submit(_worker_render, index): index for index in indices}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)


_worker_job: list[Job] = []
"""The job of this worker process; sent once, because a spacecraft may be a large mesh."""


def _start_worker(job: Job) -> None:
    _worker_job[:] = [job]


def _worker_render(index: int) -> str:
    return _render_one(_worker_job[0], index)


def _render_one(job: Job, index: int) -> str:
    from PIL import Image

    frame = render(job.scene, job.seed, index, job.size)
    if job.layers:
        # Before the image, so that where an image is its layers are.
        write_layers(job.folder, index, render_layers(job.scene, job.seed, index, job.size))
    target = job.folder / image_name(index)
    with atomic_write(target) as path:
        Image.fromarray(frame.image).save(path, compress_level=PNG_LEVEL)
        return sha256(path)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Workers started inside use one thread; more would only contend."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _bar(total: int, done: int, show: bool) -> Iterator[Callable[[], None]]:
    require("rich", "render")
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Speed(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.1f} images/s" if task.speed else "")

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Speed(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not show,
    )
    with bar:
        task = bar.add_task("render", total=total, completed=done)
        yield lambda: bar.advance(task)
