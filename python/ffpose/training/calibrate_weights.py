"""Calibration of a weights file: what is found, and on which images, is written into its header."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from safetensors.torch import load
from torch import Tensor
from torch.utils.data import DataLoader

from ffpose import __version__
from ffpose._internal.files import expect_place
from ffpose._internal.zoo import resolve
from ffpose.config import looks_twice
from ffpose.datasets import Decoding, PoseDataset, Sample
from ffpose.imaging.patches import Bytes
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import agree, lens_of
from ffpose.models import PolarPose, WeightsMetadata, load_network, read_metadata
from ffpose.models.weights import write_weights
from ffpose.render import SCENES
from ffpose.training.calibrate import Calibration, calibrate, with_calibration
from ffpose.training.calibration_images import CalibrationSet, command_of, open_calibration
from ffpose.training.config import VARIANTS, CalibrationImages
from ffpose.training.provenance import scene_name
from ffpose.training.tasks import VALIDATION_BATCH

LEAST_IMAGES = 10
"""Fewest labeled images; two variances and two tails are found of their errors."""


def calibrate_weights(
    weights: str | Path, images: CalibrationImages, *, out: Path | None = None
) -> Calibration:
    """Calibrate a weights file on images that are opened, or rendered, as its network sees them.

    ``weights`` may be a name; ``out`` is the file to write, None for that which was read. The
    file's other tensors stay bit for bit.

    Raises:
        FileNotFoundError: No such file, name or image set.
        OSError: The file to write cannot be written.
        ValueError: The network has no second look, there are no images or too few labeled ones,
            they are of another camera than the weights', neither they nor the weights' header name
            a set, or ``weights`` is a name and there is no ``out``.
        ffpose.DataError: The weights or an image cannot be used.
    """
    metadata = read_metadata(weights)
    if not looks_twice(metadata.config):
        raise ValueError(
            "weights: expected a network with a second look, which alone is calibrated"
        )
    if out is None and resolve(weights) != Path(weights):
        raise ValueError(f"out: expected a file, as {weights} is installed for all; got none")
    expect_place(resolve(weights) if out is None else out)
    if images.kind == "scenes":
        opened = open_calibration(_as_trained(images, metadata), metadata.preprocessing)
    else:
        opened = _labeled(images, metadata)
    return write_calibrated(weights, opened, out=out)


def _labeled(images: CalibrationImages, metadata: WeightsMetadata) -> CalibrationSet:
    """Open images of a set on disk, which are to be such as the weights were trained on."""
    decoding = Decoding(images.undistort, images.white)
    decoding = decoding.completed(metadata.undistorted, metadata.white)
    images = replace(images, undistort=decoding.undistort, white=decoding.white)
    opened = open_calibration(images, metadata.preprocessing)
    opened.whole.expect_target(metadata.locates)
    camera, view = opened.whole.camera, metadata.config.view_camera
    assert view is not None  # a second look points a camera
    if (
        camera is None
        or lens_of(camera) is not None
        or not agree(metadata.preprocessing.camera(camera), view)
    ):
        raise ValueError(
            f"data: expected images of the weights' camera, {metadata.camera}, without distortion,"
            f" got {'those of several' if camera is None else camera}"
        )
    if len(opened.whole) < LEAST_IMAGES:
        raise ValueError(
            f"data: expected at least {LEAST_IMAGES} images in {images.split}, as fewer tell"
            f" nothing of how large errors are, got {len(opened.whole)}"
        )
    return opened


def _as_trained(images: CalibrationImages, metadata: WeightsMetadata) -> CalibrationImages:
    """Return images as of one of the weights' training sets, of all kinds that training saw.

    It is the first where none is named; images of a set that is none of them stay as they are.
    Ranges that differ from the defaults were asked for, and stay.
    """
    sets = [each["scene"] for each in (metadata.data or {}).get("sets", [])]
    seen = (metadata.recipe or {}).get("data", {})
    scene, plain = images.scene, CalibrationImages()
    if scene is None and sets:
        (scene, *_) = sets
        if scene not in SCENES:
            raise ValueError(
                f"data.scene: expected the file of {scene!r}, which the weights were trained on and"
                f" ffpose learn writes beside them, as --data.scene runs/{scene}/scene.json; got"
                " none"
            )
    if scene is not None and scene_name(scene) not in sets:
        return images
    ranges: dict[str, Any] = {
        name: tuple(seen[name])
        for name in ("distance", "attitude_range_deg")
        if name in seen and getattr(images, name) == getattr(plain, name)
    }
    kinds = {kind: getattr(images, kind) or seen.get(kind, 0) > 0 for kind in VARIANTS}
    return replace(images, scene=scene, **kinds, **ranges)


def write_calibrated(
    weights: str | Path, images: CalibrationSet, *, out: Path | None = None
) -> Calibration:
    """Calibrate a weights file on opened images; see `calibrate_weights`."""
    path, metadata = resolve(weights), read_metadata(weights)
    model = load_network(path)
    assert isinstance(model, PolarPose)
    preprocessing = images.whole.preprocessing
    others = [] if images.strangers is None else _standardized(images.strangers, preprocessing)
    cut = () if images.cut is None else _batches(images.cut)
    hard = chain.from_iterable(map(_batches, images.hard))
    found = calibrate(model, _batches(images.whole), others, cut, hard, metadata.symmetry)
    threshold = metadata.in_view_threshold if images.strangers is None else found.in_view_threshold
    command = command_of(Path(weights).name, images.config)
    header = replace(
        metadata,
        config=with_calibration(model.config, found),
        in_view_threshold=threshold,
        calibration={"command": command, "images": images.about},
        version=__version__,
    )
    # Not mapped, as by `load_file`: `out` may be this file, and Windows replaces no mapped one.
    state = load(path.read_bytes()) | {"variance_scales": found.variance_scales}
    write_weights(path if out is None else out, state, header)
    return found


def _batches(images: PoseDataset) -> Iterable[Sample]:
    return DataLoader(images, VALIDATION_BATCH)


def _standardized(images: Bytes, preprocessing: Preprocessing) -> Iterator[Tensor]:
    """Yield images ``(N, H, W, 3)`` as standardized batches of the network's input size."""
    for part in np.split(images, range(VALIDATION_BATCH, len(images), VALIDATION_BATCH)):
        yield torch.stack([preprocessing(Image.fromarray(image)) for image in part])
