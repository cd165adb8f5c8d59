"""The library that was built holds the vector code that its speed comes from.

That no kernel calls what was not inlined is checked where there are symbols, in the Rust tests.
"""

import platform
import re
import shutil
import subprocess

import pytest

from ffpose import _rust

FUSED = re.compile(r"\tvfn?m(?:add|sub)\d+(p[sd]) .*%([yz]mm)")


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="reads x86 machine code")
@pytest.mark.skipif(shutil.which("objdump") is None, reason="objdump, of binutils, is missing")
def test_avx2_of_both_precisions_and_avx512_of_single():
    command = ["objdump", "-d", "--no-show-raw-insn", _rust.__file__]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, errors="replace") as dump:
        found = {match.groups() for line in dump.stdout if (match := FUSED.search(line))}
    assert dump.returncode == 0
    assert found == {("ps", "ymm"), ("pd", "ymm"), ("ps", "zmm")}
