"""Inspection of a dataset before training on it.

Counts, checks of labels and images, distributions as in the paper (Ye et al., Sensors 2023, 23,
8633: translation in Figure 6, orientation in Figure 7), and a contact sheet of images with the
labeled axes, where a wrong convention is visible at once.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ffpose import arrays
from ffpose._internal.figures import new_figure, save_figure, style_axes
from ffpose._internal.files import atomic_write, write_json
from ffpose.datasets import (
    AS_ON_DISK,
    Decoding,
    PoseDataset,
    Record,
    list_splits,
    read_records,
)
from ffpose.geometry import FloatArray
from ffpose.imaging.images import decode_all
from ffpose.imaging.overlay import draw_axes, tiled
from ffpose.imaging.preprocessing import Preprocessing

SHEET_IMAGES = 16
"""Number of images on each contact sheet, spread evenly over the split."""

_TILE_WIDTH = 320
_CAPTION_HEIGHT = 22
_COLUMNS = 4
_GAP = 6
_AXIS_LENGTH = 3.0
_NORM_TOLERANCE = 1e-5
"""Tolerated deviation of a quaternion's norm from one, for labels printed with five digits."""
_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442")
"""Colors of the splits in turns, distinguishable with color blindness (Okabe and Ito)."""


_EDGES = {
    "roll": np.arange(-180.0, 181.0, 15.0),
    "pitch": np.arange(-90.0, 91.0, 7.5),
    "yaw": np.arange(-180.0, 181.0, 15.0),
}
"""Edges of the bins of angles, degrees."""


def inspect_folder(
    kind: str, root: str | Path, out: str | Path, decoding: Decoding = AS_ON_DISK
) -> dict[str, Any]:
    """Check all splits of a dataset on disk, and write a summary, histograms and contact sheets.

    Writes ``summary.json``, ``translation.png``, ``orientation.png`` and, for each labeled split,
    ``samples_{split}.png``. Every image is decoded as in training, on all cores.

    Args:
        kind: Kind of the dataset (`ffpose.datasets`).
        root: Its folder.
        out: The folder to write; created if missing.
        decoding: How images become RGB.

    Returns:
        The contents of ``summary.json``. ``splits`` holds for each labeled split ``images``,
        ``camera`` (None where there are several), ``failed`` (names of the images whose label, as
        in the file, fails each check), ``origin_in_image`` (the share of images that contain the
        object's origin; None where labels locate the camera) and ``ranges`` (minimum, median and
        maximum). Besides, ``unlabeled`` (images of each split without labels), ``shared_images``
        (files in more than one split) and ``files``.

    Raises:
        ValueError: ``kind`` is unknown, or the set has no labels at all.
        FileNotFoundError: The folder, or a file that lists a split, does not exist.
        DataError: A file is invalid, or an image is damaged or of another size than its camera's;
            nothing is written.
    """
    records = {
        split: read_records(kind, root, split, decoding) for split in list_splits(kind, root)
    }
    datasets = {
        split: PoseDataset(each, Preprocessing())
        for split, each in records.items()
        if each[0].pose is not None
    }
    if not datasets:
        raise ValueError(
            f"{root}: expected labels in a split at least, as they are what is checked and drawn,"
            f" got none in {', '.join(records)}"
        )
    for each in records.values():
        deque(decode_all(Record.decode, each), maxlen=0)  # a header reveals no truncated file
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    sheets = {f"samples_{split}.png": dataset for split, dataset in datasets.items()}
    summary = {
        "splits": {split: _summarize(dataset) for split, dataset in datasets.items()},
        "unlabeled": {split: len(each) for split, each in records.items() if split not in datasets},
        "shared_images": _shared_images(records.values()),
        "files": ["translation.png", "orientation.png", *sheets],
    }
    for name, unit, values in (
        ("translation", "m", _position),
        ("orientation", "degrees", _orientation),
    ):
        of_splits = {split: values(dataset) for split, dataset in datasets.items()}
        _write_histograms(folder / f"{name}.png", unit, of_splits)
    for name, dataset in sheets.items():
        with atomic_write(folder / name) as path:
            contact_sheet(dataset, SHEET_IMAGES).save(path)
    write_json(folder / "summary.json", summary)
    return summary


def contact_sheet(dataset: PoseDataset, count: int) -> Image.Image:
    """Return up to ``count`` images, spread evenly over a dataset, with their labeled axes."""
    indices = np.unique(np.linspace(0, len(dataset) - 1, count).round().astype(int)).tolist()
    return tiled([_tile(dataset, index) for index in indices], _COLUMNS, _GAP)


