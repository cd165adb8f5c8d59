"""Writes sets of images in URSO's layout, by any number of processes, and carries on after a kill.

A folder holds ``N_rgb.png``, the label files of `ffpose.render.tables` and ``manifest.json``.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ffpose.errors import require
from ffpose.files import remove_leftovers
from ffpose.geometry import Camera
from ffpose.render.conditions import conditions_of
from ffpose.render.layers import layer_names
from ffpose.render.manifest import Manifest, difference, sha256
from ffpose.render.pool import Job, prepare, render_all
from ffpose.render.renderer import camera_of, label
from ffpose.render.scene import Scene, get_scene
from ffpose.render.tables import image_name, write_conditions, write_tables

MAX_COUNT = 10_000_000
LEAST_BYTES_PER_PIXEL = 0.4
"""Noise keeps images above this; a usual set takes two or three times as much."""


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
    ray: bool = False,
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
        ray: render on the Ray cluster of this process, which ``RAY_ADDRESS`` names; without it on
            one that is begun on this machine. Every node needs ffpose, none the folder.

    Raises:
        ValueError: unknown set, absurd number, or a folder that holds another set.
        DataError: the folder's manifest cannot be read.
        OSError: the folder cannot be written to, or the disk has no room for the set. What was
            written stays, and the next run carries on with it.
        MissingExtraError: a package of the extra `render`, or `ray`, is not installed.
    """
    begin = time.perf_counter()
    scene = get_scene(scene) if isinstance(scene, str) else scene
    _check_range(count=(count, 1, MAX_COUNT), start=(start, 0, MAX_COUNT))
    _check_range(seed=(seed, 0, 2**63 - 1), workers=(workers, 1, 1024))
    camera = camera_of(scene, size)
    label(scene, seed, start)  # a scene that allows no pose fails here, before a file is written
    prepare(ray)
    job = Job(scene, seed, (camera.width, camera.height), Path(out), layers)
    manifest = Manifest.of(scene, seed, job.size, layers)
    begun = _begun(job, manifest)

    wanted = range(start, start + count)
    hashes = dict(_valid_images(job, wanted, begun.files)) if begun else {}
    missing = [index for index in wanted if index not in hashes]
    _check_room(job, len(missing))
    if begun is None:  # last, as a folder with a manifest takes no other set
        job.folder.mkdir(parents=True, exist_ok=True)
        manifest.write(job.folder)
    remove_leftovers(job.folder)
    with _bar(count, len(hashes), progress) as advance:
        for index, digest in render_all(job, missing, workers, ray):
            hashes[index] = digest
            advance()
    _close_folder(job, begun or manifest, hashes, camera)
    seconds = time.perf_counter() - begin
    return Written(job.folder, len(missing), count - len(missing), seconds)


def _check_range(**values: tuple[int, int, int]) -> None:
    """Check each (value, least, most)."""
    for name, (value, least, most) in values.items():
        if not least <= value <= most:
            raise ValueError(f"{name}: expected {least}…{most}, got {value}")


def _begun(job: Job, manifest: Manifest) -> Manifest | None:
    """The manifest in the folder, checked to be of the same set; None where nothing was begun."""
    # Images first: another shard that begins just now writes its manifest before its images.
    images = _indices(job.folder)
    old = Manifest.read(job.folder)
    if old is None:
        if images:
            raise ValueError(
                f"{job.folder}: expected an empty folder or a set that was begun here, "
                "got images without a manifest"
            )
        return None
    changed = difference(old, manifest)
    if changed:
        raise ValueError(f"{job.folder}: expected the same set as before, got {changed}")
    return old


def _check_room(job: Job, images: int) -> None:
    """Refuse what cannot fit, before hours of work meet a full disk."""
    least = int(LEAST_BYTES_PER_PIXEL * job.size[0] * job.size[1] * images)
    disk = next(place for place in (job.folder, *job.folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(disk).free
    if free < least:
        need = f"{images} images need at least {least / 1e9:.1f} GB, got {free / 1e9:.1f} GB free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {need}", str(job.folder))


def _close_folder(job: Job, manifest: Manifest, hashes: dict[int, str], camera: Camera) -> None:
    """Write labels and manifest of all images that are there, those of other shards included."""
    others = [index for index in _indices(job.folder) if index not in hashes]
    hashes = hashes | dict(_valid_images(job, others, manifest.files))
    indices = sorted(hashes)
    poses = [label(job.scene, job.seed, index) for index in range(indices[-1] + 1)]
    tables = write_tables(job.folder, poses, indices, camera)
    conditions = {index: conditions_of(job.scene, job.seed, index) for index in indices}
    tables.append(write_conditions(job.folder, conditions))
    files = {image_name(index): hashes[index] for index in indices}
    layers = [name for index in indices for name in layer_names(index)] if job.layers else []
    files |= {name: sha256(job.folder / name) for name in [*layers, *tables]}
    Manifest(manifest.parameters, manifest.versions, files).write(job.folder)


def _indices(folder: Path) -> list[int]:
    """Indices of the images in a folder, in order; none where there is no folder yet."""
    if not folder.is_dir():
        return []
    matches = (re.fullmatch(r"(\d+)_rgb\.png", path.name) for path in folder.iterdir())
    return sorted(int(match[1]) for match in matches if match)


def _valid_images(
    job: Job, indices: Sequence[int], known: dict[str, str]
) -> Iterator[tuple[int, str]]:
    """Index and SHA-256 of the images that are there and whole."""
    present = set(_indices(job.folder))
    for index in indices:
        if index not in present or not _has_layers(job, index, known):
            continue
        path = job.folder / image_name(index)
        digest = sha256(path)
        expected = known.get(path.name)
        if digest == expected or (expected is None and _readable(path, job.size)):
            yield index, digest


def _has_layers(job: Job, index: int, known: dict[str, str]) -> bool:
    """Whether the layers of an image are there, and as the manifest says."""
    names = layer_names(index) if job.layers else []
    for path in (job.folder / name for name in names):
        if not path.exists() or (path.name in known and known[path.name] != sha256(path)):
            return False
    return True


def _readable(path: Path, size: tuple[int, int]) -> bool:
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            return image.size == size
    except (OSError, SyntaxError):  # Pillow reports some broken files as SyntaxError
        return False


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
