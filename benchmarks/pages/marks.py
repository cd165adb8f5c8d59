"""Marks in a page, ``<!-- figures NAME -->`` to ``<!-- end figures -->``, and what is between."""

from __future__ import annotations

import re
from collections.abc import Callable

MARKED = re.compile(
    r"(?P<begin><!-- figures (?P<name>[\w-]+) -->)(?P<text>.*?)(?P<end><!-- end figures -->)",
    re.DOTALL,
)


def fill(page: str, show: Callable[[str], str]) -> str:
    """Return a page with new text between its marks: in the line, or as a block of lines.

    Args:
        page: Markdown.
        show: Gives the text of a name; more than one line, or the row of a table, is a block.

    Raises:
        ValueError: A mark has no end, or an end no beginning.
    """
    marks = len(re.findall(r"<!-- (?:end )?figures\b", page))
    if marks != 2 * len(MARKED.findall(page)):
        raise ValueError(f"expected each mark of figures with its end, got {marks} marks")

    def filled(match: re.Match[str]) -> str:
        text = show(match["name"]).strip("\n")
        if text.startswith(("|", "-", "*")):
            text = f"\n\n{text}\n\n"
        return match["begin"] + text + match["end"]

    return MARKED.sub(filled, page)


def outside(page: str) -> str:
    """Return what stands outside of the marks."""
    return MARKED.sub("", page)
