"""The style of options on every command line: hyphens, and a switch for what is true or false."""

from __future__ import annotations

import argparse
import re
from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from ffpose.errors import DataError, hint

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser


def restyle(parser: ArgumentParser) -> None:
    """Spell the options of a parser with hyphens, and make those of type bool switches.

    A switch is true if it stands alone, and takes ``true`` or ``false`` too.
    """
    known = parser._option_string_actions
    for action in parser._actions:
        for option in action.option_strings:
            del known[option]
        action.option_strings = [option.replace("_", "-") for option in action.option_strings]
        known.update(dict.fromkeys(action.option_strings, action))
        if getattr(action, "_typehint", None) is bool:
            action.nargs, action.const = "?", True


def split(words: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield option, separator and value of each option among words.

    The separator is ``"="``, ``" "`` where the value is the next word, or ``""`` without a value.
    A word that neither is an option nor follows one comes as an option of its own.

    Examples:
        >>> list(split(["a", "--seed", "3", "--resume", "--out=b"]))
        [('a', '', ''), ('--seed', ' ', '3'), ('--resume', '', ''), ('--out', '=', 'b')]
    """
    place = 0
    while place < len(words):
        option, separator, value = words[place].partition("=")
        place += 1
        if not option.startswith("--"):
            option, separator, value = f"{option}{separator}{value}", "", ""
        elif not separator and place < len(words) and not words[place].startswith("--"):
            separator, value = " ", words[place]
            place += 1
        yield option, separator, value


def join(option: str, separator: str, value: str) -> list[str]:
    """Return the words of an option: the inverse of `split`."""
    return [option, value] if separator == " " else [f"{option}{separator}{value}"]


def check_spelling(words: Sequence[str]) -> None:
    """Check that no option is spelled with underscores.

    Raises:
        argparse.ArgumentError: One is; the message has it with hyphens.

    Examples:
        >>> check_spelling(["--batch_size", "4"])
        Traceback (most recent call last):
        argparse.ArgumentError: expected hyphens, --batch-size, got --batch_size
    """
    for option, _, _ in split(words):
        if option.startswith("--") and "_" in option:
            raise wrong(f"expected hyphens, {option.replace('_', '-')}, got {option}")


def wrong(message: str) -> argparse.ArgumentError:
    """Return the error of wrong usage, for which the command line's exit code is 2."""
    return argparse.ArgumentError(None, message)


UNITS = ("-deg", "-px", "-quality")
"""What the name of a field may have after that of its option."""


def is_usage(error: Exception, usage: str) -> bool:
    """Return whether an error is about the value of an argument that a parser's usage names.

    One of `UNITS` may follow the name, as in ``attitude_range_deg``.

    Examples:
        >>> is_usage(ValueError("count: expected at least 1, got 0"), "[--count COUNT]")
        True
        >>> is_usage(ValueError("depth: expected at least 1, got 0"), "[--count COUNT]")
        False
        >>> is_usage(ValueError("count_deg: expected at least 1, got 0"), "[--count COUNT]")
        True
    """
    found = re.match(r"(?:--)?([\w.-]+): expected", str(error))
    if found is None or not isinstance(error, ValueError) or isinstance(error, DataError):
        return False
    name = found[1].replace("_", "-")
    known = {each.replace("_", "-") for each in re.findall(r"[a-z][\w.-]*", usage)}
    return any(name.removesuffix(unit) in known for unit in ("", *UNITS))


def positionals_first(words: Sequence[str], flags: Collection[str]) -> list[str]:
    """Return words with those first that no option takes, which argparse wants side by side.

    Options take one value, but for the ``flags``.

    Examples:
        >>> positionals_first(["net", "a.png", "--json", "b.png", "--batch", "2"], {"--json"})
        ['net', 'a.png', 'b.png', '--json', '--batch', '2']
    """
    if "--" in words:
        return list(words)
    positionals, options = [], []
    rest = iter(words)
    for word in rest:
        if not word.startswith("-"):
            positionals.append(word)
            continue
        options.append(word)
        if word not in flags and "=" not in word:
            options += islice(rest, 1)
    return positionals + options


KINDS = {"float": "a finite number", "int": "a whole number", "bool": "true or false"}
"""What types of values are called; jsonargparse writes the classes."""


def advice(message: str, known: Sequence[str]) -> str:
    r"""Return a usage error as one line, with the most similar option.

    Examples:
        >>> advice("unrecognized arguments: --batch-sise 4", ["--out", "--batch-size"])
        'unrecognized arguments: --batch-sise 4 (did you mean --batch-size?)'
        >>> advice("Group 'data' does not accept option 'val_splt'", ["--data.val-split"])
        "Group 'data' does not accept option 'val_splt' (did you mean data.val_split?)"
        >>> advice("Parser key \"mesh_scale\": Expected a <class 'float'>. Got value: nan", [])
        '--mesh-scale: expected a finite number, got nan'
        >>> advice('Parser key "size": Not of type Size: 30 does not match regular expression', [])
        '--size: expected WIDTHxHEIGHT, as 640x480, got 30'
    """
    line = " ".join(message.split())
    if unknown := re.search(r"(?i)unrecognized arguments: (--[^\s=]+)", line):
        return line + hint(unknown[1], known)
    fields = [name.removeprefix("--").replace("-", "_") for name in known]
    if unknown := re.search(r"Group '(.+)' does not accept option '(.+)'", line):
        return line + hint(f"{unknown[1]}.{unknown[2]}", fields)
    if unknown := re.search(r"Option '(.+)' is not accepted", line):
        return line + hint(unknown[1], fields)
    if size := re.match(r'Parser key "(.+?)": Not of type Size: (\S+) does not match', line):
        return f"--{size[1].replace('_', '-')}: expected WIDTHxHEIGHT, as 640x480, got {size[2]}"
    if not (
        value := re.match(r'Parser key "(.+?)".*?: (.+?)[.:]? (?:Got|Given) value: (.+)', line)
    ):
        return line
    option, told, got = value.groups()
    expected = [KINDS[name] for name in re.findall(r"<class '(\w+)'>", told) if name in KINDS]
    expected += [f"one of {names}" for names in re.findall(r"typing\.Literal\[(.+?)\]", told)]
    if not expected:
        return line
    return (
        f"--{option.replace('_', '-')}: expected {' or '.join(dict.fromkeys(expected))}, got {got}"
    )
