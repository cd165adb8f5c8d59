"""Reading and writing a training configuration as YAML, for ``ffpose train --config``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ffpose.errors import DataError
from ffpose.training.config import TrainConfig
from ffpose.training.options import check_document, field_parser, to_config, to_document


def dump_config(config: TrainConfig) -> str:
    """Return ``config`` as YAML, with every field."""
    parser = field_parser()
    return str(parser.dump(parser.parse_object(to_document(config))))


def load_config(path: Path) -> TrainConfig:
    """Read a configuration that `dump_config` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        ffpose.DataError: The file is not a training configuration.
    """
    from jsonargparse import ArgumentError

    parser = field_parser()
    text = path.read_text(encoding="utf-8")
    try:
        check_document(text)
        values = parser.instantiate(parser.parse_string(text))
        return to_config(vars(values))
    except (ArgumentError, TypeError, ValueError) as error:
        raise DataError(f"not a training configuration: {error}", path) from error


def flatten(config: TrainConfig) -> dict[str, Any]:
    """Return the fields of ``config`` by dotted name, as in ``data.kind``."""
    return {
        f"{name}.{inner}" if inner else name: value
        for name, group in asdict(config).items()
        for inner, value in (
            group.items() if isinstance(group, dict) and name != "model_fields" else [("", group)]
        )
    }
