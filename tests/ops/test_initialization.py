"""What the extension asks of the machine is asked as it is loaded: a fork finds nobody at it."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest


def exit_code(code):
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", code], start_new_session=True
    ) as process:
        try:
            return process.wait(timeout=120)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # also a child that hangs


def test_the_instruction_set_is_chosen_at_import():
    assert (
        exit_code("""
import os
from ffpose import _rust
os.environ["FFPOSE_ISA"] = "abacus"
assert _rust.isa() in _rust.isas()
""")
        == 0
    )


# Threads make the first calls of the process while it forks.
FORK_DURING_FIRST_CALLS = """
import os, sys, threading
import numpy as np
from ffpose import _rust
x, weight = np.ones((4, 6, 8), np.float32), np.ones((6, 5, 2), np.float32)
start = threading.Barrier(3)
def call():
    start.wait()
    _rust.spectral_filter(x, weight, "tokens")
threads = [threading.Thread(target=call) for _ in range(2)]
for thread in threads:
    thread.start()
start.wait()
child = os.fork()
if child == 0:
    y = _rust.spectral_filter(x + 1, weight + 1, "tokens")
    os._exit(0 if np.isfinite(y).all() else 1)
code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
for thread in threads:
    thread.join()
sys.exit(code)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_child_forked_during_first_calls_computes():
    for _ in range(5):
        assert exit_code(FORK_DURING_FIRST_CALLS) == 0
