"""README and documentation promise; this runs, or at least parses, what they promise.

Blocks of ``python`` are run by themselves; each call of ffpose in a block of ``sh`` is given to its
parser as it stands. ``test_page_commands`` runs these in small, and between them the blocks of
``py``, which need what the commands before them leave.
"""

import importlib
import re
import subprocess
import tomllib
from dataclasses import fields

import pytest

from benchmarks.__main__ import build_parser as benchmarks_parser
from ffpose._internal.info import main as info
from ffpose.cli import COMMANDS, build_parser, words_of
from ffpose.imaging.transforms import Augmentation
from pages import DOCS, ROOT, TEXTS, code_blocks
from shell_lines import calls
from studies.__main__ import build_parser as studies_parser

MAKEFILE = (ROOT / "Makefile").read_text()
OTHERS = {"--cpus-per-task", "--array", "--target"}
"""Options of other programs that the pages name."""
PROGRAMS = {"benchmarks": benchmarks_parser(), "studies": studies_parser()}
"""Parsers of what ``python -m`` runs."""


def blocks(*languages):
    """Return each code block of these languages, named by its page and number."""
    return [
        pytest.param(code, id=f"{name}-{number}")
        for name, text in TEXTS.items()
        for number, code in enumerate(code_blocks(text, *languages), start=1)
    ]


def prose(text):
    """Return a page without its code blocks."""
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def in_pages(pattern):
    """Return what a pattern finds in the pages, with the page of each."""
    return sorted({(name, found) for name, text in TEXTS.items() for found in pattern(text)})


def matches(pattern):
    """Return the matches of a pattern in the pages, with the page of each."""
    return in_pages(lambda text: re.findall(pattern, text))


@pytest.mark.parametrize("code", blocks("python"))
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "page.md", "exec"), {"__name__": "page"})


@pytest.mark.parametrize("block", blocks("sh"))
def test_shell_blocks_are_valid(block):
    subprocess.run(["bash", "-n"], input=block, text=True, check=True)
    for option, *programs in calls(block, "python"):
        if option == "-m":
            module, *words = programs
            PROGRAMS[module].parse_args(words)
        else:
            assert option == "-c"
            compile(programs[0], "page.md", "exec")


WRITTEN = {"runs/satellite/second/config.yaml": "configs/dragon.yaml"}
"""Files that an earlier command of a page writes, and such a file of the checkout."""


@pytest.mark.parametrize("block", blocks("sh"))
def test_commands_of_ffpose_parse(block, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    for name, *words in calls(block, "ffpose"):
        if name == "info":
            assert info(words) == 0
        else:
            words = [WRITTEN.get(word, word) for word in words]
            build_parser(name).parse_args(words_of(name, words))


def test_every_page_for_users_has_something_to_run():
    shown = {block.id.rpartition("-")[0] for block in blocks("python", "sh")}
    prose_only = {"docs/results.md"}
    pages = {name for name in TEXTS if not name.startswith("docs/reference/")}
    assert shown == pages - prose_only


@pytest.mark.parametrize(("page", "target"), matches(r"(?m)(?:`|^)make ([a-z-]+)"))
def test_make_targets_exist(page, target):
    assert re.search(rf"^{target}:.*## ", MAKEFILE, flags=re.MULTILINE)


@pytest.mark.parametrize(("page", "extras"), matches(r"(?:\.whl\)?|'ffpose)\[([a-z,]+)\]"))
def test_extras_exist(page, extras):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(extras.split(",")) <= set(project["optional-dependencies"])


def subparsers(parser):
    (actions,) = (each.choices for each in parser._subparsers._group_actions)
    return actions.values()


def test_options_in_the_text_exist():
    known = {
        option
        for name in COMMANDS
        for option in re.findall(r"--[\w.-]+", build_parser(name).format_help())
    }
    known |= {f"--data.augmentation.{f.name.replace('_', '-')}" for f in fields(Augmentation)}
    parsers = [studies_parser(), *subparsers(benchmarks_parser())]
    known |= {name for each in parsers for name in re.findall(r"--[\w.-]+", each.format_help())}
    onboard = (ROOT / "crates/ffpose-onboard/src/options.rs").read_text()
    known |= set(re.findall(r"\"(--[\w-]+)\"", onboard))
    named = in_pages(lambda text: re.findall(r"`(--[a-z][\w.-]*)[^`]*`", prose(text)))
    assert len(named) > 20
    assert [(page, option) for page, option in named if option not in known | OTHERS] == []


@pytest.mark.parametrize(
    ("page", "target"), matches(r"\]\(((?!http)[^)\s]+)\)|src=\"((?!http)[^\"]+)\"")
)
def test_links_and_pictures_exist(page, target):
    path, _, anchor = "".join(target).partition("#")
    file = ROOT / page if not path else (ROOT / page).parent / path
    assert file.is_file()
    if anchor:
        headings = re.findall(r"^#+ (.*)$", prose(file.read_text()), flags=re.MULTILINE)
        assert anchor in {re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in headings}


@pytest.mark.parametrize(
    ("page", "text"), matches(r"!\[([^]]*)\]\(") + matches(r"<img(?![^>]*alt=\"\w)()")
)
def test_pictures_have_an_alternative_text(page, text):
    assert len(text) > 20


@pytest.mark.parametrize(("page", "name"), matches(r"(?m)^::: ([\w.]+)$"))
def test_the_reference_names_what_exists(page, name):
    module, _, attribute = name.rpartition(".")
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        assert hasattr(importlib.import_module(module), attribute)


def test_every_page_is_in_the_navigation():
    named = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text()))
    assert named == {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
