"""Worker processes: their environment, which is that of their start alone, and Ctrl-C."""

import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest

from ffpose.render.processes import in_processes

THREADS = "OMP_NUM_THREADS"


def test_runs_that_overlap_leave_the_environment_as_it_was(monkeypatch):
    monkeypatch.delenv(THREADS, raising=False)
    one, two = (in_processes(os.getenv, [THREADS] * 12, 2) for _ in range(2))
    assert (next(one), next(two)) == ("1", "1")
    assert THREADS not in os.environ  # other threads may start processes too
    assert [*one, *two] == ["1"] * 22
    assert THREADS not in os.environ


def test_threads_that_start_workers_at_once_leave_the_environment_as_it_was(monkeypatch):
    monkeypatch.delenv(THREADS, raising=False)
    submit = ProcessPoolExecutor.submit

    def slow(*args):
        time.sleep(0.05)  # of two threads, one would begin while the other has not ended
        return submit(*args)

    monkeypatch.setattr(ProcessPoolExecutor, "submit", slow)
    with ThreadPoolExecutor(2) as both:
        runs = both.map(lambda _: list(in_processes(os.getenv, [THREADS] * 5, 2)), range(2))
        assert list(runs) == [["1"] * 5] * 2
    assert THREADS not in os.environ


INTERRUPTED = """
import signal
from ffpose.render.processes import in_processes

if __name__ == "__main__":
    print(*in_processes(abs, range(4), 2))
else:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="holds no signal back")
def test_workers_leave_an_interrupt_to_their_parent_while_they_import(tmp_path):
    (tmp_path / "run.py").write_text(INTERRUPTED)
    command = [sys.executable, tmp_path / "run.py"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.stdout, done.stderr) == ("0 1 2 3\n", "")
