"""One process alone works on what a claim stands for."""

import json
import os
import socket
import subprocess
import sys

import pytest

from ffpose.ablation.claims import claimed, claimed_in_turn
from ffpose.errors import DataError


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.lock"


def write_claim(path, host=None, pid=None):
    """Leave the claim of another process: of a living one of this host by default."""
    owner = {"host": host or socket.gethostname(), "pid": pid or os.getppid()}
    path.write_text(json.dumps(owner))


def dead_pid():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-S", "-c", ""])
    process.wait()
    return process.pid


def test_a_claim_names_its_process_while_it_works(path):
    with claimed(path) as mine:
        assert mine
        assert json.loads(path.read_text()) == {"host": socket.gethostname(), "pid": os.getpid()}
    assert not path.exists()


def test_a_claim_ends_where_the_work_fails(path):
    with pytest.raises(KeyboardInterrupt), claimed(path):
        raise KeyboardInterrupt
    assert not path.exists()


def test_the_claim_of_a_living_process_stands(path):
    write_claim(path)
    before = path.read_text()
    for steal in (False, True):
        with claimed(path, steal=steal) as mine:
            assert not mine
    assert path.read_text() == before


def test_the_claim_of_a_dead_process_of_this_host_is_taken_over(path):
    write_claim(path, pid=dead_pid())
    with claimed(path) as mine:
        assert mine


def test_the_claim_of_an_older_process_of_this_number_is_taken_over(path):
    write_claim(path, pid=os.getpid())
    with claimed(path) as mine:
        assert mine


def test_another_host_is_believed_to_live_unless_told_otherwise(path):
    write_claim(path, host="elsewhere", pid=dead_pid())
    with claimed(path) as mine:
        assert not mine
    with claimed(path, steal=True) as mine:
        assert mine


def test_a_claim_that_was_stolen_is_the_thiefs(path):
    with claimed(path):
        write_claim(path, host="thief")
    assert json.loads(path.read_text())["host"] == "thief"


def test_a_file_that_is_no_claim_is_named(path):
    path.write_text("{}")
    with (
        pytest.raises(DataError, match=r"run\.lock: expected the claim of a process"),
        claimed(path),
    ):
        pass


def test_work_in_turn_waits_for_the_one_before(path, monkeypatch):
    write_claim(path, host="elsewhere")
    waits = []

    def released(seconds):
        waits.append(seconds)
        if len(waits) == 2:
            path.unlink()

    monkeypatch.setattr("time.sleep", released)
    with claimed_in_turn(path):
        assert len(waits) == 2
        assert json.loads(path.read_text())["pid"] == os.getpid()
    assert not path.exists()
