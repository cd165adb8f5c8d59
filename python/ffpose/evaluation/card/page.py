"""The page of model cards: its tables stand between marks, and come from the cards' data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffpose._internal.files import atomic_write, read_json
from ffpose.evaluation.card.tables import accuracy_table, format_card, summary_table

Document = Mapping[str, Any]

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
