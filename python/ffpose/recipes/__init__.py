"""Recipes: configurations of published trainings, by name, and of their transforms alone."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Literal

SUFFIX = ".yaml"

Kind = Literal["recipe", "transforms"]


def recipe_names(kind: Kind = "recipe") -> list[str]:
    """Return the names of the recipes, or of the transforms, that come with ffpose."""
    return sorted(path.stem for path in _folder(kind).glob(f"*{SUFFIX}"))


def recipe_file(name: str, kind: Kind = "recipe") -> Path:
    """Return the configuration file of a recipe, for ``ffpose train --config``.

    Raises:
        ValueError: There is none of this name.
    """
    if name not in recipe_names(kind):
        raise ValueError(f"{kind}: expected one of {', '.join(recipe_names(kind))}, got {name!r}")
    return _folder(kind) / f"{name}{SUFFIX}"


def _folder(kind: Kind) -> Path:
    root = Path(str(resources.files(__name__)))
    return root if kind == "recipe" else root / kind
