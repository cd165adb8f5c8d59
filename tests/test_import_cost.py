"""``import ffpose`` brings in NumPy and the standard library, and nothing else."""

import subprocess
import sys

LIST_NEW_MODULES = """
import sys
before = set(sys.modules)
import ffpose
print(*sorted(set(sys.modules) - before))
"""


def test_importing_ffpose_imports_numpy_and_the_standard_library_alone():
    command = [sys.executable, "-I", "-c", LIST_NEW_MODULES]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    packages = {name.partition(".")[0] for name in done.stdout.split()}
    assert packages - sys.stdlib_module_names == {"ffpose", "numpy"}


def test_numpy_that_cannot_be_imported_says_so_itself():
    lines = "import sys; sys.modules['numpy'] = None; import ffpose"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ModuleNotFoundError: import of numpy halted")
