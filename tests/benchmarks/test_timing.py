import time

import pytest

from benchmarks.timing import FEWEST_ROUNDS, Contender, interleave, summarize, time_calls


def test_contenders_take_turns():
    order = []
    contenders = {
        name: Contender(lambda name=name: (order.append(name), time.sleep(0.002))) for name in "ab"
    }
    result = interleave(contenders, seconds=0.011, warmup_seconds=0.0)
    assert result["a"].rounds == result["b"].rounds == FEWEST_ROUNDS
    turns = [name for name, each in result.items() for _ in range(each.inner)]
    assert order[-FEWEST_ROUNDS * len(turns) :] == turns * FEWEST_ROUNDS


def test_a_sleep_is_measured_as_long_as_it_is():
    result = interleave({"sleep": Contender(lambda: time.sleep(0.01))}, seconds=0.05)
    assert result["sleep"].lower >= 0.01
    assert result["sleep"].lower <= result["sleep"].median <= result["sleep"].upper


def test_what_prepares_a_call_is_done_before_each_and_not_timed():
    order = []
    contender = Contender(
        lambda: order.append("call"), lambda: (order.append("prepare"), time.sleep(0.01))
    )
    assert time_calls(contender, 3) < 0.01
    assert order == ["prepare", "call"] * 3


def test_quartiles_by_hand():
    timing = summarize([5.0, 1.0, 2.0, 4.0, 3.0], inner=7)
    assert (timing.lower, timing.median, timing.upper) == (2.0, 3.0, 4.0)
    assert (timing.rounds, timing.inner) == (5, 7)
    between = summarize([1.0, 2.0, 3.0, 4.0], inner=1)
    assert (between.lower, between.median, between.upper) == (1.75, 2.5, 3.25)


def test_nothing_to_time_is_refused():
    with pytest.raises(ValueError, match="expected at least 1 contender, got none"):
        interleave({}, 0.001)
