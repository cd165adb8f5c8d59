"""Measurements for a model card: weights under the conditions of their training and others.

Each condition is a set of held-out rendered scenes (`ffpose.render.variations`), whose images pass
through `ffpose.load` like any other. Where errors grow, the predicted uncertainty should grow, and
images that do not show the object should be flagged; so coverage and flag rates are reported with
the errors. Rendering needs the extra `render`.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import track

from ffpose import __version__
from ffpose._internal.files import read_json, sha256, write_text
from ffpose._internal.seeds import CHOICES, FINAL
from ffpose.config import looks_twice
from ffpose.errors import expect, require
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.card.pictures import PICTURES, draw_picture
from ffpose.evaluation.card.seen import picture_seen, seen_in_training
from ffpose.evaluation.card.statistics import Answers, folded, refuse, summarize
from ffpose.evaluation.card.tables import format_card
from ffpose.geometry import Pose
from ffpose.geometry.symmetry import SymmetryGroup
from ffpose.inference.estimator import PoseEstimator
from ffpose.inference.load import load
from ffpose.inference.source import find_source
from ffpose.models import WeightsMetadata
from ffpose.onnx.metadata import ModelMetadata
from ffpose.render import SCENES, Scene, find_scene, label
from ffpose.render.renderer import camera_of, situation
from ffpose.render.sampler import is_low
from ffpose.render.scene import ALL_ATTITUDES
from ffpose.render.variations import Variation, render_variations, variations, without_object

BATCH = 16

BASELINE_SEED, BASELINE_LABELS = 0, 1000
"""Seed and number of labels whose mean is the constant pose; the seed is one of training's."""

ONE_RENDERER = "No images of a second renderer; ffpose card --mitsuba adds them."


class Shown(NamedTuple):
    """An image that a network is evaluated on; no pose where it does not show the object."""

    condition: str
    image: Image.Image
    pose: Pose | None


@dataclass(frozen=True)
class Plan:
    """The images of a model card.

    ``with_object`` are sets with the object, the first as trained, ``without`` sets without it, and
    ``pictures`` kinds of `ffpose.evaluation.card.pictures.PICTURES`; of each, ``count`` images of
    ``size`` ``(width, height)``. ``keep`` is a folder that keeps the rendered ones.
    """

    with_object: Sequence[Variation]
    without: Sequence[Variation]
    pictures: Sequence[str]
    count: int
    size: tuple[int, int]
    seed: int
    workers: int
    keep: Path | None

    @property
    def trained(self) -> Variation:
        """Set with the conditions of training."""
        return self.with_object[0]

    @property
    def about(self) -> dict[str, str]:
        """Description of each condition, by name."""
        scenes = {v.name: v.about for v in (*self.with_object, *self.without)}
        return scenes | {name: PICTURES[name][0] for name in self.pictures}

    def show(self) -> Iterator[Shown]:
        """Yield the images; those of one condition are in order, interleaved with others."""
        scenes = (*self.with_object, *self.without)
        frames = render_variations(
            scenes, self.seed, self.count, self.size, self.workers, self.keep
        )
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
    seed: int = CHOICES.start,
    final: bool = False,
    workers: int = 1,
    second_renderer: bool = False,
    keep: Path | None = None,
    out: Path | None = None,
    progress: bool = False,
    device: str = "auto",
) -> dict[str, Any]:
    """Measure weights under each condition.

    Args:
        weights: Weights file, name of shipped weights, or exported ``.onnx`` graph.
        scene: The set of scenes, or its name; a built-in set's attitudes are widened to all.
        count: Number of images per condition.
        size: ``(width, height)`` of the images before preprocessing.
        seed: Seed of the scenes, one of `ffpose._internal.seeds.CHOICES`.
        final: Show scenes of `ffpose._internal.seeds.FINAL`, which no training has seen, instead.
        workers: Number of processes that render.
        second_renderer: Add images of Mitsuba, which takes seconds for each.
        keep: Folder that keeps the rendered images, so that an interrupted run goes on.
        out: Folder for ``card.json``, and its tables as ``card.md``; a card there that is of these
            arguments is returned.
        progress: Show progress on standard error.
        device: Of the network, as of `ffpose.load`.

    Returns:
        A JSON document. ``conditions`` have ``name``, ``about``, whether training had it (``seen``
        and ``seen_how``) and the statistics of `statistics.summarize`; ``mean_pose_baseline`` has
        those of a constant pose; ``without_object``, empty for a network without uncertainty,
        those of `statistics.refuse`; ``notes`` say what was left out.

    Raises:
        ValueError: The weights cannot be used, the set is unknown, ``seed`` is of another purpose,
            or a number is out of range.
        MissingExtraError: The extra `render`, or `mitsuba`, is not installed.
    """
    expect(count >= 1, "count", "at least 1", count)
    expect(workers >= 1, "workers", "at least 1", workers)
    choices = f"{CHOICES.start} to {CHOICES.stop - 1}, as others are not for choices"
    expect(seed in CHOICES, "seed", choices, seed)
    seed = FINAL.start if final else seed
    if second_renderer:
        require("mitsuba", "mitsuba")
    scene = find_scene(scene)
    built_in = SCENES.get(scene.name) == scene
    # What tells a set from others of its name, as JSON gives it back.
    parameters = None if built_in else json.loads(json.dumps(scene.parameters()))
    if built_in:
        scene = replace(scene, attitude_range_deg=ALL_ATTITUDES)
    identity = {
        "sha256": sha256(find_source(weights).path),
        "ffpose": __version__,
        "scene": scene.name,
        "count": count,
        "size": list(size),
        "seed": seed,
        "final": final,
        "notes": [] if second_renderer else [ONE_RENDERER],
        "scene_parameters": parameters,
    }
    if out is not None and (out / "card.json").exists():
        kept: dict[str, Any] = read_json(out / "card.json")
        if all(kept.get(name) == value for name, value in identity.items()):
            return kept
    estimator = load(weights, camera=camera_of(scene, size), device=device, warm_up=0)
    metadata = estimator.metadata
    recipe = metadata.recipe if isinstance(metadata, WeightsMetadata) else None
    plan = _plan(scene, metadata, second_renderer, count, size, seed, workers, keep)
    began = time.perf_counter()
    symmetry = metadata.symmetry
    total, screen = plan.count * len(plan.about), Console(stderr=True)
    shown = track(plan.show(), "images", total, console=screen, disable=not progress)
    answers = {name: folded(each, symmetry) for name, each in answer(estimator, shown).items()}
    document = {
        "weights": str(weights),
        **{name: value for name, value in identity.items() if value is not None},
        "distance_m": list(scene.distance_m),
        "in_view_threshold": metadata.in_view_threshold,
        "seconds": time.perf_counter() - began,
        **_results(plan, answers, metadata.in_view_threshold, seen_of(plan, recipe), symmetry),
        **({"symmetry": str(symmetry)} if len(symmetry) > 1 else {}),
    }
    if out is not None:
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "card.md", format_card(document))
        write_text(out / "card.json", text)  # the last: where it is, all is done
    return document


