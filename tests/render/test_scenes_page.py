"""docs/scenes.md promises; this holds it to that."""

import re
from pathlib import Path

import pytest

from ffpose.cli import main
from ffpose.render import SCENES

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "scenes.md").read_text()


def test_python_runs():
    for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
        exec(compile(code, "scenes.md", "exec"), {"__name__": "page"})


def test_every_option_exists(capsys):
    with pytest.raises(SystemExit):
        main(["render", "--help"])
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    words = " ".join(re.findall(r"ffpose render [^\n`]+|`(?:--[^`]+)`", PAGE))
    assert set(re.findall(r"(?<=\s)--[a-z-]+|^--[a-z-]+", words)) <= known


@pytest.mark.parametrize("name", SCENES)
def test_every_set_has_its_sheet(name):
    assert f"images/{name}.jpg" in PAGE
    assert 20_000 < (DOCS / "images" / f"{name}.jpg").stat().st_size < 400_000
