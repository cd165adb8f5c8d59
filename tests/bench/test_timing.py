import gc
import time

import pytest

from ffpose.bench import timing
from ffpose.bench.timing import percentiles, take_turns, timed


def test_what_prepares_a_call_is_not_timed():
    order = []
    measure = timed(
        lambda: order.append("call"), lambda: (order.append("prepare"), time.sleep(0.01))
    )
    assert measure() < 0.01
    assert order == ["prepare", "call"]


def test_the_garbage_collector_is_put_back():
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError), timing.without_collection():
        _ = 1 / gc.isenabled()
    assert gc.isenabled()


def test_percentiles_by_hand():
    found = percentiles([float(value) for value in range(100, -1, -1)])
    assert (found.p50, found.p95, found.p99, found.calls) == (50.0, 95.0, 99.0, 101)
    assert percentiles([2.0]).p99 == 2.0


def test_contenders_take_turns_and_the_first_call_of_each_is_dropped(monkeypatch):
    monkeypatch.setattr(timing, "FEWEST_TURNS", 2)
    monkeypatch.setattr(timing, "TURN", 3)
    calls = []

    def measure(name):
        calls.append(name)
        return len(calls)

    samples = take_turns({name: lambda name=name: measure(name) for name in "ab"}, 0.0)
    assert "".join(calls) == "ab" + "ab" + 2 * ("aaaa" + "bbbb")
    assert samples == {"a": [6, 7, 8, 14, 15, 16], "b": [10, 11, 12, 18, 19, 20]}


def test_no_contender_is_refused():
    with pytest.raises(ValueError, match="at least 1 contender, got none"):
        take_turns({}, 1.0)
