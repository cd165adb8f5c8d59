"""Properties that are computed once, by whichever thread or process asks."""

import os
import signal
import threading
from dataclasses import FrozenInstanceError, dataclass

import pytest

from ffpose._internal.cached import cached_property


@dataclass(frozen=True)
class Square:
    side: float
    asked: list[float]

    @cached_property
    def area(self) -> float:
        """Area of the square."""
        self.asked.append(self.side)
        return self.side**2


def test_it_is_computed_once_for_each_instance():
    asked = []
    squares = Square(2.0, asked), Square(3.0, asked)
    assert [square.area for square in squares * 2] == [4.0, 9.0, 4.0, 9.0]
    assert asked == [2.0, 3.0]


def test_it_is_a_property_of_frozen_instances_and_of_the_class():
    assert isinstance(Square.area, cached_property)
    assert Square.area.__doc__ == "Area of the square."
    with pytest.raises(FrozenInstanceError):
        Square(2.0, []).area = 5.0
    assert Square(2.0, []) == Square(2.0, [])


class Slow:
    """Has a value for which the first to ask, and nobody else, waits until all have asked."""

    def __init__(self):
        self.inside, self.go_on = threading.Event(), threading.Event()

    @cached_property
    def value(self):
        if not self.inside.is_set():
            self.inside.set()
            self.go_on.wait(60)
        return object()


def first_asked(slow):
    values = []
    thread = threading.Thread(target=lambda: values.append(slow.value))
    thread.start()
    assert slow.inside.wait(60)
    return thread, values


def test_threads_that_compute_it_at_once_get_one_value():
    slow = Slow()
    thread, values = first_asked(slow)
    value = slow.value
    slow.go_on.set()
    thread.join()
    assert values == [value]
    assert slow.value is value


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_child_forked_meanwhile_does_not_wait_for_the_thread_that_computes_it():
    slow = Slow()
    thread, _ = first_asked(slow)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            signal.alarm(20)  # where it waits, it ends by this signal
            _ = slow.value, Slow.value
            status = 0
        finally:
            os._exit(status)
    status = os.waitpid(child, 0)[1]
    slow.go_on.set()
    thread.join()
    assert os.waitstatus_to_exitcode(status) == 0
