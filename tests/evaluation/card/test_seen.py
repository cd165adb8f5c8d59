"""What training had of a card's conditions, told from the recipes of the whole chain."""

from dataclasses import replace

import pytest

from ffpose.evaluation.card.seen import (
    AS_OBJECT,
    BEFORE,
    Seen,
    picture_seen,
    seen_in_training,
    trainings,
)
from ffpose.models import read_metadata
from ffpose.render import SCENES
from ffpose.render.variations import variations, without_object
from ffpose.training import DataConfig, TrainConfig
from ffpose.training.provenance import recipe

PLAIN = {"scene": "soyuz_hard", "empty": 1, "decoys": 1}


def recipe_of(tmp_path, init=None, model="polar", **data):
    config = TrainConfig(DataConfig("scenes", tmp_path, **(PLAIN | data)), tmp_path, model)
    return recipe(config, None if init is None else {"sha256": "", "recipe": init, "data": None})


def conditions(recipe, scene="soyuz_hard", farthest=42.0):
    chosen = variations(SCENES[scene], farthest, second_renderer=True)
    chosen += without_object(SCENES[scene])
    return {v.name: seen_in_training(recipe, v) for v in chosen}


def test_plain_scenes_are_seen_as_trained_and_by_augmentation(tmp_path):
    found = conditions(recipe_of(tmp_path))
    assert {name: seen.answer for name, seen in found.items()} == {
        "as trained": "yes",
        "noise doubled": "partly",
        "blur": "partly",
        "monochrome": "no",
        "JPEG 50": "no",
        "randomize 0.5": "no",
        "cut by the border": "no",
        "beyond range": "no",
        "second renderer": "no",
        "empty scenes": "yes",
        "another spacecraft": "partly",
    }
    assert found["noise doubled"].how == "augmentation: Gaussian noise"


def test_a_network_of_the_frame_alone_saw_the_augmentation_of_frames(tmp_path):
    frames = {"model": "small", "augmentation": {"blur": 0.7, "noise": 0.0, "read_noise": 0.01}}
    found = conditions(recipe_of(tmp_path, **frames))
    assert found["blur"].how == "augmentation: Gaussian blur of up to 0.7 pixels of the input"
    assert found["noise doubled"] == Seen("partly", "augmentation: Gaussian noise")
    assert found["monochrome"] == Seen("no")
    never = conditions(recipe_of(tmp_path, model="small", augment=False))
    assert never["blur"] == never["noise doubled"] == Seen("no")
    clean = {"augmentation": {"blur": 0.0, "noise": 0.0}}
    assert conditions(recipe_of(tmp_path, model="small", **clean))["noise doubled"] == Seen("no")


def test_scenes_of_ones_own_have_the_distances_of_the_training(tmp_path):
    """Those of a second `ffpose learn` with the same mesh may be others."""
    scene = replace(SCENES["soyuz_hard"], name="own", distance_m=(8.0, 100.0))
    learned = recipe_of(tmp_path, scene="own") | {"model_fields": {"distance_m": [8.0, 42.0]}}
    for far, answer in ((42.0, "yes"), (100.0, "no")):
        shown = replace(scene, distance_m=(8.0, far))
        (plain, *_) = variations(shown, far, second_renderer=False)
        assert seen_in_training(learned, plain, scene).answer == answer


def test_attitudes_beyond_those_of_the_training_are_not_seen(tmp_path):
    fields = {"attitude_range_deg": (180.0, 20.0, 30.0), "cut": 900, "randomized": 900}
    found = conditions(recipe_of(tmp_path, **fields))
    limits = "attitudes within 180, 20, 30 degrees"
    for name in ("as trained", "cut by the border", "randomize 0.5"):
        assert found[name] == Seen("partly", limits)
    assert found["noise doubled"] == Seen("partly", f"augmentation: Gaussian noise, {limits}")
    assert found["empty scenes"].answer == "yes"
    assert found["beyond range"].answer == "no"


@pytest.mark.parametrize(
    ("field", "name"), [("cut", "cut by the border"), ("randomized", "randomize 0.5")]
)
def test_what_only_an_earlier_training_had_is_partly_seen(tmp_path, field, name):
    robust = recipe_of(tmp_path, **{field: 900})
    assert conditions(robust)[name] == Seen("yes")
    after = recipe_of(tmp_path, recipe_of(tmp_path, robust))
    assert conditions(after)[name] == Seen("partly", BEFORE)
    assert trainings(after)[-1] == robust


def test_a_set_of_nearer_scenes_has_not_the_farther_ones(tmp_path):
    near = recipe_of(tmp_path, scene="soyuz_easy")
    assert conditions(near)["as trained"] == Seen("no")
    assert conditions(near, "soyuz_easy")["as trained"] == Seen("yes")
    both = recipe_of(tmp_path, scene="soyuz_easy+soyuz_hard")
    assert conditions(both, "soyuz_easy", 22.0)["beyond range"] == Seen("yes")
    assert conditions(both, "dragon_hard")["as trained"].answer == "partly"


def test_another_spacecraft_may_have_been_the_object_of_an_earlier_training(tmp_path):
    for decoys, how in ((1, f"spacecraft of random parts, and {AS_OBJECT}"), (0, AS_OBJECT)):
        soyuz = recipe_of(tmp_path, decoys=decoys)
        dragon = recipe_of(tmp_path, soyuz, scene="dragon_hard", decoys=decoys)
        found = conditions(dragon, "dragon_hard")
        assert found["another spacecraft"] == Seen("partly", how)
        assert found["as trained"] == Seen("yes")
    again = recipe_of(tmp_path, dragon)
    assert conditions(again)["another spacecraft"].how.endswith(AS_OBJECT)


def test_weights_that_do_not_know_their_recipe_do_not_know_what_they_saw(tmp_path):
    assert {seen.answer for seen in conditions(None).values()} == {"unknown"}
    assert picture_seen(None, "noise") == Seen("unknown")
    on_disk = recipe(TrainConfig(DataConfig("urso", tmp_path), tmp_path), None)
    assert {seen.answer for seen in conditions(on_disk).values()} == {"unknown"}
    chain = recipe_of(tmp_path) | {"init": {"sha256": "", "recipe": None, "data": None}}
    assert conditions(chain)["as trained"] == Seen("yes")
    assert conditions(chain)["JPEG 50"] == Seen("unknown")


def test_a_recipe_of_another_program_says_nothing():
    timm = {"data": {}, "views": {}, "model": "resnet50", "init": "imagenet"}
    for foreign in ({"optimizer": "sgd"}, {"init": {"recipe": None}}, timm):
        assert {seen.answer for seen in conditions(foreign).values()} == {"unknown"}
        assert picture_seen(foreign, "noise") == Seen("unknown")


def test_pictures_are_seen_where_samples_without_the_object_are(tmp_path):
    known = recipe_of(tmp_path)
    assert picture_seen(known, "noise") == Seen("yes")
    assert picture_seen(known, "charts").answer == "partly"
    assert picture_seen(known, "clutter") == Seen("no")
    never = known | {"views": known["views"] | {"empty": 0.0}}
    assert picture_seen(never, "noise") == Seen("no")


def test_the_shipped_weights_saw_the_hard_scenes_of_their_sets():
    for weights, sets in {
        "soyuz": ("soyuz_easy", "soyuz_hard"),
        "dragon": ("dragon_hard",),
    }.items():
        recipe = read_metadata(weights).recipe
        for scene in sets:
            found = conditions(recipe, scene)
            for name in ("as trained", "cut by the border", "randomize 0.5", "empty scenes"):
                assert found[name] == Seen("yes")
