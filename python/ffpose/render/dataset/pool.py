"""Rendering a set in this process, or in several processes.

Both call the same pure function, so the bytes do not depend on which of them is used.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.connection import wait
from pathlib import Path
from typing import NamedTuple

from ffpose._internal.files import atomic_write, sha256
from ffpose._internal.machine import worker_processes
from ffpose._internal.urso import image_name
from ffpose.errors import require
from ffpose.render.layers import render_layers, write_layers
from ffpose.render.renderer import render
from ffpose.render.scene import Scene

PNG_LEVEL = 3
"""Compression level of the PNG files; noise hardly compresses, so more costs time alone."""


class Job(NamedTuple):
    """Parameters that all images of a run share.

    Attributes:
        scene: The set to render.
        seed: Seed of the set.
        size: (width, height) of the images.
        folder: Folder to write to.
        labels: Layers to write beside each image, names in `ffpose.render.layers.LABELS`.
    """

    scene: Scene
    seed: int
    size: tuple[int, int]
    folder: Path
    labels: tuple[str, ...]


def prepare(scene: Scene) -> None:
    """Check that the renderer's packages are installed.

    Raises:
        MissingExtraError: A package of the extra `render`, or `mitsuba`, is not installed.
    """
    for package in ("embreex", "PIL", "rich"):
        require(package, "render")
    if scene.renderer == "mitsuba":
        require("mitsuba", "mitsuba")


def render_all(job: Job, indices: Sequence[int], workers: int) -> Iterator[tuple[int, str]]:
    """Render and write images; yield the index and SHA-256 of each as it is done.

    Args:
        job: Parameters of the run.
        indices: Indices of the images.
        workers: Number of processes.
    """
    if workers == 1 or len(indices) < 2:
        return ((index, render_one(job, index)) for index in indices)
    return _in_processes(job, indices, worker_processes(workers, len(indices)))


def render_one(job: Job, index: int) -> str:
    """Render and write one image and its layers, and return the image's SHA-256."""
    from PIL import Image

    frame = render(job.scene, job.seed, index, job.size)
    if job.labels:
        # Layers first: an image that exists then has its layers.
        layers = render_layers(job.scene, job.seed, index, job.size)
        write_layers(job.folder, index, layers, job.labels)
    target = job.folder / image_name(index)
    with atomic_write(target, durable=False) as path:  # a later run rerenders damaged files
        Image.fromarray(frame.image).save(path, compress_level=PNG_LEVEL)
        return sha256(path)


def _in_processes(job: Job, indices: Sequence[int], workers: int) -> Iterator[tuple[int, str]]:
    context = multiprocessing.get_context("spawn")
    with (
        one_thread_each(),
        ProcessPoolExecutor(
            workers,
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
"""Job of this worker process; sent once, because a spacecraft may be a large mesh."""


_busy = threading.Lock()
"""Lock that this worker process holds while it writes."""


def _start_worker(job: Job) -> None:
    _worker_job[:] = [job]
    # Only the parent handles Ctrl-C: it lets every worker finish its image.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit this worker between two images once its parent has exited for any reason."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        with _busy:
            os._exit(1)


def _worker_render(index: int) -> str:
    with _busy:
        return render_one(_worker_job[0], index)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit workers started in this context to one thread each; more would only contend."""
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