def _tile(dataset: PoseDataset, index: int) -> Image.Image:
    """Return a thumbnail of image ``index`` with its axes, and its name and distance below."""
    record = dataset.records[index]
    pose, camera = record.label, record.camera
    size = (_TILE_WIDTH, round(_TILE_WIDTH * camera.height / camera.width))
    image = dataset.load_image(index).resize(size, Image.Resampling.BILINEAR)
    tile = Image.new("RGB", (size[0], size[1] + _CAPTION_HEIGHT), "white")
    tile.paste(draw_axes(image, pose, camera, _AXIS_LENGTH))
    caption = f"{record.name}   {np.linalg.norm(dataset.poses[index, :3]):.1f} m"
    font = ImageFont.load_default(13)
    ImageDraw.Draw(tile).text((2, size[1] + 3), caption, fill="black", font=font)
    return tile


def _position(dataset: PoseDataset) -> dict[str, FloatArray]:
    """Return distances and coordinates by name, meters; a world's axes point anywhere."""
    x, y, z = dataset.poses[:, :3].T
    axes = ("x (right)", "y (down)", "z (depth)") if dataset.target == "object" else ("x", "y", "z")
    return {
        "distance": np.linalg.norm((x, y, z), axis=0),
        **dict(zip(axes, (x, y, z), strict=True)),
    }


def _orientation(dataset: PoseDataset) -> dict[str, FloatArray]:
    """Return the angles by name, degrees."""
    angles = np.asarray(arrays.quaternion_to_euler(dataset.poses[:, 3:]), np.float64)
    return dict(zip(_EDGES, angles.T, strict=True))


def _summarize(dataset: PoseDataset) -> dict[str, Any]:
    """Return the statistics and checks of one split."""
    poses, camera, records = dataset.poses, dataset.camera, dataset.records
    # As in the files: those of a `Pose` are already normalized.
    stated = [each.raw_quaternion for each in records]
    raw = np.array([pose[3:] if q is None else q for pose, q in zip(poses, stated, strict=True)])
    locates_object = dataset.target == "object"
    quantities = (("m", _position(dataset)), ("degrees", _orientation(dataset)))
    failures = {
        "unit_quaternion": np.abs(np.linalg.norm(raw, axis=1) - 1) > _NORM_TOLERANCE,
        "scalar_not_negative": raw[:, 0] < 0,
    }
    if locates_object:
        failures["in_front_of_camera"] = poses[:, 2] <= 0
    return {
        "images": len(dataset),
        "camera": None if camera is None else asdict(camera),
        "failed": {
            check: [dataset.names[index] for index in np.nonzero(failed)[0]]
            for check, failed in failures.items()
        },
        "origin_in_image": _origin_share(dataset) if locates_object else None,
        "ranges": {
            name: {
                "unit": unit,
                "least": float(column.min()),
                "median": float(np.median(column)),
                "greatest": float(column.max()),
            }
            for unit, values in quantities
            for name, column in values.items()
        },
    }


def _origin_share(dataset: PoseDataset) -> float:
    """Return the share of images that contain the object's origin."""
    inside = []
    for record in dataset.records:
        u, v = record.label.project(np.zeros(3), record.camera)
        inside.append(0 <= u <= record.camera.width and 0 <= v <= record.camera.height)
    return float(np.mean(inside))


def _shared_images(splits: Iterable[Sequence[Record]]) -> list[str]:
    """Return the images in more than one split, which would bias an evaluation."""
    there = [record for records in splits for record in records]
    names = {record.image: record.name for record in there}
    counts = Counter(record.image for record in there)
    return sorted(names[image] for image, count in counts.items() if count > 1)


def _write_histograms(path: Path, unit: str, splits: Mapping[str, dict[str, FloatArray]]) -> None:
    """Draw a histogram of each quantity with the splits stacked."""
    names = next(iter(splits.values()))
    figure = new_figure(3.4 * len(names), 3.2)
    for name, axes in zip(names, figure.subplots(1, len(names)), strict=True):
        edges = _EDGES.get(name)
        axes.hist(
            [values[name] for values in splits.values()],
            bins=24 if edges is None else edges,
            stacked=True,
            label=[f"{split} ({len(values[name])})" for split, values in splits.items()],
            color=list(islice(cycle(_COLORS), len(splits))),
        )
        if edges is not None:
            axes.set_xticks(edges[::4])
        axes.set_xlabel(f"{name} [{unit}]")
        style_axes(axes, grid=None)
    figure.axes[0].set_ylabel("images")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    columns = min(len(labels), len(_COLORS))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)
    save_figure(figure, path, dpi=150)
