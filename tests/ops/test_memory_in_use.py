"""Memory that one thread's call uses while another thread writes to it, or takes it away."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
import torch

import ffpose
from ffpose.ops import spectral_filter

SHAPE = (16, 28, 28, 64)  # a call of milliseconds


@pytest.fixture
def x():
    return torch.randn(SHAPE)


@pytest.fixture
def weight():
    return torch.randn(28, 15, 64, 2)


def together(first, second, seconds):
    """Call both again and again on two threads, and return the first exception, if there is one."""
    errors, end = [], time.monotonic() + seconds

    def repeat(call):
        while not errors and time.monotonic() < end:
            try:
                call()
            except Exception as error:
                errors.append(error)

    other = threading.Thread(target=repeat, args=[first])
    other.start()
    repeat(second)
    other.join()
    return errors[0] if errors else None


def test_two_threads_do_not_write_to_the_same_tensor(x, weight):
    out = torch.empty_like(x)
    error = together(
        lambda: spectral_filter(x, weight, "grid", out=out),
        lambda: spectral_filter(x, weight, "grid", out=out),
        seconds=20,
    )
    assert isinstance(error, ValueError)
    assert str(error) == (
        "out must be memory that no other thread uses meanwhile, "
        "got some that a call there writes to"
    )


def test_a_tensor_is_not_read_while_another_thread_filters_it_in_place(x, weight):
    error = together(
        lambda: spectral_filter(x, weight, "grid", out=x),
        lambda: spectral_filter(x[:8], weight, "grid"),
        seconds=20,
    )
    assert isinstance(error, ValueError)
    assert str(error) in (
        "x must be memory that no other thread writes to meanwhile, "
        "got some that a call there writes to",
        "out must be memory that no other thread uses meanwhile, got some that a call there reads",
    )


def test_the_backward_pass_is_no_exception(x, weight):
    alias = torch.from_numpy(x.numpy())  # in whose place autograd does not see what is written
    leaf = weight.clone().requires_grad_()
    error = together(
        lambda: spectral_filter(x, leaf, "grid").sum().backward(),
        lambda: spectral_filter(alias, weight, "grid", out=alias),
        seconds=20,
    )
    assert isinstance(error, ValueError)
    assert "that a call there" in str(error)


def test_tensors_and_arrays_of_the_same_memory(x, weight):
    error = together(
        lambda: spectral_filter(x, weight, "grid", out=x),
        lambda: ffpose.spectral_filter(x.numpy(), weight.numpy(), "grid"),
        seconds=20,
    )
    assert isinstance(error, ValueError)
    assert "that a call there" in str(error)


def test_threads_read_the_same_tensors_and_write_to_parts_of_one(x, weight):
    expected = spectral_filter(x, weight, "grid")
    out = torch.empty_like(x)
    error = together(
        lambda: spectral_filter(x[:8], weight, "grid", out=out[:8]),
        lambda: spectral_filter(x[8:], weight, "grid", out=out[8:]),
        seconds=0.5,
    )
    assert error is None
    assert torch.equal(out, expected)


def test_a_tensor_that_gets_other_memory_during_a_call_is_told(x, weight):
    memory, other = x.view(SHAPE), torch.randn(SHAPE)  # of both, so that none is freed
    swapped = [memory, other]

    def swap():
        swapped.reverse()
        x.set_(swapped[0])

    error = together(lambda: spectral_filter(x, weight, "grid"), swap, seconds=20)
    assert isinstance(error, RuntimeError)
    assert "x must keep its memory during a call, got other memory" in str(error)


# The child does not have the thread that uses `out`, or looks up what a process looks up once.
FORK_DURING_CALLS = """
import os, sys, threading, time, types
import torch
from ffpose.ops import spectral_filter
torch.set_num_threads(1)
x, weight = torch.randn(16, 28, 28, 64), torch.randn(28, 15, 64, 2)
out, looks_up, done = torch.empty_like(x), threading.Event(), threading.Event()
class Slow(types.ModuleType):
    @property
    def Tensor(self):
        looks_up.set()
        time.sleep(0.5)
        return torch.Tensor
def work():
    while not done.is_set():
        spectral_filter(x, weight, "grid", out=out)
def fork():
    child = os.fork()
    if child == 0:
        sys.modules["torch"] = torch
        spectral_filter(x, weight, "grid", out=out)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
sys.modules["torch"] = Slow("torch")
thread = threading.Thread(target=work)
thread.start()
assert looks_up.wait(20), "what is looked up at the first call is looked up elsewhere"
codes = [fork()]
sys.modules["torch"] = torch
codes += [fork() for _ in range(4)]
done.set()
thread.join()
sys.exit(max(codes, key=abs))
"""


# Memory that the other thread uses is refused before the fork and after it: it came meanwhile.
FORK_WITH_ARRAYS_IN_USE = """
import os, sys, threading
import numpy as np
import ffpose
x, weight = np.ones((64, 28, 28, 64), np.float32), np.ones((28, 15, 64, 2), np.float32)
out, done = np.empty_like(x), threading.Event()
def filters(images):
    try:
        ffpose.spectral_filter(x[:images], weight, "grid", out=out[:images])
        return True
    except ValueError as error:
        assert "that a call there writes to" in str(error), error
        return False
def work():
    while not done.is_set():
        filters(64)
def fork():
    child = os.fork()
    if child == 0:
        os._exit(0 if filters(1) else 1)
    meanwhile = not filters(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), meanwhile
thread = threading.Thread(target=work)
thread.start()
meanwhile = False
while not meanwhile:
    while filters(1):
        pass
    code, meanwhile = fork()
done.set()
thread.join()
sys.exit(code)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.parametrize(
    "code",
    [
        pytest.param(FORK_DURING_CALLS, marks=pytest.mark.slow),
        FORK_WITH_ARRAYS_IN_USE,
    ],
)
def test_a_forked_child_does_not_wait_for_its_parent_s_calls(code):
    command = [sys.executable, "-W", "ignore", "-c", code]
    with subprocess.Popen(command, start_new_session=True) as process:
        try:
            assert process.wait(timeout=120) == 0
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # also a child that hangs


def test_small_calls_are_checked_against_large_ones():
    out, weight = torch.randn(SHAPE), torch.randn(28, 15, 64, 2)
    small, small_weight = out.view(-1)[:48].view(6, 8), torch.randn(6, 5, 2)
    error = together(
        lambda: spectral_filter(out, weight, "grid", out=out),
        lambda: spectral_filter(small, small_weight),
        seconds=20,
    )
    assert isinstance(error, ValueError)
    assert "x must be memory that no other thread writes to" in str(error)


def test_what_a_failed_call_used_is_free_again(x, weight):
    out = np.empty(SHAPE, np.float32)
    for _ in range(2):
        with pytest.raises(ValueError, match="layout"):
            ffpose.spectral_filter(x.numpy(), weight.numpy(), "mesh", out=out)
    ffpose.spectral_filter(x.numpy(), weight.numpy(), "grid", out=out)
    np.testing.assert_array_equal(out, spectral_filter(x, weight, "grid").numpy())
