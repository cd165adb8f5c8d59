"""What Linux forgives and Windows does not, read from the sources; mypy finds what it lacks."""

import ast
import errno
import io
import sys
from pathlib import Path

import pytest

from ffpose._internal.machine import worker_processes
from ffpose.cli import is_closed_pipe, main

PACKAGE = Path(__file__).parents[1] / "python/ffpose"


def is_text(call):
    """Whether a call reads or writes text, by the names of pathlib's methods."""
    match call.func:
        case ast.Attribute(attr="read_text" | "write_text"):
            return True
        case ast.Attribute(attr="open"):
            modes = [word.value for word in call.args if isinstance(word, ast.Constant)]
            newline = any(keyword.arg == "newline" for keyword in call.keywords)
            return newline or bool({"r", "w", "a", "x"} & {*modes})
    return False


@pytest.mark.parametrize(
    "path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_text_files_name_their_encoding(path):
    calls = [
        node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and is_text(node)
    ]
    named = [call for call in calls if any(word.arg == "encoding" for word in call.keywords)]
    assert [call.lineno for call in calls if call not in named] == []


def test_a_code_page_without_a_character_ends_no_command(monkeypatch):
    page = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", page)
    monkeypatch.setattr("ffpose.cli.run_command", lambda words: print("2.0° ± 0.1°") or 0)
    assert main(["info"]) == 0
    page.seek(0)
    assert page.read() == "2.0\\xb0 \\xb1 0.1\\xb0\n"


def test_a_reader_that_leaves_is_known_by_each_systems_error(monkeypatch):
    invalid = OSError(errno.EINVAL, "Invalid argument")
    assert [is_closed_pipe(error) for error in (BrokenPipeError(), invalid)] == [True, False]
    monkeypatch.setattr(sys, "platform", "win32")
    assert [is_closed_pipe(error) for error in (BrokenPipeError(), invalid)] == [True, True]
    assert not is_closed_pipe(OSError(errno.EINVAL, "Invalid argument", "a file"))
    assert not is_closed_pipe(ValueError("count: expected at least 1, got 0"))


def test_windows_starts_as_many_workers_as_it_can_wait_for(monkeypatch):
    assert [worker_processes(asked, 99) for asked in (2, 64, 128)] == [2, 64, 99]
    monkeypatch.setattr(sys, "platform", "win32")
    assert [worker_processes(asked, 99) for asked in (2, 64, 128)] == [2, 61, 61]
