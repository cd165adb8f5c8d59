"""What a process frees, and gets again."""

import platform
import subprocess
import sys

import pytest

AGAIN = """
import ctypes, resource
from ffpose.training.memory import keep_freed_memory

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

def faults(size=64 << 20):
    place = libc.malloc(size)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    libc.memset(place, 1, size)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    libc.free(place)
    return after - before

faults()
given_back = faults()
agreed = keep_freed_memory()
faults()
print(agreed, given_back, faults())
"""


def test_it_says_whether_malloc_agreed():
    code = "from ffpose.training.memory import keep_freed_memory as keep; print(keep(), keep())"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    first, second = run.stdout.split()
    assert first == second
    assert first in ("True", "False")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is glibc's")
def test_freed_memory_is_there_without_page_faults():
    run = subprocess.run([sys.executable, "-c", AGAIN], check=True, capture_output=True, text=True)
    agreed, given_back, kept = run.stdout.split()
    if agreed == "False":
        pytest.skip("this glibc takes no threshold so large")
    assert int(given_back) > 20  # 32 huge pages, or 16,384 small ones
    assert int(kept) < 5


def test_another_system_is_left_as_it_is(monkeypatch):
    from ffpose.training.memory import keep_freed_memory

    monkeypatch.setattr(sys, "platform", "darwin")
    assert keep_freed_memory() is False
