"""The page of model cards: its tables stand between marks, and come from the cards' data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffpose._internal.files import atomic_write, read_json
from ffpose.evaluation.card.tables import (
    NONE,
    Row,
    card_name,
    coverage_text,
    degrees,
    format_card,
    markdown_table,
    meters,
    percent,
)

Document = Mapping[str, Any]


def accuracy_table(cards: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table that compares cards, by set, on the scenes as trained.

    The last column is the constant pose of the first card.
    """
    rows = [card["conditions"][0] for card in cards.values()]
    constant = next(iter(cards.values()))["mean_pose_baseline"]

    def median(name: str, show: Any) -> list[str]:
        found = [show(row[f"median_{name}"]) for row in rows]
        between = [map(show, row["median_intervals_95"][f"median_{name}"]) for row in rows]
        cells = [f"{value} [{', '.join(ends)}]" for value, ends in zip(found, between, strict=True)]
        return [*cells, show(constant[f"median_{name}"])]

    def both(row: Row) -> str:
        rotation, translation = row["mean_rotation_error_deg"], row["mean_translation_error_m"]
        return f"{degrees(rotation)}, {meters(translation)}"

    lines = [
        ["E_q", *median("rotation_error_deg", degrees)],
        ["in-plane", *median("in_plane_error_deg", degrees)],
        ["out-of-plane", *median("out_of_plane_error_deg", degrees)],
        ["E_t", *median("translation_error_m", meters)],
        ["E_t / ‖t‖", *median("relative_translation_error", percent)],
        ["mean E_q, E_t", *map(both, rows), both(constant)],
        *(
            [
                f"{name} in the 50 / 90 / 99 % region",
                *(coverage_text(row[name]) for row in rows),
                NONE,
            ]
            for name in ("rotation", "translation")
        ),
        [
            "object in view or not, AUROC",
            *(f"{card['without_object'][-1]['auroc']:.4f}" for card in cards.values()),
            NONE,
        ],
    ]
    return markdown_table(["", *map(card_name, cards.values()), "constant"], lines)


def summary_table(cards: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table of the errors of each card, and of the constant mean poses of the sets."""

    def cells(name: str, row: Row) -> list[str]:
        relative = percent(row["median_relative_translation_error"])
        return [
            name,
            degrees(row["median_rotation_error_deg"]),
            f"{degrees(row['mean_rotation_error_deg'])}, {percent(row['share_over_30_deg'])}",
            f"{meters(row['median_translation_error_m'])}, {relative} of the distance",
            str(row["images"]),
        ]

    lines = []
    for card in cards.values():
        near, far = card["distance_m"]
        lines.append(cells(f"{card_name(card)}, {near:g}–{far:g} m", card["conditions"][0]))
        lines.append(
            cells(f"… constant: mean pose of `{card['scene']}`", card["mean_pose_baseline"])
        )
    return markdown_table(["", "attitude", "its mean, > 30°", "position", "images"], lines)


PART = re.compile(r"(<!-- card: (\S+) -->\n).*?(<!-- end of card -->)", re.DOTALL)
OF_ALL = {"accuracy": accuracy_table, "summary": summary_table}
"""Names of the parts with a table of all cards, and what makes it."""


def read_cards(folder: Path) -> dict[str, Document]:
    """Read the cards ``SET/card.json`` of a folder, by set.

    Raises:
        ffpose.DataError: A file is not JSON.
    """
    return {path.parent.name: read_json(path) for path in sorted(folder.glob("*/card.json"))}


def filled(page: str, cards: Mapping[str, Document]) -> str:
    """Return a page with its parts as the cards have them.

    A part begins with the line ``<!-- card: NAME -->``, where NAME is the set of a card, or
    one of `OF_ALL`, and ends before ``<!-- end of card -->``. Parts of other names stay.

    Args:
        page: The page, Markdown.
        cards: Documents of `ffpose.evaluation.card.measurement.measure`, by set.
    """

    def part(match: re.Match[str]) -> str:
        begin, name, end = match.groups()
        if name in OF_ALL:
            return f"{begin}\n{OF_ALL[name](cards)}\n\n{end}"
        return f"{begin}\n{format_card(cards[name])}\n{end}" if name in cards else match[0]

    return PART.sub(part, page)


def fill_page(path: Path, folder: Path) -> None:
    """Fill a page in place with the cards of a folder.

    Raises:
        FileNotFoundError: There is no such page.
        ffpose.DataError: A card cannot be read.
    """
    text = filled(path.read_text(encoding="utf-8"), read_cards(folder))
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
