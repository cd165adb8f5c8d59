import json
import subprocess
import sys

from ffpose import __version__
from ffpose._internal.info import collect, extras, main
from ffpose.arrays import instruction_set

WITHOUT_EXTRAS = """
import importlib.abc, sys

class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"torch", "jsonargparse", "rich", "PIL", "matplotlib", "yaml"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
from ffpose.cli import main
sys.exit(main(sys.argv[1:]))
"""


def run_without_extras(*arguments):
    call = [sys.executable, "-c", WITHOUT_EXTRAS, *arguments]
    return subprocess.run(call, capture_output=True, text=True, check=False)


def test_facts():
    facts = collect()
    assert facts["ffpose"] == __version__
    assert facts["instruction_set"] == instruction_set()
    assert facts["threads"] >= 1
    assert {"torch", "pose", "render"} <= set(facts["extras"])


def test_extras_are_read_from_requirements():
    lines = [
        "numpy>=1.26",
        "torch ; extra=='torch'",
        "ffpose[torch]; extra == 'pose'",
        "no-such-package[with-extra]>=1 ; extra == 'pose'",
        'numpy>=1.26; extra == "pose"',
    ]
    found = extras(lines)
    assert list(found) == ["torch", "pose"]
    assert found["pose"]["no-such-package"] is None
    assert found["pose"]["numpy"] == collect()["numpy"]


def test_json_is_one_document(capsys):
    assert main(["--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ffpose"] == __version__


def test_works_with_numpy_alone():
    done = run_without_extras("info")
    assert done.returncode == 0, done.stderr
    assert __version__ in done.stdout


def test_another_command_names_the_missing_extra_in_one_line():
    done = run_without_extras("train")
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "pip install 'ffpose[pose]'" in done.stderr
