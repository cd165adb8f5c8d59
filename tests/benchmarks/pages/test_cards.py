"""The page of model cards has the tables of the cards' data."""

import json

import pytest

from benchmarks.pages.cards import PART, fill_page, filled, read_cards
from ffpose._internal import zoo
from ffpose._internal.files import sha256
from ffpose._internal.seeds import FINAL
from ffpose.errors import DataError
from ffpose.evaluation.card.tables import format_card
from pages import ROOT

CARDS = {"dragon_hard": "dragon", "soyuz_easy": "soyuz", "soyuz_hard": "soyuz"}
"""The weights of the card of each set."""

ERRORS = {
    "rotation_error_deg": 2.0,
    "in_plane_error_deg": 1.0,
    "out_of_plane_error_deg": 1.5,
    "translation_error_m": 0.25,
    "relative_translation_error": 0.015,
}


def card(weights="soyuz", scene="soyuz_easy", rotation=2.0):
    """A card of weights on a set, whose median rotation error is ``rotation``."""
    values = ERRORS | {"rotation_error_deg": rotation}
    coverage = {"coverage_50": 0.5, "coverage_90": 0.91, "coverage_99": 0.98}
    row = {
        **{f"median_{key}": value for key, value in values.items()},
        **{f"mean_{key}": 2 * value for key, value in values.items()},
        "median_intervals_95": {f"median_{k}": [0.9 * v, 1.1 * v] for k, v in values.items()},
        "percentile_90_rotation_error_deg": 5.0,
        "share_over_30_deg": 0.01,
        "images": 500,
    }
    trusted = {
        **row,
        "rotation": coverage,
        "translation": coverage,
        "median_sigma_rotation_deg": 3.0,
        "median_sigma_distance_m": 0.3,
        "median_in_view": 1.0,
        "flagged": 0.02,
    }
    about = {"name": "as trained", "about": "the set", "seen": "yes", "seen_how": ""}
    cut = {"name": "cut", "about": "half", "seen": "partly", "seen_how": "in an earlier training"}
    absent = {"name": "all of them", "about": "", "images": 9, "median_in_view": 0.1}
    return {
        "weights": weights,
        "sha256": 64 * "a",
        "ffpose": "0.1.0",
        "scene": scene,
        "distance_m": [8, 22],
        "count": 500,
        "size": [640, 480],
        "seed": 5000000,
        "final": True,
        "in_view_threshold": 0.9,
        "conditions": [about | trusted, cut | trusted],
        "mean_pose_baseline": row,
        "without_object": [absent | {"auroc": 0.995, "miss_rate": 0.01, "false_alarm_rate": 0.02}],
        "notes": ["A note."],
    }


PAGE = """# Page

<!-- card: accuracy -->
old
<!-- end of card -->

Words between.

<!-- card: a -->
old
<!-- end of card -->
<!-- card: unknown -->
stays
<!-- end of card -->
"""


def test_parts_are_replaced_and_the_rest_stays():
    cards = {"a": card(scene="a"), "b": card(scene="b", rotation=3.0)}
    text = filled(PAGE, cards)
    assert "old" not in text
    assert text.startswith("# Page\n\n<!-- card: accuracy -->\n\n| ")
    assert (
        "\n<!-- end of card -->\n\nWords between.\n\n<!-- card: a -->\n\n`soyuz` on `a` (SHA-256"
        in text
    )
    assert text.endswith("<!-- card: unknown -->\nstays\n<!-- end of card -->\n")
    assert format_card(cards["a"]) in text
    assert filled(text, cards) == text
    assert [name for _, name, _ in PART.findall(text)] == ["accuracy", "a", "unknown"]


def test_the_cards_are_compared_column_by_column():
    cards = {"a": card("x", "a"), "b": card("y", "b", 3.0)}
    text = filled(PAGE, cards)
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    header = next(line for line in lines if "`y`" in line)
    assert header == "|  | `x` on `a` | `y` on `b` | constant |"
    assert "| E_q | 2.00° [1.80°, 2.20°] | 3.00° [2.70°, 3.30°] | 2.00° |" in lines
    assert "| mean E_q, E_t | 4.00°, 0.50 m | 6.00°, 0.50 m | 4.00°, 0.50 m |" in lines
    region = "| rotation in the 50 / 90 / 99 % region | 50 / 91 / 98 | 50 / 91 / 98 | – |"
    assert region in lines


def test_the_summary_has_two_rows_a_card():
    text = filled("<!-- card: summary -->\n<!-- end of card -->\n", {"a": card()})
    name = "`soyuz` on `soyuz_easy`, 8–22 m"
    assert (
        f"| {name} | 2.00° | 4.00°, 1.0 % | 0.25 m, 1.5 % of the distance | 500 |"
        in text.splitlines()
    )
    assert "| … constant: mean pose of `soyuz_easy` | 2.00° |" in text


def test_the_pages_have_the_cards_of_the_shipped_weights():
    """`make cards` made them all."""
    cards = read_cards(ROOT / "cards")
    assert {name: document["weights"] for name, document in cards.items()} == CARDS
    assert sorted({*CARDS.values()}) == zoo.names()
    for name, document in cards.items():
        assert document["sha256"] == sha256(zoo.resolve(document["weights"]))
        assert (document["final"], document["seed"]) == (True, FINAL.start)
        assert document["scene"] == name
    parts = []
    for page in ("docs/models.md", "README.md"):
        text = (ROOT / page).read_text()
        assert filled(text, cards) == text
        parts += [name for _, name, _ in PART.findall(text)]
    assert sorted(parts) == sorted([*CARDS, "accuracy", "summary"])


def test_a_card_says_whether_training_had_a_condition():
    text = format_card(card())
    assert "| condition | in training | images |" in text
    assert "| cut | partly | 500 |" in text
    assert "Partly in training: cut (in an earlier training)." in text
    assert "seed 5000000 (final)" in text


def test_cards_are_read_by_their_folders(tmp_path):
    for name in ("b", "a"):
        (tmp_path / "cards" / name).mkdir(parents=True)
        (tmp_path / "cards" / name / "card.json").write_text(json.dumps(card(scene=name)))
    assert list(read_cards(tmp_path / "cards")) == ["a", "b"]
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    fill_page(page, tmp_path / "cards")
    assert page.read_text() == filled(PAGE, read_cards(tmp_path / "cards"))
    (tmp_path / "cards/a/card.json").write_text("{")
    with pytest.raises(DataError, match=r"card\.json"):
        read_cards(tmp_path / "cards")
