"""Signals that end this process."""

import signal
import sys

import pytest

from ffpose._internal.signals import exit_on_sigterm

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals end a process at once")


def test_sigterm_raises_in_the_block_alone():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as ended, exit_on_sigterm():
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is before
