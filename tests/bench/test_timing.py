import gc
import time

import pytest

from ffpose.bench.timing import interleave


def test_rivals_take_turns():
    order = []
    rivals = {name: lambda name=name: (order.append(name), time.sleep(0.002)) for name in "ab"}
    result = interleave(rivals, seconds=0.006, rounds=3, warmup_seconds=0.0)
    assert result["a"].rounds == 3
    turns = [name for name, inner in result.items() for _ in range(inner.inner)]
    assert order[-3 * len(turns) :] == turns * 3


def test_a_sleep_is_measured_as_long_as_it_is():
    result = interleave({"sleep": lambda: time.sleep(0.01)}, seconds=0.05, rounds=5)
    assert result["sleep"].lower >= 0.01
    assert result["sleep"].lower <= result["sleep"].median <= result["sleep"].upper


def test_the_garbage_collector_is_put_back():
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError):
        interleave({"broken": lambda: 1 / 0})
    interleave({"fine": lambda: None}, seconds=0.001)
    assert gc.isenabled()


@pytest.mark.parametrize(("rivals", "rounds"), [({}, 5), ({"a": int}, 2)])
def test_nothing_to_time_is_refused(rivals, rounds):
    with pytest.raises(ValueError, match="expected at least 1 rival and 3 rounds"):
        interleave(rivals, rounds=rounds)
