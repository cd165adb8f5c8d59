"""The measurements of a model card: weights under the conditions of their training, and others.

Each condition is a set of rendered scenes that no training sees (`ffpose.render.variations`), and
goes the way of any image (`ffpose.predictor.Predictor`). Where the errors grow, the uncertainty
should say so, and pictures that do not show the object should be flagged: the coverage of the
regions and the rates of the flag stand beside the errors. Rendering needs the extra `render`.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from PIL import Image

from ffpose import __version__
from ffpose.baseline import mean_pose
from ffpose.card_figures import Answers, refuse, summarize
from ffpose.card_tables import format_card
from ffpose.errors import require
from ffpose.evaluation import choose_preprocessing
from ffpose.files import atomic_write, sha256
from ffpose.geometry import Pose
from ffpose.models import FilterformerPose, WeightsMetadata, read_metadata
from ffpose.models.zoo import resolve
from ffpose.pictures import PICTURES, draw_picture
from ffpose.predictor import Predictor
from ffpose.training.config import TEST_SEEDS

if TYPE_CHECKING:
    from ffpose.render import Scene
    from ffpose.render.variations import Variation

BATCH = 16

BASELINE_SEED, BASELINE_LABELS = 0, 1000
"""The constant answer is the mean pose of so many labels, of a seed that trainings use."""

SECOND_RENDERER = (
    "No pictures of a second renderer: Mitsuba checks silhouettes, depths and shadows "
    "(tests/render/test_second_renderer.py), but does not make pictures of the materials."
)


class Shown(NamedTuple):
    """A picture that a network is shown.

    Attributes:
        condition: Name of what it is of.
        image: RGB.
        pose: The true pose; None where the object is not there.
    """

    condition: str
    image: Image.Image
    pose: Pose | None


@dataclass(frozen=True)
class Plan:
    """Which pictures are made.

    Attributes:
        with_object: Sets with the object, the first as trained.
        without: Sets without it.
        pictures: Names of kinds of pictures that are no scene, of `ffpose.pictures.PICTURES`.
        count: Pictures of each.
        size: ``(width, height)`` of the pictures.
        seed: Of all.
        workers: Processes that render.
    """

    with_object: Sequence[Variation]
    without: Sequence[Variation]
    pictures: Sequence[str]
    count: int
    size: tuple[int, int]
    seed: int
    workers: int

    @property
    def trained(self) -> Variation:
        """The set as trained."""
        return self.with_object[0]

    @property
    def about(self) -> dict[str, str]:
        """What each condition is, by its name."""
        scenes = {v.name: v.about for v in (*self.with_object, *self.without)}
        return scenes | {name: PICTURES[name][0] for name in self.pictures}

    def show(self) -> Iterator[Shown]:
        """Make the pictures; those of a condition come in order, between those of others."""
        from ffpose.render.variations import render_variations

        scenes = (*self.with_object, *self.without)
        frames = render_variations(scenes, self.seed, self.count, self.size, self.workers)
        for variation, frame in frames:
            pose = frame.pose if variation in self.with_object else None
            yield Shown(variation.name, Image.fromarray(frame.image), pose)
        for name in self.pictures:
            for index in range(self.count):
                yield Shown(name, draw_picture(name, self.seed, index, self.size), None)


def measure(
    weights: str | Path,
    scene: str | Scene,
    *,
    count: int = 500,
    size: tuple[int, int] = (640, 480),
    seed: int = TEST_SEEDS,
    workers: int = 1,
    progress: bool = False,
) -> dict[str, Any]:
    """Measure weights under each condition.

    Args:
        weights: The file, or the name of weights that come with the package.
        scene: The set of scenes, or its name; its attitudes are widened to all.
        count: Pictures of each condition.
        size: ``(width, height)`` of the pictures; preprocessing makes them the network's input.
        seed: Of the scenes, at least `ffpose.training.config.TEST_SEEDS`: none that training sees.
        workers: Processes that render, beside this one if there are several.
        progress: Show on standard error how far it is.

    Returns:
        A document that JSON can hold. ``conditions``: a list, each with ``name``, ``about`` and the
        figures of `ffpose.card_figures.summarize`. ``mean_pose_baseline``: the same of a constant
        pose on the scenes as trained. ``without_object``: a list of `ffpose.card_figures.refuse`,
        empty for a network that gives no uncertainty. ``notes``: what was left out.

    Raises:
        FileNotFoundError: There are no such weights.
        ValueError: The weights cannot be used, the set is unknown, training may have seen the seed,
            or a number is absurd.
        MissingExtraError: The extra `render` is not installed.
    """
    _check_numbers(count, seed, workers)
    scene = require("ffpose.render", "render").get_scene(scene) if isinstance(scene, str) else scene
    camera = require("ffpose.render.renderer", "render").camera_of(scene, size)
    metadata = read_metadata(weights)
    plan = _plan(scene, metadata, count, size, seed, workers)
    preprocessing = choose_preprocessing(metadata, camera, any_camera=True)
    predictor = Predictor(FilterformerPose.from_pretrained(weights), preprocessing)
    began = time.perf_counter()
    answers = answer(predictor, _with_bar(plan, show=progress))
    return {
        "weights": str(weights),
        "sha256": sha256(resolve(weights)),
        "ffpose": __version__,
        "scene": scene.name,
        "distance_m": list(scene.distance_m),
        "count": count,
        "size": list(size),
        "seed": seed,
        "in_view_threshold": metadata.in_view_threshold,
        "seconds": time.perf_counter() - began,
        **_results(plan, answers, metadata.in_view_threshold),
        "notes": [SECOND_RENDERER],
    }


def _check_numbers(count: int, seed: int, workers: int) -> None:
    for name, value, least in (("count", count, 1), ("workers", workers, 1)):
        if value < least:
            raise ValueError(f"{name}: expected at least {least}, got {value}")
    if seed < TEST_SEEDS:
        raise ValueError(
            f"seed: expected at least {TEST_SEEDS}, the rest is training's; got {seed}"
        )


def _plan(
    scene: Scene,
    metadata: WeightsMetadata,
    count: int,
    size: tuple[int, int],
    seed: int,
    workers: int,
) -> Plan:
    """Return what such a network is shown; only one with a second look tells what is in view."""
    from ffpose.render.variations import variations, without_object

    config = metadata.config
    if config.orientation_view == "frame":
        with_object = variations(scene, scene.distance_m[1])
        return Plan(with_object, [], [], count, size, seed, workers)
    with_object, without = variations(scene, config.distance_m[1]), without_object(scene)
    return Plan(with_object, without, list(PICTURES), count, size, seed, workers)


def _with_bar(plan: Plan, *, show: bool) -> Iterable[Shown]:
    if not show:
        return plan.show()
    progress, console = require("rich.progress", "pose"), require("rich.console", "pose")
    total = plan.count * len(plan.about)
    screen = console.Console(stderr=True)
    bar: Iterable[Shown] = progress.track(plan.show(), "pictures", total, console=screen)
    return bar


def answer(predictor: Predictor, shown: Iterable[Shown]) -> dict[str, Answers]:
    """Return what a network says of pictures, by condition; it sees `BATCH` at once."""
    answers: dict[str, Answers] = defaultdict(lambda: Answers([], []))
    pictures = iter(shown)
    while batch := list(islice(pictures, BATCH)):
        for picture, pose in zip(batch, predictor.batch([p.image for p in batch]), strict=True):
            answers[picture.condition].found.append(pose)
            if picture.pose is not None:
                answers[picture.condition].truth.append(picture.pose)
    return dict(answers)


def _results(
    plan: Plan, answers: Mapping[str, Answers], threshold: float | None
) -> dict[str, list[dict[str, Any]] | dict[str, Any]]:
    """Return the part of the document that the answers give."""
    trained = answers[plan.trained.name]
    groups = [(plan.trained.name, plan.trained.about, trained), *_by_light(plan, trained)]
    groups += [(v.name, v.about, answers[v.name]) for v in plan.with_object[1:]]
    constant = Answers(trained.truth, [_mean_pose(plan.trained.scene)] * len(trained.truth))
    others = {name: found.found for name, found in answers.items() if not found.truth}
    if others:
        others["all of them"] = [pose for found in others.values() for pose in found]
    about = plan.about | {"all of them": "each kind as often as the others"}
    return {
        "conditions": [
            {"name": name, "about": words, **summarize(group, threshold)}
            for name, words, group in groups
        ],
        "mean_pose_baseline": summarize(constant, None),
        "without_object": [
            {"name": name, "about": about[name], **refuse(trained.found, found, threshold)}
            for name, found in others.items()
        ],
    }


def _by_light(plan: Plan, trained: Answers) -> list[tuple[str, str, Answers]]:
    """Return those of the scenes as trained that were taken in sunlight, and in eclipse."""
    from ffpose.render.conditions import conditions_of

    dark = np.array(
        [conditions_of(plan.trained.scene, plan.seed, i).eclipsed for i in range(plan.count)]
    )
    groups = [("sunlit only", "of those as trained", ~dark), ("eclipse only", "the others", dark)]
    return [(name, words, trained.of(rows)) for name, words, rows in groups if rows.any()]


def _mean_pose(scene: Scene) -> Pose:
    from ffpose.render import label

    labels = [label(scene, BASELINE_SEED, index).vector for index in range(BASELINE_LABELS)]
    return Pose.from_vector(mean_pose(np.stack(labels)))


def write_card(document: Mapping[str, Any], out: Path) -> None:
    """Write ``card.json`` and its tables, ``card.md``, to a folder, which is made if need be."""
    out.mkdir(parents=True, exist_ok=True)
    with atomic_write(out / "card.json") as path:
        path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n")
    with atomic_write(out / "card.md") as path:
        path.write_text(format_card(document), encoding="utf-8")
