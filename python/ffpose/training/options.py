"""The options of ``ffpose train``: every field of `TrainConfig`, spelled as one option.

``--batch-size 8`` and ``--data.train-split NAME`` are fields; ``--model NAME`` is the preset of the
network, and ``--model.depth 4`` a field of it; lists are ``1,2``. In a file of YAML, fields have
their names in Python, and the network is ``model: {name: base, depth: 4}``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffpose._internal.files import read_text
from ffpose._internal.options import check_spelling, join, restyle, split, wrong
from ffpose.config import PRESETS, looks_twice
from ffpose.errors import DataError, require
from ffpose.training import configs
from ffpose.training.config import VARIANTS, DataConfig, TrainConfig

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser

DEFAULT_MODEL = "base"

OPEN = ("--model.", "--data.augmentation.")
"""What options begin with whose names are the fields of a mapping."""

GROUPS = ("--data", "--data.augmentation", "--optimizer", "--loss", "--object-loss", "--views")
"""Options that stand for several fields, and take a file."""

LISTS = tuple(
    f"--data.{field.name.replace('_', '-')}"
    for field in fields(DataConfig)
    if "list" in str(field.type) or "tuple" in str(field.type)
)
"""Options whose values may be lists."""


RENDERED = ("scene", "count", "validation", "calibration", "empty", "decoys", "distance", "seed")
HEEDED = {
    "--data.kind scenes": tuple(
        f"--data.{name}" for name in (*RENDERED, *VARIANTS, "attitude-range-deg")
    ),
    "a set on disk": ("--data.train-split", "--data.val-split"),
    "a network that looks twice": ("--object-loss.", "--views."),
    "a network that looks once": ("--loss.", "--data.augment"),
}
"""What options begin with that nothing else heeds; in a file they may stand beside it."""


def add_fields(parser: ArgumentParser) -> None:
    """Declare every field of `TrainConfig`."""
    names = sorted({field.name for preset in PRESETS.values() for field in fields(preset)})
    shown = ", ".join(f"--model.{name.replace('_', '-')}" for name in names)
    parser.add_argument(
        "--model",
        type=dict[str, Any],
        default={"name": DEFAULT_MODEL},
        metavar="NAME",
        help=f"preset of the network: {', '.join(PRESETS)}; its fields: {shown}",
    )
    parser.add_class_arguments(TrainConfig, skip={"model", "model_fields"})
    restyle(parser)


def field_parser() -> ArgumentParser:
    """Return a parser of the fields alone."""
    parser: ArgumentParser = require("jsonargparse", "pose").ArgumentParser(exit_on_error=False)
    add_fields(parser)
    return parser


def read_words(words: Sequence[str]) -> list[str]:
    """Return the words of a command line as the parser of `add_fields` takes them.

    Raises:
        argparse.ArgumentError: An option has underscores, a value is a JSON string, or a value of
            ``--config`` is neither a file nor a name; the message has the right spelling.
    """
    found = []
    for option, separator, value in split(words):
        check_spelling([option])
        if option == "--stages":
            raise wrong(f"expected stages in a file, --config FILE, got {option} {value}")
        if option.startswith(OPEN) and not separator:
            separator, value = "=", "true"
        found += join(_dest(option), separator, _value(option, value) if separator else "")
    return found


def expect_heeded(words: Sequence[str]) -> None:
    """Check that no option is of other images or of another network than those that are chosen.

    Raises:
        argparse.ArgumentError: One is.
    """
    chosen = {"--data.kind": "", "--model.name": DEFAULT_MODEL}
    for option, _, value in split(words):
        if option == "--config" and value:
            chosen.update(_choices(check_document(read_text(configs.resolve(value)))))
        elif option == "--data" and value:
            chosen.update(_choices({"data": check_document(read_text(Path(value)))}))
        elif _dest(option) in chosen:
            chosen[_dest(option)] = value
    kind, model = chosen.values()
    others = {"a set on disk": kind} if kind == "scenes" else {"--data.kind scenes": kind}
    if model in PRESETS:
        times = "once" if looks_twice(PRESETS[model]) else "twice"
        others[f"a network that looks {times}"] = model
    for option, _, _ in split(words):
        for other, got in others.items():
            if got and option.startswith(HEEDED[other]):
                raise wrong(f"{option}: expected with {other}, got it with {got}")


def _choices(document: Any) -> Iterator[tuple[str, str]]:
    """Yield the options of the kind of images and the network that a configuration chooses."""
    for group, name in (("data", "kind"), ("model", "name")):
        fields = document.get(group) if isinstance(document, dict) else None
        if isinstance(fields, dict) and name in fields:
            yield f"--{group}.{name}", str(fields[name])


def _dest(option: str) -> str:
    """Return how jsonargparse knows an option, whose names of fields in mappings are Python's."""
    if option == "--model":
        return "--model.name"
    for start in OPEN:
        if option.startswith(start):
            return start + option.removeprefix(start).replace("-", "_")
    return option


def _value(option: str, value: str) -> str:
    """Return a value as jsonargparse reads it, with brackets about a list."""
    if option == "--config":
        try:
            path = configs.resolve(value)
        except FileNotFoundError as error:
            raise wrong(str(error)) from error
        check_document(read_text(path))
        return str(path)
    nested, listed = option.startswith(OPEN), option in LISTS
    if value.startswith(("{", "[")):
        if nested or listed:
            raise wrong(f"expected a list as {option} 1,2, got {value}")
        if option in ("--model", *GROUPS):
            raise wrong(f"expected an option for each field, {option}.FIELD VALUE, got {value}")
    return f"[{value}]" if (nested or listed) and "," in value else value


def check_document(text: str) -> Any:
    """Return a configuration in YAML, which must have the network's name and fields together."""
    try:
        document = require("jsonargparse", "pose").get_loader("yaml")(text)
    except Exception as error:  # that of the YAML package, which jsonargparse chooses
        raise wrong(f"expected YAML: {error}") from error
    if isinstance(document, dict):
        for name, kind in (("model", str), ("model_fields", dict)):
            if isinstance(document.get(name), kind):
                expected = f"model: {{name: {DEFAULT_MODEL}, FIELD: VALUE}}"
                raise wrong(f"expected {expected}, got {name}: {document[name]}")
    return document


def to_config(values: Mapping[str, Any]) -> TrainConfig:
    """Return the configuration of the fields that a parser of `add_fields` read.

    Raises:
        argparse.ArgumentError: There is no network of the name, or it has no field of a name.
        ValueError: A value is invalid.
    """
    named = dict(values)
    network = dict(named.pop("model", {}))
    model = network.pop("name", DEFAULT_MODEL)
    if model not in PRESETS:
        raise wrong(f"model: expected one of {', '.join(PRESETS)}, got {model!r}")
    try:
        PRESETS[model].check_names(network)
    except ValueError as error:
        raise wrong(f"model: {error}") from error
    return TrainConfig(**named, model=model, model_fields=network)


def dump_config(config: TrainConfig) -> str:
    """Return ``config`` as YAML, with every field."""
    values = asdict(config)
    network = {"name": values["model"], **values.pop("model_fields")}
    parser = field_parser()
    return str(parser.dump(parser.parse_object({**values, "model": network})))


def load_config(path: Path) -> TrainConfig:
    """Read a configuration that `dump_config` wrote; a DataError if it is none."""
    from jsonargparse import ArgumentError

    parser = field_parser()
    text = read_text(path)
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
