"""A cache of the views of a network with a second look, in folders of memory-mapped arrays.

The views of a set (`ffpose.imaging.views`) lie in one folder, whose name is a digest of all that
they depend on; any number of runs and processes map one copy.
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose import __version__
from ffpose._internal.files import expect_room, remove_leftovers
from ffpose.errors import DataError
from ffpose.imaging.views import Pieces, ViewSpec, make_arrays, open_arrays

BUILD_LIMIT_S = 86_400.0
"""Age in seconds beyond which unfinished views are taken to be left by a killed process."""


def cached_views(
    folder: Path, count: int, spec: ViewSpec, pieces: Callable[[], Iterator[Pieces]]
) -> dict[str, NDArray[Any]]:
    """Return the views in a folder; write them where it does not exist yet.

    Args:
        folder: The folder, named by `digest` of all that the views depend on.
        count: Number of views.
        spec: Geometry of the network's two views.
        pieces: Function that yields the views in order.

    Raises:
        ffpose.DataError: The folder is damaged, or an image of ``pieces`` cannot be used.
        OSError: The disk is full.
    """
    if not folder.exists():
        _store(folder, count, spec, pieces())
    try:
        return open_arrays(folder)
    except (OSError, ValueError, EOFError) as error:
        text = f"expected views, remove the folder to make them anew: {error}"
        raise DataError(text, folder) from error


def digest(described: dict[str, Any]) -> str:
    """Return a name for what ``described`` determines in this version of ffpose."""
    text = json.dumps({**described, "ffpose": __version__}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _store(folder: Path, count: int, spec: ViewSpec, pieces: Iterator[Pieces]) -> None:
    """Write the views to a temporary folder and rename it, so that all exist or none."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder.parent, older_than=BUILD_LIMIT_S)
    # A mapped file on a full disk would kill the process.
    need = sum(
        math.prod(shape) * np.dtype(kind).itemsize for shape, kind in spec.shapes(count).values()
    )
    expect_room(folder.parent, need, f"{count} views")
    with tempfile.TemporaryDirectory(prefix=".ffpose-", dir=folder.parent) as place:
        unfinished = Path(place) / folder.name
        unfinished.mkdir()
        _fill(make_arrays(unfinished, count, spec), pieces)  # Windows renames no mapped files
        try:
            unfinished.rename(folder)
        except OSError:
            if not folder.exists():  # otherwise another process was faster
                raise


def _fill(arrays: Mapping[str, np.memmap[Any, Any]], pieces: Iterator[Pieces]) -> None:
    """Write the views into the arrays' files."""
    for row, piece in enumerate(pieces):
        piece.store(arrays, row)
    for array in arrays.values():
        array.flush()