def _plan(
    scene: Scene,
    metadata: WeightsMetadata | ModelMetadata,
    second_renderer: bool,
    *settings: Any,
) -> Plan:
    """Plan the images for a network; only one with a second look is tested for the flag."""
    config, vary = metadata.config, partial(variations, scene, second_renderer=second_renderer)
    if not looks_twice(config):
        return Plan(vary(scene.distance_m[1]), [], [], *settings)
    return Plan(vary(config.distance_m[1]), without_object(scene), list(PICTURES), *settings)


def answer(estimator: PoseEstimator, shown: Iterable[Shown]) -> dict[str, Answers]:
    """Return the predictions for the images, by condition, in batches of `BATCH`."""
    answers: dict[str, Answers] = defaultdict(lambda: Answers([], []))
    pictures = iter(shown)
    while batch := list(islice(pictures, BATCH)):
        for picture, pose in zip(batch, estimator([p.image for p in batch]), strict=True):
            answers[picture.condition].found.append(pose)
            if picture.pose is not None:
                answers[picture.condition].truth.append(picture.pose)
    return dict(answers)


def _results(
    plan: Plan,
    answers: Mapping[str, Answers],
    threshold: float | None,
    seen: Mapping[str, dict[str, str]],
    symmetry: SymmetryGroup,
) -> dict[str, list[dict[str, Any]] | dict[str, Any]]:
    """Return the part of the document that follows from the predictions."""
    trained = answers[plan.trained.name]
    light = _by_light(plan, trained)
    groups = [(plan.trained.name, plan.trained.about, trained), *light]
    groups += [(v.name, v.about, answers[v.name]) for v in plan.with_object[1:]]
    seen = {name: seen[plan.trained.name] for name, *_ in light} | dict(seen)
    constant = Answers([_mean_pose(plan.trained.scene)] * len(trained.truth), trained.truth)
    constant = folded(constant, symmetry)
    others = {name: found.found for name, found in answers.items() if not found.truth}
    if others:
        others["all of them"] = [pose for found in others.values() for pose in found]
    about = plan.about | {"all of them": "each kind as often as the others"}
    return {
        "conditions": [
            {"name": name, "about": words, **seen[name], **summarize(group, threshold, symmetry)}
            for name, words, group in groups
        ],
        "mean_pose_baseline": summarize(constant, None, symmetry),
        "without_object": [
            {
                "name": name,
                "about": about[name],
                **seen.get(name, {}),
                **refuse(trained.found, found, threshold),
            }
            for name, found in others.items()
        ],
    }


def seen_of(plan: Plan, recipe: Mapping[str, Any] | None) -> dict[str, dict[str, str]]:
    """Return ``seen`` and ``seen_how`` of each condition by name, for a training's recipe."""
    shown, own = (*plan.with_object, *plan.without), plan.trained.scene
    found = {v.name: seen_in_training(recipe, v, own) for v in shown}
    found |= {name: picture_seen(recipe, name) for name in plan.pictures}
    return {name: {"seen": seen.answer, "seen_how": seen.how} for name, seen in found.items()}


def _by_light(plan: Plan, trained: Answers) -> list[tuple[str, str, Answers]]:
    """Split the scenes as trained into those in sunlight, also over dark ground, and in eclipse."""
    around = [situation(plan.trained.scene, plan.seed, i).around for i in range(plan.count)]
    dark = np.array([each.eclipsed for each in around])
    low = np.array([is_low(each.sun, each.nadir) for each in around])
    groups = [
        ("sunlit only", "of those as trained", ~dark),
        ("low sun only", "of the sunlit ones, those over dark ground", ~dark & low),
        ("eclipse only", "those as trained that are not sunlit", dark),
    ]
    return [(name, words, trained.of(rows)) for name, words, rows in groups if rows.any()]


def _mean_pose(scene: Scene) -> Pose:
    labels = [label(scene, BASELINE_SEED, index).vector for index in range(BASELINE_LABELS)]
    return Pose.from_vector(mean_pose(np.stack(labels)))
