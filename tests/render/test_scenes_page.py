"""docs/scenes.md promises; this holds it to that."""

import re
from pathlib import Path

import pytest

from ffpose.cli import main
from ffpose.render import SCENES

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "scenes.md").read_text()


def options(page):
    """The options of ``ffpose render`` that a page names, in its commands or in back-ticks."""
    commands = re.findall(r"ffpose render [^\n`]+", page)
    in_commands = re.findall(r"(?<=\s)--[a-z-]+", "\n".join(commands))
    return {*in_commands, *re.findall(r"`(--[a-z-]+)[^`]*`", page)}


def test_options_are_found_in_commands_and_in_back_ticks():
    page = (
        "`--motion 20` blurs.\nffpose render x --out y\n`--jpeg`, but not `ffpose predict --json`"
    )
    assert options(page) == {"--motion", "--out", "--jpeg"}
    assert {"--eclipse-rate", "--jpeg", "--mesh-scale", "--count"} <= options(PAGE)


def test_every_option_exists(capsys):
    with pytest.raises(SystemExit):
        main(["render", "--help"])
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert options(PAGE) <= known


@pytest.mark.parametrize("name", SCENES)
def test_every_set_has_its_sheet(name):
    assert f"images/{name}.jpg" in PAGE
    assert 20_000 < (DOCS / "images" / f"{name}.jpg").stat().st_size < 400_000
