"""Signals that end this process, and those that others are to leave to it."""

import signal
import sys

import pytest

from ffpose._internal.signals import exit_on_sigterm, interrupts_held, signals_kept

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals end a process at once")


def test_sigterm_raises_in_the_block_alone():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended, exit_on_sigterm():
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before


def test_an_ignored_sigterm_stays_ignored():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with exit_on_sigterm():
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("caught", ["raised", "left", "another"])
def test_a_block_that_catches_what_a_signal_raises_ends_with_it(caught):
    reached = []

    def interrupted():
        with exit_on_sigterm(), signals_kept():
            try:
                signal.raise_signal(signal.SIGTERM)
            except BaseException:
                reached.append("the rest")
                if caught == "raised":
                    raise
                if caught == "another":
                    raise ValueError("a broken file") from None
        reached.append("what follows")

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with pytest.raises(SystemExit):
        interrupted()
    assert reached == ["the rest"]
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before


def test_an_interrupt_comes_when_the_block_has_ended():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    reached = []

    def interrupted():
        with interrupts_held():
            signal.raise_signal(signal.SIGINT)
            reached.append("the end")

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        signal.signal(signal.SIGINT, before)
    assert reached == ["the end"]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
