"""Seeds of rendered scenes, and what each may be used for: no image has two uses.

Two seeds have no scene in common. What a training learns from, what selects its best epoch, what
calibrates its weights and what people chose by (the number of looks, the precision of a graph) are
of different seeds; and the figures that are published as final come from seeds that only ``ffpose
card --final`` renders, so that no training, epoch or calibration sees them. It always takes the
first of these: cards of earlier weights showed the same scenes, and their figures were known when
later weights were trained.

Two sets of one seed have the same attitudes and light, so they are no independent samples.
"""

from __future__ import annotations

from ffpose.errors import expect

TRAINING = range(1_000_000)
"""Seeds of training images; a configuration's ``data.seed`` is one of these."""

CHOICES = range(1_000_000, 2_000_000)
"""Held-out seeds of demos, studies, benchmarks and cards, by which people may choose."""

VALIDATION = range(3_000_000, 4_000_000)
"""Seeds of the images that select the best epoch of a training."""

CALIBRATION = range(4_000_000, 5_000_000)
"""Seeds of the images that calibrate distances, covariances and threshold."""

FINAL = range(5_000_000, 6_000_000)
"""Seeds of the final figures of model cards, which all take the first."""


def matching(purpose: range, seed: int) -> int:
    """Return the seed of ``purpose`` at the place that ``seed`` has among `TRAINING`.

    Examples:
        >>> matching(VALIDATION, 101)
        3000101
        >>> matching(TRAINING, 999_999 + 2)
        1
    """
    return purpose[seed % len(purpose)]


def refuse_final(seed: int) -> None:
    """Raise a ValueError for a seed of the final figures."""
    others = f"none of {FINAL.start} to {FINAL.stop - 1}, which ffpose card --final alone renders"
    expect(seed not in FINAL, "seed", others, seed)
