"""Rendered scenes as a dataset: an unlimited set, rendered on demand and cached.

A scene is a pure function of set, seed and index (`ffpose.render`), so rendered data can be cached:
patches (`ffpose.datasets.patches`) and validation images lie in a folder whose name is the digest
of all that they depend on and, of patches, their number; any number of runs and processes map one
copy. Needs the extra `render`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ffpose._internal.files import atomic_write
from ffpose.datasets import PoseDataset, open_dataset
from ffpose.datasets.patches import cached_patches, digest, open_patches
from ffpose.imaging.patches import Content, Patches, PatchSpec
from ffpose.imaging.preprocessing import Preprocessing

if TYPE_CHECKING:
    from ffpose.render import Scene


def rendered_patches(
    root: Path,
    scene: Scene,
    seed: int,
    count: int,
    spec: PatchSpec,
    *,
    content: Content = "object",
    workers: int,
    quiet: bool = True,
) -> dict[str, NDArray[Any]]:
    """Return the patches of the scenes 0 ... ``count - 1``; render those that are not cached.

    A folder of more scenes has those of fewer, and one of fewer is where one of more begins. What
    is in view is as for `ffpose.render.patches.render_patches`. Unless ``quiet``, a bar on standard
    error shows how many are there.

    Raises:
        ffpose.DataError: A folder of patches is damaged.
        OSError: The disk is full.
    """
    from rich.console import Console
    from rich.progress import track

    from ffpose.render.patches import describe, render_all_patches

    name = f"views-{digest(describe(scene, seed, spec, content))}"
    there = _folders(root, name)
    enough = min((each for each in there if each >= count), default=None)
    if enough is not None:
        return {part: array[:count] for part, array in open_patches(there[enough]).items()}
    fewer = max(there, default=0)

    def pieces() -> Iterable[Patches]:
        return track(
            render_all_patches(scene, seed, range(fewer, count), spec, content, workers),
            "rendering views",
            count - fewer,
            console=Console(stderr=True),
            transient=True,
            disable=quiet,
        )

    begun = open_patches(there[fewer]) if fewer else {}
    return cached_patches(root / f"{name}-{count}", count, spec, pieces, begun)


def _folders(root: Path, name: str) -> dict[int, Path]:
    """Return a set's folders of patches by their numbers of scenes."""
    return {
        int(match[1]): folder
        for folder in root.glob(f"{name}-*")
        if (match := re.fullmatch(rf"{name}-(\d+)", folder.name))
    }


def open_frames(
    root: Path, scene: Scene, seed: int, count: int, preprocessing: Preprocessing, *, workers: int
) -> PoseDataset:
    """Return the scenes 0 ... ``count - 1`` as whole images of the network's input size."""
    folder = render_images(root, "frames", scene, seed, count, preprocessing, workers=workers)
    return open_dataset("urso", folder, "all", preprocessing)


def render_images(
    root: Path,
    name: str,
    scene: Scene,
    seed: int,
    count: int,
    preprocessing: Preprocessing,
    *,
    workers: int,
) -> Path:
    """Render the scenes 0 ... ``count - 1`` as images of a network's input size, unless there.

    Returns:
        The folder within ``root``, a set in URSO's layout, whose name begins with ``name``.
    """
    from ffpose.render.dataset.manifest import versions_of
    from ffpose.render.dataset.writer import write_dataset

    height, width = preprocessing.frame_size(scene.camera.width, scene.camera.height)
    described = {
        "scene": scene.parameters(),
        "seed": seed,
        "size": (width, height),
        "count": count,
        "versions": versions_of(scene),
    }
    folder = root / f"{name}-{digest(described)}"
    write_dataset(scene, folder, count, seed, size=(width, height), workers=max(1, workers))
    return folder


def open_strangers(
    root: Path, scene: Scene, seed: int, count: int, preprocessing: Preprocessing, *, workers: int
) -> NDArray[np.uint8]:
    """Return whole images of other spacecraft ``(N, H, W, 3)``, of the network's input size.

    They are the scenes 0 ... ``count - 1``, each with one of random parts in the object's place.
    """
    from ffpose.render.processes import in_processes

    height, width = preprocessing.size
    described = {"scene": scene.parameters(), "seed": seed, "strangers": (width, height, count)}
    path = root / f"strangers-{digest(described)}.npy"
    if not path.exists():
        make = partial(_stranger, scene, seed, (width, height))
        images = list(in_processes(make, range(count), workers))
        root.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as temporary:
            np.save(temporary, np.stack(images))
    return np.asarray(np.load(path, mmap_mode="r"))


def _stranger(scene: Scene, seed: int, size: tuple[int, int], index: int) -> NDArray[np.uint8]:
    from ffpose.render.renderer import camera_of, shoot
    from ffpose.render.spacecraft.decoys import build_decoy

    shown = scene.with_stranger(build_decoy(seed, index))
    return shoot(shown, seed, index, camera_of(scene, size)).image
