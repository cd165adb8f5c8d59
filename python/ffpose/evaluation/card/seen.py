"""Which conditions of a model card the training had, from the recipes in the weights' header.

The header holds the recipe of the weights, of those that they start from, and so on. A condition
that a training had is "seen"; one that only an earlier training had, or to which its augmentation
is akin, is "partly" seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, astuple, replace
from typing import Any, Literal, NamedTuple

from ffpose.config import PRESETS, looks_twice
from ffpose.imaging.transforms import Augmentation
from ffpose.render.scene import ALL_ATTITUDES, SCENES, Scene
from ffpose.render.shading.randomization import Randomization
from ffpose.render.variations import Variation
from ffpose.training.calibration_images import RANDOMIZATION, TRUNCATED_SHARE

Recipe = Mapping[str, Any]
Answer = Literal["yes", "partly", "no", "unknown"]

BEFORE = "in a training before the last"
AS_OBJECT = f"as the object {BEFORE}"


class Seen(NamedTuple):
    """Whether training had a condition, and ``how``, for "partly".

    "unknown" is said of weights that do not know their recipe, or that of a set on disk.
    """

    answer: Answer
    how: str = ""


def trainings(recipe: Recipe | None) -> list[Recipe | None]:
    """Return the recipes of the whole chain, the last training first; None for an unknown one.

    A recipe of another program, which says nothing of these images, is unknown too.
    """
    if recipe is None or not {"data", "views"} <= recipe.keys():
        return [None]
    if recipe.get("model") not in PRESETS:
        return [None]
    init = recipe.get("init")
    return [recipe, *trainings(init["recipe"])] if init else [recipe]


def seen_in_training(recipe: Recipe | None, variation: Variation, own: Scene | None = None) -> Seen:
    """Return whether the trainings had a set of rendered scenes, with the object or without.

    ``own`` is the set that the variation is of, which none of `SCENES` may be.
    """
    sets = SCENES if own is None else {own.name: own} | SCENES
    craft, (last, *before) = variation.scene.craft, trainings(recipe)
    if last is None or craft in _crafts(last, sets):
        return _over_all(recipe, lambda each: _had(each, variation, sets))
    other = _over_all(recipe, _other_spacecraft)
    if any(each is not None and craft in _crafts(each, sets) for each in before):
        return Seen("partly", f"{other.how}, and {AS_OBJECT}" if other.how else AS_OBJECT)
    return other


def picture_seen(recipe: Recipe | None, kind: str) -> Seen:
    """Return whether the trainings had a kind of images of `PICTURES`."""

    def had(each: Recipe) -> Seen:
        if kind == "clutter" or each["views"]["empty"] == 0:
            return Seen("no")
        akin = Seen("partly", "gradients, blocks, bars and noise")
        return akin if kind == "charts" else Seen("yes")

    return _over_all(recipe, had)


def _over_all(recipe: Recipe | None, had: Callable[[Recipe], Seen]) -> Seen:
    """Return what the last training had, or else what those before it had."""
    last, *before = (Seen("unknown") if each is None else had(each) for each in trainings(recipe))
    if last.answer != "no":
        return last
    if any(each.answer == "yes" for each in before):
        return Seen("partly", BEFORE)
    return next((each for each in before if each.answer != "no"), last)


def _had(recipe: Recipe, variation: Variation, sets: Mapping[str, Scene]) -> Seen:
    """Return whether one training had a set, with all its attitudes."""
    found = _had_the_like(recipe, variation, sets)
    asked = variation.scene.attitude_range_deg
    reach = recipe["data"].get("attitude_range_deg", ALL_ATTITUDES)
    within = all(most <= had for most, had in zip(asked, reach, strict=True))
    if within or variation.empty or found.answer not in ("yes", "partly"):
        return found
    limits = f"attitudes within {', '.join(f'{angle:g}' for angle in reach)} degrees"
    return Seen("partly", f"{found.how}, {limits}" if found.how else limits)


def _had_the_like(recipe: Recipe, variation: Variation, sets: Mapping[str, Scene]) -> Seen:
    """Return whether one training had a set, of whatever attitudes."""
    data, scene = recipe["data"], variation.scene
    names = data["scene"].split("+")
    if data["kind"] != "scenes" or not sets.keys() >= set(names):
        return Seen("unknown")
    trained = [_as_trained(sets[name], recipe) for name in names]
    if variation.empty:
        return Seen("yes" if data["empty"] > 0 else "no")
    if scene.craft not in _crafts(recipe, sets) or scene.renderer != "ffpose":
        return Seen("no")
    if scene.randomization != Randomization():
        within = max(astuple(scene.randomization)) <= RANDOMIZATION
        return Seen("yes" if within and data.get("randomized", 0) > 0 else "no")
    if scene.max_visible < trained[0].min_visible:
        inside = TRUNCATED_SHARE[0] <= scene.min_visible and scene.max_visible <= TRUNCATED_SHARE[1]
        return Seen("yes" if inside and data.get("cut", 0) > 0 else "no")
    near, far = scene.distance_m
    if not any(each.distance_m[0] <= near and far <= each.distance_m[1] for each in trained):
        return Seen("no")
    views, blurred = _augmentation(recipe)
    if variation.blur_px > 0:
        return _augmented(views["blur"], blurred)
    if variation.monochrome:
        return _augmented(views.get("monochrome", 0), "a part of the images without colors")
    if scene.sensor.jpeg_quality != trained[0].sensor.jpeg_quality:
        return _augmented(views.get("jpeg", 0), "JPEG files of a part of the image")
    if scene.sensor != trained[0].sensor:
        return _augmented(views["noise"], "Gaussian noise")
    return Seen("yes")


def _augmentation(recipe: Recipe) -> tuple[Mapping[str, Any], str]:
    """Return the strengths of a training's augmentation, and how it blurs.

    That of a network that looks at the frame alone is `ffpose.imaging.transforms.Augmentation`.
    """
    if looks_twice(PRESETS[recipe["model"]]):
        return recipe["views"], "half the resolution blended in"
    data = recipe["data"]
    if not data["augment"]:
        return {"blur": 0, "noise": 0}, ""
    used = asdict(Augmentation(**data["augmentation"]))
    used["noise"] = max(used[name] for name in ("noise", "shot_noise", "read_noise"))
    return used, f"Gaussian blur of up to {used['blur']:g} pixels of the input"


def _as_trained(scene: Scene, recipe: Recipe) -> Scene:
    """Return a set with a training's distances: one's own of that name may have others now."""
    if scene.name not in SCENES:
        own = recipe.get("model_fields", {}).get("distance_m", scene.distance_m)
        scene = replace(scene, distance_m=tuple(own))
    return scene.scaled(*recipe["data"].get("distance", (1.0, 1.0)))


def _crafts(recipe: Recipe, sets: Mapping[str, Scene]) -> list[Any]:
    """Return the spacecraft of a training's rendered sets; none of a set that is not known here."""
    data = recipe["data"]
    names = data["scene"].split("+") if data["kind"] == "scenes" else []
    return [sets[name].craft for name in names if name in sets]


def _other_spacecraft(recipe: Recipe) -> Seen:
    if recipe["data"]["kind"] != "scenes":
        return Seen("unknown")
    like = recipe["data"]["decoys"] > 0
    return Seen("partly", "spacecraft of random parts") if like else Seen("no")


def _augmented(strength: float, how: str) -> Seen:
    return Seen("partly", f"augmentation: {how}") if strength > 0 else Seen("no")
