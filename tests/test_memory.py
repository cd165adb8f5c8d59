"""Memory of the filters: too little of it is an error, and not much is kept."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads what Linux tells")

# Each size of memory in a child of its own, which a failed allocation in Rust would abort.
LITTLE_MEMORY = """
import os, resource, sys
import numpy as np
from ffpose import _rust
shape, weight_shape, layout, most = {case}
x, weight = np.ones(shape, {dtype}), np.ones(weight_shape, {dtype})
filter_ = lambda: (
    _rust.spectral_filter(x, weight, layout),
    _rust.spectral_filter_backward(x, x, weight, layout, True, True),
)
outcomes = set()
room = 1 << 16
while room < most:
    child = os.fork()
    if child == 0:
        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + room, -1))
        try:
            filter_()
        except MemoryError:
            os._exit(3)
        except BaseException:
            os._exit(4)
        os._exit(0)
    outcomes.add(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    room = room * 4 // 3
print(sorted(outcomes))
"""
CASES = {
    "tokens of prime length": ((1, 1, 200003), (1, 100002, 2), "tokens", 1 << 28),
    "a grid of one row": ((1, 1, 100000, 16), (1, 50001, 16, 2), "grid", 1 << 28),
    "a grid of prime sides": ((1, 251, 257, 20), (251, 129, 20, 2), "grid", 1 << 27),
    "tokens of prime sides": ((1, 499, 503), (499, 252, 2), "tokens", 1 << 27),
    "few channels": ((2, 509, 521, 3), (509, 261, 3, 2), "grid", 1 << 28),
}


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["np.float32", "np.float64"])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_too_little_memory_is_an_error_at_any_point(case, dtype):
    code = LITTLE_MEMORY.replace("{case}", repr(case)).replace("{dtype}", dtype)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[0, 3]\n", done.stderr


MANY_THREADS = """
import threading
import numpy as np
import ffpose
x, weight = np.ones((1, 512, 512, 8), np.float32), np.ones((512, 257, 8, 2), np.float32)
def resident():
    with open("/proc/self/status") as file:
        line = next(line for line in file if line.startswith("VmRSS"))
    return int(line.split()[1]) << 10
called, leave = threading.Barrier(65), threading.Event()
def work():
    ffpose.spectral_filter(x, weight, "grid")
    called.wait()
    leave.wait()
before = resident()
threads = [threading.Thread(target=work) for _ in range(64)]
for thread in threads:
    thread.start()
called.wait()
print(resident() - before)
leave.set()
"""


def test_threads_together_keep_a_bounded_scratch():
    # the C library gives back at once what is freed, so that what stays is held
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": str(1 << 16)}
    command = [sys.executable, "-c", MANY_THREADS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    kept = max(64 << 20, (os.cpu_count() or 1) * (4 << 20))
    assert int(done.stdout) < kept + (32 << 20)  # and what 64 threads take besides


NO_THREADS = """
import numpy as np
import ffpose
rng = np.random.default_rng(3)
x, weight = rng.normal(size=(8, 28, 28, 64)), rng.normal(size=(28, 15, 64, 2))
alone = ffpose.spectral_filter(x, weight, "grid", num_threads=1)
np.testing.assert_array_equal(ffpose.spectral_filter(x, weight, "grid", num_threads=4), alone)
"""


def test_threads_that_the_system_refuses_are_done_without():
    environment = os.environ | {"RUST_MIN_STACK": str(1 << 46)}  # more than there are addresses
    subprocess.run([sys.executable, "-c", NO_THREADS], env=environment, check=True)
