"""What both measurements print: a table, or a JSON document."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import torch
from rich.console import Console
from rich.table import Column, Table

from ffpose._internal.info import collect
from ffpose._internal.machine import processor


def print_results(title: str, rows: list[dict[str, Any]], as_json: bool, **document: Any) -> None:
    """Print a table, or in its place a document, with what this machine is."""
    facts = {**collect(), "torch": torch.__version__}
    if as_json:
        print(json.dumps({"environment": facts, **document}, indent=2, default=asdict))
        return
    columns = (Column(name, justify="right") for name in rows[0])
    title += f", {processor()}, {facts['instruction_set']}, torch {facts['torch']}"
    table = Table(*columns, title=title, title_justify="left", box=None)
    for row in rows:
        table.add_row(*(f"{v:.2f}" if isinstance(v, float) else str(v) for v in row.values()))
    Console(width=100).print(table)
