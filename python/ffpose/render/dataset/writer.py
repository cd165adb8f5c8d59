"""Writing sets of images in URSO's layout, in parallel and resumably.

A folder holds ``N_rgb.png``, the label files of `ffpose.render.dataset.tables` and
``manifest.json``. Runs over parts of a set (shards) may share a folder without a lock: no two of
them write the same file, and each does the work of its own images alone. The run whose range covers
every image in the folder closes the set: it writes the label files of all images. Of shards that
end at the same time at most one sees no images but its own.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ffpose._internal.files import atomic_write, expect_room, remove_leftovers, sha256
from ffpose._internal.seeds import refuse_final
from ffpose._internal.urso import image_name, index_of
from ffpose.errors import DataError, expect, require
from ffpose.geometry import CAMERA_FILE, Camera
from ffpose.render.dataset.manifest import FILE_NAME, Manifest, difference, part_name, parts
from ffpose.render.dataset.tables import conditions_of, write_tables
from ffpose.render.layers import check_labels, depth_step, label_files, render_layers, write_layers
from ffpose.render.processes import in_processes
from ffpose.render.renderer import camera_of, label, render
from ffpose.render.scene import Scene
from ffpose.render.scene_file import find_scene

MAX_COUNT = 10_000_000
LEAST_BYTES_PER_PIXEL = 0.4
"""Lower bound on the size of an image file, given its noise; typical sets take two to three times
as much."""

PNG_LEVEL = 3
"""Compression level of the PNG files; noise hardly compresses, so more costs time alone."""


class Job(NamedTuple):
    """Parameters that all images of a run share; those of `write_dataset`."""

    scene: Scene
    seed: int
    size: tuple[int, int]
    folder: Path
    labels: tuple[str, ...]


class Written(NamedTuple):
    """Result of a run over a set, or a sequence.

    Attributes:
        folder: Folder of the set.
        rendered: Number of images rendered by this run.
        kept: Number of valid images of earlier runs that were kept.
        seconds: Wall time.
        closed: Whether label files and manifest include the images of this run. False where the
            folder has images of other runs too: a run over the whole range then closes the set.
    """

    folder: Path
    rendered: int
    kept: int
    seconds: float
    closed: bool


def write_dataset(
    scene: Scene | str | Path,
    out: str | Path,
    count: int,
    seed: int = 0,
    *,
    start: int = 0,
    size: tuple[int, int] | None = None,
    workers: int = 1,
    labels: Sequence[str] = (),
    progress: bool = False,
) -> Written:
    """Render the images `start` … `start + count − 1` of a set into a folder.

    The same arguments give the same bytes, for any number of workers and however often the run was
    killed and resumed; valid images in the folder are kept. Shards of one set may write to one
    folder at the same time; afterward one run over the whole range, which finds all images there,
    closes the set: it writes the label files and the manifest. A shard in a folder of its own is
    closed at once.

    Args:
        scene: A set, the name of one (`ffpose.render.SCENES`), or the path of one's file (.json).
        out: Folder to write to; created if it does not exist.
        count: Number of images, at least 1.
        seed: Seed of the set, at least 0 and none of `ffpose._internal.seeds.FINAL`.
        start: Index of the first image.
        size: (width, height) in pixels; default is that of the scene's camera.
        workers: Number of processes; 1 renders in the calling process.
        labels: Layers to write beside each image, names in `ffpose.render.layers.LABELS`.
        progress: Show images per second and the remaining time on standard error.

    Raises:
        ValueError: `scene` or one of `labels` is unknown, a number is out of range, or the folder
            holds another set.
        DataError: The folder's manifest cannot be read.
        OSError: The folder cannot be written to, or the disk is full. Images already written stay,
            and the next run resumes from them.
        MissingExtraError: A package of the extra `render`, or `mitsuba`, is not installed.
    """
    begin = time.perf_counter()
    scene = find_scene(scene)
    expect(1 <= count <= MAX_COUNT, "count", f"1…{MAX_COUNT}", count)
    expect(0 <= start <= MAX_COUNT, "start", f"0…{MAX_COUNT}", start)
    expect(0 <= seed < 2**63, "seed", f"0…{2**63 - 1}", seed)
    expect(1 <= workers <= 1024, "workers", "1…1024", workers)
    refuse_final(seed)
    camera = camera_of(scene, size)
    label(scene, seed, start)  # a scene that allows no pose fails before a file is written
    prepare(scene)
    job = Job(scene, seed, (camera.width, camera.height), Path(out), check_labels(labels))
    manifest = Manifest.of(scene, seed, job.size, job.labels)
    begun = _begun(job, manifest)

    wanted = range(start, start + count)
    found = _valid_images(job, wanted, begun.files) if begun else {}
    missing = [index for index in wanted if index not in found]
    least = int(LEAST_BYTES_PER_PIXEL * camera.width * camera.height * len(missing))
    expect_room(job.folder, least, f"{len(missing)} images")
    if begun is None:  # last of the checks, as a folder with a manifest accepts no other set
        job.folder.mkdir(parents=True, exist_ok=True)
        manifest.write(job.folder / FILE_NAME)
    remove_leftovers(job.folder)
    with _bar(count, len(found), progress) as advance:
        made = in_processes(partial(render_one, job), missing, workers)
        for index, digests in zip(missing, made, strict=True):
            found[index] = digests
            advance()
    files = {name: digest for index in wanted for name, digest in found[index].items()}
    closed = begun is not None and files.items() <= begun.files.items()
    if not _holds_images(job.folder, but=wanted):
        _close_set(job, manifest, files, wanted, camera)
        closed = True
    elif not closed:
        replace(manifest, files=files).write(job.folder / part_name(wanted))
    seconds = time.perf_counter() - begin
    return Written(job.folder, len(missing), count - len(missing), seconds, closed)


def prepare(scene: Scene) -> None:
    """Check that the renderer's packages are installed, or raise a MissingExtraError."""
    for package in ("embreex", "PIL", "rich"):
        require(package, "render")
    if scene.renderer == "mitsuba":
        require("mitsuba", "mitsuba")


