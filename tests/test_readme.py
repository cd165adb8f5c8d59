"""The README promises; this runs what it promises."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from ffpose.cli import build_parser

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PYTHON = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
SHELL = "\n".join(re.findall(r"```(?:sh|bash|console)\n(.*?)```", README, flags=re.DOTALL))


@pytest.mark.parametrize("code", PYTHON, ids=lambda code: code.strip().splitlines()[0])
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_there_is_python_to_run():
    assert PYTHON


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\bmake ([a-z-]+)", README))))
def test_make_targets_exist(target):
    assert re.search(rf"^{target}:.*## ", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)


@pytest.mark.parametrize("command", sorted(set(re.findall(r"\bffpose ([a-z]+)\b", SHELL))))
def test_commands_exist(command):
    call = [sys.executable, "-m", "ffpose.cli", command, "--help"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", re.findall(r"^ffpose .*$", SHELL, flags=re.MULTILINE))
def test_command_lines_parse(line):
    _, name, *words = shlex.split(line)
    build_parser(name).parse_args(words)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"\]\(((?!http)[^)#]+)\)", README))))
def test_linked_files_exist(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize("path", sorted(set(re.findall(r'src="((?!http)[^"]+)"', README))))
def test_pictures_exist(path):
    assert (ROOT / path).exists()
