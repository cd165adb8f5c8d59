"""Files appear whole or not at all."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ffpose._internal.files import (
    atomic_write,
    expect_folder,
    expect_place,
    expect_writable,
    held,
    remove_leftovers,
    sha256,
)


def test_contents_are_on_the_disk_before_the_name_and_the_name_at_the_end(tmp_path, monkeypatch):
    """The calls in order: a file that is renamed before it is synced may come back empty."""
    target, calls = tmp_path / "report.json", []
    sync, replace = os.fsync, Path.replace

    def recorded_sync(descriptor):
        calls.append(("sync", Path(f"/proc/self/fd/{descriptor}").readlink().name))
        sync(descriptor)

    def recorded_replace(path, other):
        calls.append(("rename", path.name))
        return replace(path, other)

    monkeypatch.setattr(os, "fsync", recorded_sync)
    monkeypatch.setattr(Path, "replace", recorded_replace)
    with atomic_write(target, durable=False) as temporary:
        temporary.write_text("new")
    assert calls == [("rename", "report.json")]
    calls.clear()
    with atomic_write(target) as temporary:
        temporary.write_text("new")
    names = [("sync", "report.json"), ("rename", "report.json"), ("sync", tmp_path.name)]
    assert calls == names


def write_and_fail(path):
    with atomic_write(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("interrupted")


def test_the_file_appears_when_it_is_whole(tmp_path):
    target = tmp_path / "report.json"
    with atomic_write(target) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".json"
        assert not target.exists()
    assert target.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_an_interruption_leaves_what_was_there(tmp_path):
    target = tmp_path / "report.json"
    target.write_text("old")
    with pytest.raises(RuntimeError, match="interrupted"):
        write_and_fail(target)
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "best", tmp_path / "link.json"
    target.write_text("old")
    link.symlink_to("there/best")
    with atomic_write(link) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".json"
    assert link.is_symlink()
    assert target.read_text() == "new"


KILLED = """
import os, sys
from ffpose._internal.files import atomic_write
with atomic_write(sys.argv[1]) as path:
    path.write_text("half")
    os._exit(9)
"""


HOLDING = """
import os, sys, time
from ffpose._internal.files import held
with held(sys.argv[1]):
    if os.fork() == 0:
        print(os.getpid(), flush=True)
        time.sleep(60)  # longer than the other lives
        os._exit(0)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no locks of folders")
def test_a_folder_is_held_until_its_process_ends(tmp_path):
    command = [sys.executable, "-c", HOLDING, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as process:
        forked = int(process.stdout.readline())
        with pytest.raises(OSError, match=r"expected no other run at work in .*, got one"):
            held(tmp_path).__enter__()
        process.kill()
    for _ in range(2):
        with held(tmp_path):
            assert not list(tmp_path.iterdir())
    os.kill(forked, signal.SIGKILL)


def test_what_a_killed_process_leaves_is_removed_when_it_is_old(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "a.png")]
    assert subprocess.run(command, check=False).returncode == 9
    (left,) = tmp_path.iterdir()
    (tmp_path / ".other").mkdir()
    remove_leftovers(tmp_path)
    assert left.exists()  # it may be written to now
    for path in (left, tmp_path / ".other"):
        os.utime(path, (0, 0))
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".other"]


def test_the_folder_must_exist(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "missing" / "report.json"):
        pass


def test_a_file_is_no_folder_to_write_to(tmp_path):
    (tmp_path / "file").write_text("")
    for good in (tmp_path, tmp_path / "new", tmp_path / "new" / "deep"):
        expect_folder(good)
    for bad in (tmp_path / "file", tmp_path / "file" / "set"):
        with pytest.raises(NotADirectoryError, match=r"expected a folder, got the file .*file$"):
            expect_folder(bad)


def test_a_place_that_can_be_written_is_left_as_it_was(tmp_path):
    (tmp_path / "old.png").write_text("old")
    for path in (None, tmp_path / "new.png", tmp_path / "old.png"):
        expect_place(path)
    expect_writable(tmp_path)
    expect_writable(tmp_path / "new" / "deep")
    assert [path.name for path in tmp_path.iterdir()] == ["old.png"]


@pytest.mark.skipif(sys.platform != "linux", reason="there is no /proc")
def test_what_the_system_refuses_is_no_place_to_write_to():
    """Root may write to /proc, says `os.access`, and yet no file can be made there."""
    match = r"expected a folder that can be written to, got /proc: "
    for check, path in ((expect_writable, "/proc/new"), (expect_place, Path("/proc/new.png"))):
        with pytest.raises(OSError, match=match):
            check(path)


def test_no_file_is_written_without_a_folder_or_over_one(tmp_path):
    with pytest.raises(FileNotFoundError, match="expected an existing folder"):
        expect_place(tmp_path / "absent" / "a.png")
    with pytest.raises(OSError, match="expected a file to write, got"):
        expect_place(tmp_path)


def test_the_sha256_of_abc(tmp_path):
    """The example of FIPS 180-2, appendix B.1."""
    (tmp_path / "abc").write_bytes(b"abc")
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256(tmp_path / "abc") == expected