def render_one(job: Job, index: int) -> dict[str, str]:
    """Render and write one image and its layers, and return the SHA-256 of each by name."""
    from PIL import Image

    frame = render(job.scene, job.seed, index, job.size)
    if job.labels:
        # Layers first: an image that exists then has its layers.
        layers = render_layers(job.scene, job.seed, index, job.size)
        write_layers(job.folder, index, layers, job.labels, depth_step(job.scene))
    target = job.folder / image_name(index)
    with atomic_write(target, durable=False) as path:  # a later run rerenders damaged files
        Image.fromarray(frame.image).save(path, compress_level=PNG_LEVEL)
    return _digests(job, index)


def _digests(job: Job, index: int) -> dict[str, str]:
    """Return the SHA-256 of an image and its layers by name; FileNotFoundError without one."""
    names = image_name(index), *label_files(index, job.labels)
    return {name: sha256(job.folder / name) for name in names}


def _begun(job: Job, manifest: Manifest) -> Manifest | None:
    """Return the folder's manifest, checked to be of the same set; None for a new set."""
    # These first: another shard that starts right now writes its manifest before them.
    found = ["images"] if _holds_images(job.folder) else []
    camera = job.folder / CAMERA_FILE
    if camera.exists() and Camera.read(camera) != camera_of(job.scene, job.size):
        found.append(f"another {CAMERA_FILE}")
    old = Manifest.read(job.folder / FILE_NAME)
    if old is None:
        if found:
            raise ValueError(
                f"{job.folder}: expected an empty folder or a set that was begun here, "
                f"got {' and '.join(found)} without a manifest: move it, or write elsewhere"
            )
        return None
    changed = difference(old, manifest)
    if changed:
        raise ValueError(f"{job.folder}: expected the same set as before, got {changed}")
    return old


def _close_set(
    job: Job, manifest: Manifest, files: dict[str, str], indices: range, camera: Camera
) -> None:
    """Write label files and manifest of a folder that holds these images and no others."""
    poses = {index: label(job.scene, job.seed, index) for index in indices}
    conditions = {index: conditions_of(job.scene, job.seed, index) for index in indices}
    tables = write_tables(job.folder, camera, poses, conditions)
    files = files | {name: sha256(job.folder / name) for name in tables}
    replace(manifest, files=files).write(job.folder / FILE_NAME)
    for path in parts(job.folder, indices):
        path.unlink(missing_ok=True)


def _holds_images(folder: Path, but: range = range(0)) -> bool:
    """Return whether a folder holds images outside a range; stops at the first."""
    if not folder.is_dir():
        return False
    with os.scandir(folder) as entries:
        indices = (index_of(entry.name) for entry in entries)
        return any(index is not None and index not in but for index in indices)


def _valid_images(job: Job, indices: range, closed: dict[str, str]) -> dict[int, dict[str, str]]:
    """Return the SHA-256 by name of the files of each image that exists, whole, with its layers."""
    known = dict(closed)
    for path in parts(job.folder, indices):
        part = Manifest.read(path)
        known |= part.files if part else {}
    valid, points = {}, len(job.scene.build().keypoints)
    for index in indices:
        try:
            digests = _digests(job, index)
        except FileNotFoundError:
            continue
        if all(
            known[name] == its if name in known else readable(job.folder / name, job.size, points)
            for name, its in digests.items()
        ):
            valid[index] = digests
    return valid


def readable(path: Path, size: tuple[int, int], rows: int = 0) -> bool:
    """Return whether a file is a whole image ``(width, height)``, or a table of so many rows."""
    from ffpose.imaging.images import open_image

    if path.suffix == ".csv":
        content = path.read_bytes()
        return content.endswith(b"\n") and content.count(b"\n") == 1 + rows
    try:
        with open_image(path) as image:
            image.load()
            return image.size == size
    except (FileNotFoundError, DataError):
        return False


@contextmanager
def _bar(total: int, done: int, show: bool) -> Iterator[Callable[[], None]]:
    from rich import progress
    from rich.console import Console
    from rich.text import Text

    class Speed(progress.ProgressColumn):
        def render(self, task: progress.Task) -> Text:
            return Text(f"{task.speed:.1f} images/s" if task.speed else "")

    columns = progress.BarColumn(), progress.MofNCompleteColumn(), Speed()
    with progress.Progress(
        "render",
        *columns,
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not show,
    ) as bar:
        task = bar.add_task("render", total=total, completed=done)
        yield lambda: bar.advance(task)
