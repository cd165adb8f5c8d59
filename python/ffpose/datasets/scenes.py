"""Rendered scenes as a data set: an endless set, of which any part is made when it is asked for.

A scene is a pure function of set, seed and index (`ffpose.render`), so that what is made once can
be kept: views (`ffpose.views`) and validation images lie in a folder whose name is the SHA-256 of
all that they depend on, and any number of runs and processes map one copy. Rendering needs the
extra `render`; what lies there already does not.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ffpose import __version__
from ffpose.datasets import PoseDataset, open_dataset
from ffpose.errors import DataError, require
from ffpose.files import remove_leftovers
from ffpose.transforms import Preprocessing
from ffpose.views import Pieces, ViewSpec, make_arrays, open_arrays

if TYPE_CHECKING:
    from ffpose.render import Scene

VALIDATION_START = 10_000_000
"""Index of the first scene that validates; those before it are to learn from."""


def find_scene(name: str, attitude_range_deg: tuple[float, float, float]) -> Scene:
    """Return a set of `ffpose.render.SCENES` with the attitudes asked for.

    Raises:
        MissingExtraError: The extra `render` is not installed.
        ValueError: The name is not known.
    """
    scenes = require("ffpose.render.scene", "render")
    scene: Scene = replace(scenes.get_scene(name), attitude_range_deg=attitude_range_deg)
    return scene


def open_views(
    root: Path, scene: Scene, seed: int, count: int, spec: ViewSpec, *, empty: bool, workers: int
) -> dict[str, NDArray[Any]]:
    """Return the views of the scenes 0 ... ``count - 1``, rendered now where they are not there.

    Args:
        root: The folder that keeps them.
        scene: The set.
        seed: Of the set.
        count: How many.
        spec: How the network looks.
        empty: Leave the spacecraft out.
        workers: Processes that render.

    Raises:
        ffpose.DataError: A folder of views is damaged.
    """
    from ffpose.render import views

    described = views.describe(scene, seed, spec, empty=empty)
    folder = root / f"views-{_digest({**described, 'count': count})}"
    if not folder.exists():
        pieces = views.render_views(scene, seed, range(count), spec, empty=empty, workers=workers)
        _store(folder, pieces, count, spec)
    try:
        return open_arrays(folder)
    except (OSError, ValueError) as error:
        text = f"expected views, remove the folder to make them anew: {error}"
        raise DataError(text, folder) from error


def _store(folder: Path, pieces: Iterator[Pieces], count: int, spec: ViewSpec) -> None:
    """Fill a folder of another name, and rename it: there are all views or none."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder.parent)
    with tempfile.TemporaryDirectory(prefix=".ffpose-", dir=folder.parent) as place:
        unfinished = Path(place) / folder.name
        unfinished.mkdir()
        arrays = make_arrays(unfinished, count, spec)
        for row, piece in enumerate(pieces):
            piece.store(arrays, row)
        for array in arrays.values():
            array.flush()
        if folder.exists():  # another process was faster
            shutil.rmtree(unfinished)
        else:
            unfinished.rename(folder)


def open_validation(
    root: Path, scene: Scene, seed: int, count: int, preprocessing: Preprocessing, *, workers: int
) -> PoseDataset:
    """Return ``count`` whole images that no training sees, of the network's input size."""
    from ffpose.render.writer import write_dataset

    height, width = preprocessing.size
    described = {"scene": scene.parameters(), "seed": seed, "size": (width, height)}
    folder = root / f"images-{_digest({**described, 'count': count})}"
    write_dataset(
        scene,
        folder,
        count,
        seed,
        start=VALIDATION_START,
        size=(width, height),
        workers=max(1, workers),
    )
    return open_dataset("urso", folder, "all", preprocessing)


def _digest(described: dict[str, Any]) -> str:
    text = json.dumps({**described, "ffpose": __version__}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
