from timeit import Timer

from ffpose.bench import timing
from ffpose.bench.timing import percentiles, take_turns


def test_percentiles_by_hand():
    found = percentiles([float(value) for value in range(100, -1, -1)])
    assert (found.p50, found.p95, found.p99, found.calls) == (50.0, 95.0, 99.0, 101)
    assert percentiles([2.0]).p99 == 2.0


def test_contenders_take_turns_and_the_first_call_of_each_is_dropped(monkeypatch):
    monkeypatch.setattr(timing, "FEWEST_TURNS", 2)
    monkeypatch.setattr(timing, "TURN", 3)
    order = []
    contenders = {
        name: Timer(lambda name=name: order.append(name), lambda: order.append("-"))
        for name in "ab"
    }
    found = take_turns(contenders, 0.0)
    assert "".join(order) == "-a-b" + "-a-b" + 2 * ("-a-a-a-a" + "-b-b-b-b")
    assert found["a"].calls == found["b"].calls == 2 * 3
