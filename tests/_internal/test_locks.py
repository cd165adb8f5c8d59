"""Locks, in threads and in forked children."""

import os
import signal
import threading

import pytest

from ffpose._internal.locks import fork_safe_lock


def test_one_thread_holds_it_at_a_time():
    lock, entered = fork_safe_lock(), threading.Event()

    def enter():
        with lock:
            entered.set()

    thread = threading.Thread(target=enter)
    with lock:
        thread.start()
        assert not entered.wait(0.1)
    thread.join(60)
    assert entered.is_set()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_it_is_free_in_a_child_forked_while_it_is_held():
    lock = fork_safe_lock()
    with lock:
        child = os.fork()
        if child == 0:
            status = 1
            try:
                signal.alarm(20)  # where it waits, it ends by this signal
                with lock:
                    status = 0
            finally:
                os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
