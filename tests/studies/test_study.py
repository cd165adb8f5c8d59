from dataclasses import fields
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path
from typing import get_args

import pytest

from ffpose._internal.choices import PolarMixer
from ffpose.models import build_network
from ffpose.training import DataConfig, TrainConfig
from studies import STUDIES, Study, Variant
from studies.run import network
from studies.study import changed

BASE = TrainConfig(DataConfig("urso", Path("a")), Path("b"), model_fields={"depth": 2})

VARIANTS = [(study, variant) for study in STUDIES.values() for variant in study.variants]
IDS = [f"{study.name}-{variant.name}" for study, variant in VARIANTS]


def test_mixers_are_compared_by_the_pose_of_one_look():
    study = STUDIES["mixers"]
    configs = [network(study.config(variant)) for variant in study.variants]
    assert {config.looks for config in configs} == {1}
    assert {config.mixer for config in configs} == set(get_args(PolarMixer))


def test_a_change_reaches_into_the_parts_and_leaves_the_rest():
    new = changed(
        BASE,
        {
            "epochs": 3,
            "data": {"root": "elsewhere", "attitude_range_deg": [1.0, 2.0, 3.0]},
            "model_fields": {"dim": 8},
            "views": {"noise": 0.0},
        },
    )
    assert (new.epochs, new.data.root, new.views.noise) == (3, Path("elsewhere"), 0.0)
    assert new.data.attitude_range_deg == (1.0, 2.0, 3.0)
    assert new.model_fields == {"depth": 2, "dim": 8}
    same = {field.name for field in fields(TrainConfig)} - {"epochs", "data", "model_fields"}
    same -= {"views"}
    assert all(getattr(new, name) == getattr(BASE, name) for name in same)
    assert new.data.kind == "urso"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"epoch": 3}, r"one of {data, .*}, got 'epoch' \(did you mean epochs\?\)"),
        ({"data": {"cuont": 3}}, r"one of data.{kind, .*}, got 'cuont' \(did you mean count\?\)"),
        ({"data": 3}, "data: expected a mapping of fields, got 3"),
        ({"views": {"noise": 3}}, "noise: expected a number from 0 to 1, got 3"),
    ],
)
def test_what_cannot_be_changed_is_refused(changes, text):
    with pytest.raises(ValueError, match=text):
        changed(BASE, changes)


def test_an_unknown_variant_is_told_the_names():
    with pytest.raises(ValueError, match=r"expected one of filter, .*filterformer, got 'fil'"):
        STUDIES["mixers"].choose(["fil"])


def test_variants_have_names_of_their_own():
    with pytest.raises(ValueError, match="expected distinct names, got a, a"):
        Study("s", "", BASE, (Variant("a", ""), Variant("a", "")))


def test_variants_come_in_the_order_of_the_study():
    chosen = STUDIES["mixers"].choose(["attention", "filter"])
    assert [variant.name for variant in chosen] == ["filter", "attention"]


@pytest.mark.parametrize(("study", "variant"), VARIANTS, ids=IDS)
def test_every_variant_is_a_network_that_can_be(study, variant):
    network(study.config(variant))


@pytest.mark.parametrize("name", ["mixers", "networks"])
def test_the_learning_rate_of_a_study_by_seconds_stays(name):
    study = STUDIES[name]
    for variant in study.variants:
        optimizer = study.config(variant).optimizer
        assert optimizer.schedule == "step"
        assert optimizer.step_epochs >= 100_000


def test_table_2_is_the_papers():
    """Sensors 2023, 23, 8633, Table 2; N = 7 is the network of Tables 3 and 4."""
    study = STUDIES["table2"]
    depths = [study.config(variant).model_fields["depth"] for variant in study.variants]
    assert depths == [3, 4, 5, 6, 7, 8, 9]
    assert study.variants[4].paper == (0.7541, 5.2023, 74.73)
    with_filter = next(v for v in STUDIES["table3"].variants if v.name == "soyuz_hard-tokens")
    assert with_filter.paper[:2] == study.variants[4].paper[:2]


def test_table_3_changes_scene_and_filter():
    study = STUDIES["table3"]
    pairs = [
        (config.data.scene, config.model_fields["filter"])
        for config in map(study.config, study.variants)
    ]
    scenes = ("soyuz_easy", "soyuz_hard", "dragon_hard")
    assert pairs == [(scene, filter) for scene in scenes for filter in ("tokens", "none")]


@pytest.mark.parametrize("variant", STUDIES["networks"].variants, ids=lambda v: v.name)
def test_every_network_of_the_networks_study_is_built_and_sees_the_same(variant):
    study = STUDIES["networks"]
    config = study.config(variant)
    built = build_network(network(config), backbone_weights="none").config
    assert (built.image_size, built.backbone) == ((96, 128), "compact_resnet_narrow")
    base = study.base
    assert (config.data, config.epochs, config.batch_size, config.optimizer) == (
        *(base.data, base.epochs, base.batch_size, base.optimizer),
    )


def test_table_4_compares_on_images_of_one_size():
    """Sensors 2023, 23, 8633, Table 4; its second column for FilterformerPose is Table 3's."""
    study = STUDIES["table4"]
    assert len(study.variants) == 6
    assert {network(study.config(variant)).image_size for variant in study.variants} == {(224, 224)}
    papers = {variant.name: variant.paper[:2] for variant in study.variants}
    assert papers["dragon_hard-ursonet"] == (0.8909, 13.9480)
    assert papers["dragon_hard-filterformer"] == (0.8160, 5.5256)


def test_the_note_of_table_5_is_by_hand():
    """Translations of the four scenes as printed: CGA-PoseNet, MS-Trans, PoseNet; rotations."""
    notes = STUDIES["table5"].notes
    for row, unit in (
        ((1.36, 2.52, 0.74, 2.12), " m"),
        ((0.83, 1.81, 0.86, 1.62), " m"),
        ((1.92, 2.31, 1.46, 2.56), " m"),
        ((3.65, 4.29, 7.44, 6.68), "°"),  # LSTM-PN
    ):
        mean = sum(Decimal(str(number)) for number in row) / 4
        assert f"{mean.quantize(Decimal('0.01'), ROUND_HALF_UP)}{unit}" in notes


def test_table_5_has_a_network_a_scene():
    study = STUDIES["table5"]
    assert study.medians
    scenes = [study.config(variant).data.scene for variant in study.variants]
    assert len(set(scenes)) == 4
    assert {study.config(variant).data.kind for variant in study.variants} == {"cambridge"}
