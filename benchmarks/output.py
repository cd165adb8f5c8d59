"""Shared output of the benchmarks: tables, progress bars, documents, plots."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

WIDTH = 132


def print_document(document: Mapping[str, Any]) -> None:
    """Print a JSON document on standard output."""
    print(json.dumps(document, indent=2))


def make_progress() -> Progress:
    """Return a progress bar on standard error."""
    return Progress(
        MofNCompleteColumn(),
        BarColumn(bar_width=20),
        TextColumn("{task.description}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )


def make_console() -> Console:
    """Return a console on standard output, wide enough for the tables if it is not a terminal."""
    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """Print one line for each note."""
    for line in notes:
        console.print(f"- {line}", markup=False)


def make_table(title: str, *columns: str) -> Table:
    """Return an empty table with these columns."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for name in columns:
        table.add_column(name)
    return table


def in_threads(count: int) -> str:
    """Return the number of threads in words."""
    return f"{count} thread{'s' if count > 1 else ''}"
