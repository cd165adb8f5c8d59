"""The whole of a model card, at the smallest size, and the tables that it prints."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from beacons import beacon_scene
from ffpose._internal.seeds import CHOICES, FINAL
from ffpose._internal.zoo import GRAPH, WEIGHTS, resolve
from ffpose.cli import main
from ffpose.errors import MissingExtraError
from ffpose.evaluation.card import measurement
from ffpose.evaluation.card.measurement import Shown, answer, measure
from ffpose.evaluation.card.statistics import Answers
from ffpose.evaluation.card.tables import format_card
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.models import build_network
from ffpose.render import find_scene
from ffpose.render.dataset.tables import conditions_of
from ffpose.render.renderer import situation
from ffpose.render.variations import variations

COUNT = 5
FRAME_FIELDS = {"image_size": (64, 64), "depth": 1, "dim": 16, "heads": 2}
LOOK_FIELDS = {
    "image_size": (48, 64),
    "camera": (32.0, 32.0, 32.0, 24.0),
    "first_stride": 4,
    "object_size": (16, 48),
    "directions": 50,
    "latent": 16,
    "distance_m": (8.0, 22.0),
}


def save(path, name, threshold=None, **fields):
    torch.manual_seed(0)
    model = build_network(name, backbone_weights="none", **fields)
    model.save_pretrained(path, in_view_threshold=threshold)
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save(tmp_path_factory.mktemp("card") / "look.safetensors", "polar", 0.5, **LOOK_FIELDS)


@pytest.fixture(scope="module")
def document(weights):
    return measure(weights, beacon_scene(), count=COUNT, size=(64, 48))


@pytest.mark.slow
def test_a_graph_has_the_card_of_its_weights():
    pytest.importorskip("onnxruntime")
    scene = find_scene("soyuz_easy")
    of_weights, of_graph = (
        measure(resolve("soyuz", suffix), scene, count=2, size=(320, 240))
        for suffix in (WEIGHTS, GRAPH)
    )
    for got, expected in zip(of_graph["conditions"], of_weights["conditions"], strict=True):
        assert got["name"] == expected["name"]
        assert got["median_translation_error_m"] == pytest.approx(
            expected["median_translation_error_m"], rel=1e-3
        )


def test_each_condition_is_measured_once_and_sunlight_and_eclipse_share_those_as_trained(document):
    rows = {row["name"]: row for row in document["conditions"]}
    light = {"sunlit only", "eclipse only"} & set(rows)
    assert sum(rows.pop(name)["images"] for name in light) == COUNT
    rows.pop("low sun only", None)
    assert list(rows) == [v.name for v in variations(beacon_scene(), 22.0)]
    assert {row["images"] for row in rows.values()} == {COUNT}
    assert rows["beyond range"]["about"] == "22 to 28.6 m"  # the weights' distances, not the set's


def test_sunlight_and_eclipse_are_told_apart(document):
    scene = variations(beacon_scene(), 22.0)[0].scene
    dark = sum(conditions_of(scene, document["seed"], index).eclipsed for index in range(COUNT))
    rows = {row["name"]: row["images"] for row in document["conditions"]}
    assert rows.get("eclipse only", 0) == dark
    around = [situation(scene, document["seed"], index).around for index in range(COUNT)]
    heights = np.degrees([np.arcsin(-a.sun @ a.nadir) for a in around if not a.eclipsed])
    assert rows.get("low sun only", 0) == (heights <= 3).sum()


def test_pictures_without_the_object_are_judged_by_the_threshold(document):
    rows = {row["name"]: row for row in document["without_object"]}
    kinds = ["empty scenes", "another spacecraft", "charts", "noise", "clutter"]
    assert list(rows) == [*kinds, "all of them"]
    assert rows["all of them"]["images"] == len(kinds) * COUNT
    missed = [rows[kind]["miss_rate"] for kind in kinds]
    assert rows["all of them"]["miss_rate"] == pytest.approx(np.mean(missed))
    flagged = document["conditions"][0]["flagged"]
    assert {row["false_alarm_rate"] for row in rows.values()} == {flagged}


def test_the_constant_pose_knows_no_uncertainty_and_no_attitude(document):
    baseline = document["mean_pose_baseline"]
    assert baseline["images"] == COUNT
    assert "rotation" not in baseline
    assert baseline["median_rotation_error_deg"] > 45  # over many attitudes


def test_the_tables_show_the_figures_in_their_columns(document):
    text = format_card(document)
    tables = [part.splitlines() for part in text.split("\n\n") if part.startswith("|")]
    assert len(tables) == 3
    for lines in tables:
        assert len({line.count("|") for line in lines}) == 1
    errors, uncertainty, refusal = (
        {line.split("|")[1].strip(): [c.strip() for c in line.split("|")[1:-1]] for line in lines}
        for lines in tables
    )
    row = next(row for row in document["conditions"] if row["name"] == "blur")
    cells = dict(zip(errors["condition"], errors["blur"], strict=True))
    assert cells["out-of-plane"] == f"{row['median_out_of_plane_error_deg']:.2f}°"
    assert cells["E_t/‖t‖"] == f"{100 * row['median_relative_translation_error']:.1f} %"
    cells = dict(zip(uncertainty["condition"], uncertainty["blur"], strict=True))
    shares = [row["translation"][f"coverage_{level}"] for level in (50, 90, 99)]
    assert cells["translation in 50 / 90 / 99 %"] == " / ".join(f"{100 * s:.0f}" for s in shares)
    assert cells["σ distance"] == f"{row['median_sigma_distance_m']:.2f} m"
    charts = next(row for row in document["without_object"] if row["name"] == "charts")
    cells = dict(zip(refusal["without the object"], refusal["charts"], strict=True))
    assert cells["AUROC"] == f"{charts['auroc']:.4f}"
    assert "second renderer" in text
    assert "constant pose" in errors


def test_a_network_that_gives_no_uncertainty_has_its_errors_measured(tmp_path):
    path = save(tmp_path / "frame.safetensors", "tiny", **FRAME_FIELDS)
    document = measure(path, beacon_scene(), count=1, size=(64, 48))
    assert document["without_object"] == []
    assert all("rotation" not in row for row in document["conditions"])
    assert len([p for p in format_card(document).split("\n\n") if p.startswith("|")]) == 1


class Echo:
    """Says of a picture that the object is as many meters away as its red is bright."""

    def __init__(self):
        self.sizes = []

    def __call__(self, images):
        self.sizes.append(len(images))
        reds = [image.getpixel((0, 0))[0] for image in images]
        said = PoseUncertainty(np.eye(3), np.eye(3), 0.5)
        return [Pose([0, 0, red], [1, 0, 0, 0], said) for red in reds]


def test_answers_stay_with_their_pictures_whatever_the_batches():
    truth = Pose([0, 0, 1], [1, 0, 0, 0])
    shown = [
        Shown("odd" if red % 2 else "even", Image.new("RGB", (2, 2), (red, 0, 0)), pose)
        for red in range(1, 38)
        for pose in [truth if red % 2 else None]
    ]
    echo = Echo()
    answers = answer(echo, shown)
    assert [pose.t[2] for pose in answers["odd"].found] == list(range(1, 38, 2))
    assert [pose.t[2] for pose in answers["even"].found] == list(range(2, 37, 2))
    assert answers["odd"].truth == [truth] * 19
    assert answers["even"].truth == []
    assert echo.sizes == [16, 16, 5]
    assert isinstance(answers["odd"], Answers)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"seed": 999_999}, "seed: expected 1000000 to 1999999, .* got 999999"),
        ({"seed": FINAL.start}, "seed: expected 1000000 to 1999999, .* got 5000000"),
        ({"count": 0}, "count: expected at least 1, got 0"),
        ({"workers": 0}, "workers: expected at least 1, got 0"),
        ({"size": (4, 3)}, "size: expected width and height"),
    ],
)
def test_absurd_numbers_are_refused_before_anything_is_rendered(weights, words, message):
    with pytest.raises(ValueError, match=message):
        measure(weights, "soyuz_easy", **words)


def test_an_unknown_set_is_refused_with_the_known_ones(weights):
    with pytest.raises(ValueError, match=r"scene: expected one of soyuz_easy, .*, got 'soyuz'"):
        measure(weights, "soyuz")


def test_the_command_prints_one_document_and_writes_it(weights, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(measurement, "BASELINE_LABELS", 10)
    words = ["card", str(weights), "--scene", "soyuz_easy", "--count", "1", "--size", "64x48"]
    assert main([*words, "--json", "--out", str(tmp_path / "card")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["seed"], printed["final"]) == (CHOICES.start, False)
    assert printed == json.loads((tmp_path / "card/card.json").read_text())
    assert (tmp_path / "card/card.md").read_text() == format_card(printed)
    assert printed["scene"] == "soyuz_easy"
    assert printed["size"] == [64, 48]
    assert sorted(path.name for path in (tmp_path / "card").iterdir()) == ["card.json", "card.md"]


def test_the_final_card_shows_the_seed_that_is_kept_for_it_and_is_measured_once(
    weights, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(measurement, "BASELINE_LABELS", 10)
    words = ["card", str(weights), "--scene", "soyuz_easy", "--count", "1", "--size", "64x48"]
    words += ["--final", "--json", "--out", str(tmp_path / "cards/look")]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["seed"], printed["final"]) == (FINAL.start, True)
    monkeypatch.setattr(measurement, "load", None)
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out) == printed
    words[words.index("--count") + 1] = "2"  # another card than that in the folder
    assert main(words) == 1


@pytest.mark.parametrize(
    ("scene", "range_deg", "text"),
    [
        ("soyuz_easy", [180, 90, 180], "8 to 22 m, all attitudes;"),
        (
            replace(find_scene("soyuz_easy"), name="own", attitude_range_deg=(20, 10, 30)),
            [20, 10, 30],
            "8 to 22 m, roll, pitch, yaw within 20, 10, 30 degrees;",
        ),
    ],
)
def test_a_set_of_ones_own_keeps_its_attitudes(weights, monkeypatch, scene, range_deg, text):
    """Networks of the built-in sets learn all, those of `ffpose learn` what was asked for."""
    shown = []
    monkeypatch.setattr(measurement, "answer", lambda *_: {})

    def results(plan, *_):
        shown.extend(v.scene.attitude_range_deg for v in (*plan.with_object, *plan.without))
        return {"conditions": [], "mean_pose_baseline": {}, "without_object": []}

    monkeypatch.setattr(measurement, "_results", results)
    monkeypatch.setattr("ffpose.evaluation.card.tables.errors_table", lambda _: "")
    document = measure(weights, scene, count=1, size=(64, 48))
    assert {tuple(each) for each in shown} == {tuple(range_deg)}
    assert text in format_card(json.loads(json.dumps(document)))


def test_a_card_of_another_set_of_the_same_name_is_measured_anew(weights, tmp_path, monkeypatch):
    for name, made in {"answer": {}, "_results": {}, "format_card": ""}.items():
        monkeypatch.setattr(measurement, name, lambda *_, made=made: made)
    nearer = replace(find_scene("soyuz_easy"), distance_m=(8.0, 12.0))
    options = {"count": 1, "size": (64, 48), "out": tmp_path}
    measured = measure(weights, nearer, **options)
    assert measured["scene_parameters"]["distance_m"] == [8.0, 12.0]
    monkeypatch.setattr(measurement, "load", None)
    assert measure(weights, nearer, **options) == measured
    for scene in ("soyuz_easy", replace(nearer, distance_m=(8.0, 13.0))):
        with pytest.raises(TypeError):
            measure(weights, scene, **options)
    del measured["scene_parameters"]  # as in the cards of the built-in sets
    (tmp_path / "card.json").write_text(json.dumps(measured))
    assert measure(weights, "soyuz_easy", **options) == measured


def test_a_card_whose_writing_broke_off_is_measured_again(weights, tmp_path, monkeypatch):
    for name, made in {"answer": {}, "_results": {}, "format_card": ""}.items():
        monkeypatch.setattr(measurement, name, lambda *_, made=made: made)
    options = {"count": 1, "size": (64, 48), "out": tmp_path}
    write_text = measurement.write_text

    def one_file(path, text):
        if any(tmp_path.iterdir()):
            raise OSError("disk full")
        write_text(path, text)

    monkeypatch.setattr(measurement, "write_text", one_file)
    with pytest.raises(OSError, match="disk full"):
        measure(weights, "soyuz_easy", **options)
    monkeypatch.setattr(measurement, "write_text", write_text)
    measure(weights, "soyuz_easy", **options)
    assert {path.name for path in tmp_path.iterdir()} == {"card.json", "card.md"}


@pytest.mark.peer
def test_images_of_a_second_renderer_are_one_more_condition(weights, document):
    pytest.importorskip("mitsuba")
    more = measure(weights, beacon_scene(), count=2, size=(64, 48), second_renderer=True)
    names = [condition["name"] for condition in more["conditions"]]
    before = [condition["name"] for condition in document["conditions"]]
    assert set(names) - set(before) <= {"second renderer", "sunlit only", "eclipse only"}
    assert names[-1] == "second renderer"
    assert more["conditions"][-1]["images"] == 2
    assert not more["notes"]
    assert "--mitsuba" in document["notes"][0]


def test_a_second_renderer_that_is_missing_is_an_error_before_anything_is_rendered(
    weights, monkeypatch
):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(MissingExtraError, match=r"mitsuba.*\[mitsuba\]"):
        measure(weights, beacon_scene(), second_renderer=True)
