"""Recipes: configurations of published trainings, by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

SUFFIX = ".yaml"


def recipe_names() -> list[str]:
    """Return the names of the recipes that come with ffpose."""
    files = resources.files(__name__).iterdir()
    return sorted(file.name.removesuffix(SUFFIX) for file in files if file.name.endswith(SUFFIX))


def recipe_file(name: str) -> Path:
    """Return the configuration file of a recipe, for ``ffpose train --config``.

    Raises:
        ValueError: There is no recipe of this name.
    """
    if name not in recipe_names():
        raise ValueError(f"recipe: expected one of {', '.join(recipe_names())}, got {name!r}")
    return Path(str(resources.files(__name__) / f"{name}{SUFFIX}"))
