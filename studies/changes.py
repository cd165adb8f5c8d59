"""Changes of single fields of a training, as ``data.count=8`` on the command line of a study."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ffpose._internal.options import join, split, wrong
from ffpose.training.options import field_parser, read_words


def read_changes(changes: Iterable[str]) -> dict[str, Any]:
    """Read changes of some fields, ``data.count=8`` or ``model.depth=4``.

    Args:
        changes: Each the option of a field without its hyphens in front, an equals sign and a
            value.

    Returns:
        The fields of `TrainConfig` that are changed, nested.

    Raises:
        argparse.ArgumentError: A field is unknown or a value invalid.

    Examples:
        >>> read_changes(["data.count=3,2", "model=tiny", "model.depth=2", "batch-size=4"])
        {'data': {'count': [3, 2]}, 'batch_size': 4, 'model': 'tiny', 'model_fields': {'depth': 2}}
    """
    words = [f"--{change}" for change in changes]
    for option, separator, _ in split(words):
        if separator != "=" or not option[2:3].isalpha():
            raise wrong(f"changes: expected FIELD=VALUE, as data.count=8, got {option[2:]}")
    required = {"--data.kind": "urso", "--data.root": ".", "--out": "."}
    given = {option for option, _, _ in split(words)}
    missing = [join(o, "=", value)[0] for o, value in required.items() if o not in given]
    parser = field_parser()
    values = parser.parse_args(read_words([*words, *missing]), defaults=False)
    for word in missing:
        del values[word.partition("=")[0].removeprefix("--")]
    named = values.as_dict()
    network = dict(named.pop("model", {}))
    if "name" in network:
        named["model"] = network.pop("name")
    named["model_fields"] = network
    return {name: value for name, value in named.items() if value != {}}
