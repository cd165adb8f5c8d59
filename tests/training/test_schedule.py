import pytest

from ffpose.training.config import OptimizerConfig


def test_steps_of_the_paper():
    paper = OptimizerConfig()
    assert paper.rate(200 - 1e-9, 500) == 1e-4
    assert paper.rate(200, 500) == pytest.approx(1e-5)
    assert paper.rate(400, 500) == pytest.approx(1e-6)


def test_cosine_falls_from_the_full_rate_through_half_to_zero():
    cosine = OptimizerConfig(learning_rate=2.0, schedule="cosine")
    rates = [cosine.rate(position, 10) for position in (0, 5, 10)]
    assert rates == pytest.approx([2.0, 1.0, 0.0])


@pytest.mark.parametrize("schedule", ["step", "cosine"])
def test_warmup_rises_linearly_and_never_over_the_full_rate(schedule):
    config = OptimizerConfig(learning_rate=1.0, schedule=schedule, warmup_epochs=2.0)
    plain = OptimizerConfig(learning_rate=1.0, schedule=schedule)
    for position in (0.5, 1.0, 2.0, 3.0):
        expected = plain.rate(position, 100) * min(1, position / 2)
        assert config.rate(position, 100) == pytest.approx(expected)
