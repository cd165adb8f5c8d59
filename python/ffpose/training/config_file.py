"""Reading and writing a training configuration as YAML, for ``ffpose train --config``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ffpose.errors import DataError, require
from ffpose.training.config import TrainConfig

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser


def _parser() -> ArgumentParser:
    jsonargparse = require("jsonargparse", "pose")
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(TrainConfig)
    return cast("ArgumentParser", parser)


def dump_config(config: TrainConfig) -> str:
    """Return ``config`` as YAML, with every field."""
    parser = _parser()
    return str(parser.dump(parser.parse_object(asdict(config))))


def load_config(path: Path) -> TrainConfig:
    """Read a configuration that `dump_config` wrote.

    Raises:
        FileNotFoundError: There is no such file.
        ffpose.DataError: The file is not a training configuration.
    """
    from jsonargparse import ArgumentError

    parser = _parser()
    try:
        values = parser.instantiate(parser.parse_string(path.read_text()))
    except (ArgumentError, TypeError, ValueError) as error:
        raise DataError(f"not a training configuration: {error}", path) from error
    return TrainConfig(**vars(values))


def flatten(config: TrainConfig) -> dict[str, Any]:
    """Return the fields of ``config`` by dotted name, as in ``data.kind``."""
    return {
        f"{name}.{inner}" if inner else name: value
        for name, group in asdict(config).items()
        for inner, value in (
            group.items() if isinstance(group, dict) and name != "model_fields" else [("", group)]
        )
    }
