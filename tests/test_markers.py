"""A marker that no test wears promises tests that there are not."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_marker_is_worn():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    declared = {marker.partition(":")[0] for marker in options["markers"]}
    sources = "".join(path.read_text() for path in (ROOT / "tests").rglob("*.py"))
    assert declared <= set(re.findall(r"pytest\.mark\.(\w+)", sources))
