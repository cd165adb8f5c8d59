"""The images that calibrate weights: such as training sees, and some without the object."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from ffpose._internal.seeds import CALIBRATION, matching
from ffpose.datasets import Decoding, PoseDataset, read_records
from ffpose.datasets.records import expect_in_front
from ffpose.datasets.scenes import open_frames, open_strangers
from ffpose.imaging.patches import Bytes
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.render import Scene, find_scene
from ffpose.training.config import CalibrationImages

EMPTY_SEEDS, RANDOMIZED_SEEDS, TRUNCATED_SEEDS, DUSK_SEEDS = 500_000, 400_000, 300_000, 200_000
"""Added, among the seeds of one purpose, to a set's seed: no two kinds of images show one scene."""

TRUNCATED_SHARE = (0.25, 0.9)
"""Least and greatest visible share of a truncated spacecraft in training images."""

CALIBRATED_SHARE = (0.3, 0.6)
"""The same in calibration images; with more in view, errors depend little on truncation."""

RANDOMIZATION = 0.7
"""Strength of the randomized images, as `ffpose render --randomize` has it."""


SHOWN = {
    "whole": "object",
    "cut": "object that the border cuts",
    "randomized": "object in randomized scenes",
    "dusk": "object under a low sun",
}
"""What images of each kind show, in the header of weights."""


def varied(
    scene: Scene, visible: tuple[float, float] = TRUNCATED_SHARE
) -> dict[str, tuple[Scene, int]]:
    """Return a set as it is and its variants, each with what is added to the set's seed.

    Of those that the border cuts it leaves a share within ``visible``.
    """
    return {
        "whole": (scene, 0),
        "cut": (scene.truncated(*visible), TRUNCATED_SEEDS),
        "randomized": (scene.randomized(RANDOMIZATION), RANDOMIZED_SEEDS),
        "dusk": (scene.at_dusk(), DUSK_SEEDS),
    }


class CalibrationSet(NamedTuple):
    """Images that calibrate weights, with a document for each kind for the header (``about``).

    ``whole`` images of the object; if asked for, those that the border cuts (``cut``), and ``hard``
    ones, of randomized scenes and under a low sun; and whole images ``(N, H, W, 3)``, uint8, of
    other spacecraft, which of all without the object are the likest, for the threshold that flags;
    None where there are none.
    """

    config: CalibrationImages
    about: list[dict[str, Any]]
    whole: PoseDataset
    cut: PoseDataset | None = None
    hard: tuple[PoseDataset, ...] = ()
    strangers: Bytes | None = None


def open_calibration(config: CalibrationImages, preprocessing: Preprocessing) -> CalibrationSet:
    """Open the images, of the network's input size; scenes are rendered if they are not there.

    Raises:
        ValueError: An unknown set, kind or split, or no image at the places that are asked for.
        ffpose.DataError: An image or a label cannot be used.
    """
    if config.kind == "scenes":
        return _rendered(config, preprocessing)
    decoding = Decoding(config.undistort, config.white)
    records = read_records(config.kind, config.root, config.split, decoding)
    chosen = records[config.start :: config.step]
    if not chosen:
        raise ValueError(
            f"calibration: expected more than {config.start} images in {config.split}, got"
            f" {len(records)}"
        )
    about = {
        "shows": "object",
        "kind": config.kind,
        "name": config.root.resolve().name,
        "split": config.split,
        "start": config.start,
        "step": config.step,
        "count": len(chosen),
    }
    expect_in_front(chosen)
    return CalibrationSet(config, [about], PoseDataset(chosen, preprocessing))


def _rendered(config: CalibrationImages, preprocessing: Preprocessing) -> CalibrationSet:
    if config.scene is None:
        raise ValueError("data.scene: expected the name of a rendered set, got none")
    scene = find_scene(config.scene, config.attitude_range_deg).scaled(*config.distance)
    asked = (config.count, preprocessing)
    images, seeds = dict[str, PoseDataset](), dict[str, int]()
    for kind, (part, more) in varied(scene, CALIBRATED_SHARE).items():
        if kind == "whole" or getattr(config, kind):
            seeds[SHOWN[kind]] = seed = matching(CALIBRATION, config.seed + more)
            images[kind] = open_frames(config.root, part, seed, *asked, workers=config.workers)
    whole, cut = images.pop("whole"), images.pop("cut", None)
    seeds["another spacecraft"] = seed = matching(CALIBRATION, config.seed + EMPTY_SEEDS)
    strangers = open_strangers(config.root, scene, seed, *asked, workers=config.workers)
    about = [
        {"shows": what, "scene": scene.name, "seed": seed, "count": config.count}
        for what, seed in seeds.items()
    ]
    return CalibrationSet(config, about, whole, cut, tuple(images.values()), strangers)


def command_of(weights: str, config: CalibrationImages) -> str:
    """Return the command that calibrates weights with these images.

    The name of a set's folder or file stands for its path, which is this machine's.
    """
    words = ["ffpose calibrate", weights]
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name == "root":
            if config.kind != "scenes":
                words.append(f"--data.root {config.root.resolve().name}")
        elif field.name != "workers" and value != field.default:
            shown = ",".join(map(str, value)) if isinstance(value, tuple) else value
            if field.name == "scene":
                shown = Path(value).name
            option = f"--data.{field.name.replace('_', '-')}"
            words.append(option if value is True else f"{option} {shown}")
    return " ".join(words)
