"""Calibration of a weights file: what is found, and on which images, is written into its header."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch.utils.data import DataLoader

from ffpose import __version__
from ffpose._internal.seeds import CHOICES, matching
from ffpose.config import looks_twice
from ffpose.datasets import PoseDataset, Sample
from ffpose.datasets.scenes import find_scene, open_frames
from ffpose.evaluation.metrics import pose_error
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import PoseNetwork, SecondLookNetwork, load_network, read_metadata
from ffpose.models.weights import write_weights
from ffpose.models.zoo import resolve
from ffpose.training.calibrate import Calibration, calibrate
from ffpose.training.calibration_images import CalibrationSet, command_of, open_calibration
from ffpose.training.config import CalibrationImages
from ffpose.training.tasks import VALIDATION_BATCH, standardized


def calibrate_weights(
    weights: str | Path,
    images: CalibrationImages,
    *,
    turns: Sequence[int] = (),
    out: Path | None = None,
) -> Calibration:
    """Calibrate a weights file on images that are opened, or rendered, as its network sees them.

    Args:
        weights: Weights file, or name of shipped weights.
        images: The images.
        turns: Numbers of rotated views to choose from, by the median rotation error on as many
            rendered images of `ffpose._internal.seeds.CHOICES`; none to keep the number.
        out: File to write; None for that which was read, if ``weights`` is no name.

    Returns:
        What was found; the file's other tensors stay bit for bit.

    Raises:
        FileNotFoundError: No such file, name or image set.
        ValueError: The network has no second look or no rotated views to choose from, there are no
            images, ``turns`` are given for images on disk, or ``weights`` is a name and there is no
            ``out``.
        ffpose.DataError: The weights or an image cannot be used.
    """
    metadata = read_metadata(weights)
    if not looks_twice(metadata.config):
        raise ValueError(
            "weights: expected a network with a second look, which alone is calibrated"
        )
    if out is None and resolve(weights) != Path(weights):
        raise ValueError(f"out: expected a file, as {weights} is installed for all; got none")
    chosen: dict[str, Any] = {}
    if turns:
        chosen = choose_turns(weights, images, turns, metadata.preprocessing)
    opened = open_calibration(images, metadata.preprocessing)
    return write_calibrated(weights, opened, chosen=chosen, out=out)


def write_calibrated(
    weights: str | Path,
    images: CalibrationSet,
    *,
    chosen: dict[str, Any] | None = None,
    out: Path | None = None,
) -> Calibration:
    """Calibrate a weights file on opened images; see `calibrate_weights`.

    Args:
        weights: Weights file, or name of shipped weights.
        images: The images.
        chosen: What `choose_turns` returned; None or empty to keep the number of views.
        out: File to write; None for that which was read.
    """
    path, metadata = resolve(weights), read_metadata(weights)
    fields = {"turns": chosen["turns"]} if chosen else {}
    model = load_network(path, **fields)
    assert isinstance(model, SecondLookNetwork)
    model.variance_scales.fill_(1)  # so that the same images always give the same scales
    model.config = replace(model.config, distance_scale=1.0, doubt_sigma=(0.0, 0.0))
    preprocessing = images.whole.preprocessing
    empty = [] if images.empty is None else standardized(images.empty, preprocessing)
    hard = chain.from_iterable(map(_batches, images.hard))
    found = calibrate(model, _batches(images.whole), empty, hard)
    about: dict[str, Any] = {
        "command": command_of(
            Path(weights).name, images.config, list(chosen["medians"]) if chosen else []
        ),
        "images": images.about,
    }
    threshold = metadata.in_view_threshold if images.empty is None else found.in_view_threshold
    config = replace(
        model.config,
        distance_scale=found.distance_scale,
        doubt_sigma=found.doubt_sigma,
        degrees_of_freedom=found.degrees_of_freedom,
    )
    header = replace(
        metadata,
        config=config,
        in_view_threshold=threshold,
        calibration=about | ({"chosen": chosen} if chosen else {}),
        version=__version__,
    )
    state = load_file(path) | {"variance_scales": found.variance_scales}
    write_weights(path if out is None else out, state, header)
    return found


def choose_turns(
    weights: str | Path,
    images: CalibrationImages,
    turns: Sequence[int],
    preprocessing: Preprocessing,
) -> dict[str, Any]:
    """Choose the number of rotated views with the lowest median rotation error.

    Returns:
        ``turns``, ``medians`` in degrees for each number, and ``images``: which ones.
    """
    if images.kind != "scenes":
        raise ValueError(f"turns: expected with data.kind scenes, got {images.kind}")
    seed = matching(CHOICES, images.seed)
    scene = find_scene(images.scene, images.attitude_range_deg)
    shown = open_frames(
        images.root, scene, seed, images.count, preprocessing, workers=images.workers
    )
    medians = {}
    for number in turns:
        model = load_network(weights, turns=number)
        medians[number] = float(np.median(np.concatenate(list(_rotation_errors(model, shown)))))
    about = {"scene": images.scene, "seed": seed, "count": images.count}
    return {"turns": min(medians, key=medians.__getitem__), "medians": medians, "images": about}


def _rotation_errors(model: PoseNetwork, images: PoseDataset) -> Iterator[NDArray[Any]]:
    """Yield the rotation errors of each batch, degrees."""
    for batch in _batches(images):
        with torch.inference_mode():
            t, q, *_ = model(batch.image)
        yield pose_error(t, q, batch.translation, batch.orientation).rotation_deg.numpy()


def _batches(images: PoseDataset) -> Iterable[Sample]:
    return DataLoader(images, VALIDATION_BATCH)
