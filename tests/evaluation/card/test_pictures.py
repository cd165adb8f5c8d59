"""Pictures of no scene: pure, and of the statistics that they claim."""

from itertools import pairwise

import numpy as np
import pytest

from ffpose.evaluation.card.pictures import PICTURES, draw_picture

SIZE = (192, 128)


def pixels(kind, seed=7, index=0):
    return np.asarray(draw_picture(kind, seed, index, SIZE))


@pytest.mark.parametrize("kind", PICTURES)
def test_a_picture_is_pure_and_no_other_is_like_it(kind):
    np.testing.assert_array_equal(pixels(kind), pixels(kind))
    assert pixels(kind).shape == (128, 192, 3)
    assert pixels(kind).dtype == np.uint8
    assert not np.array_equal(pixels(kind), pixels(kind, index=1))
    assert not np.array_equal(pixels(kind), pixels(kind, seed=8))


def spectral_slope(kind):
    """Slope of the logarithm of the mean power over that of the frequency."""
    f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(192)).ravel()
    grays = [pixels(kind, index=index).mean(axis=2) for index in range(6)]
    power = sum(np.abs(np.fft.fft2(gray)) ** 2 for gray in grays).ravel()
    edges = np.geomspace(0.02, 0.4, 9)
    rings = [(f >= low) & (f < high) for low, high in pairwise(edges)]
    means = [np.log(power[ring].mean()) for ring in rings]
    return np.polyfit([np.log(f[ring].mean()) for ring in rings], means, 1)[0]


def test_clutter_has_the_spectrum_of_photographs_and_noise_none():
    """Natural images have power as f^-2, give or take a half (Field, 1987); white noise is flat."""
    assert -2.7 < spectral_slope("clutter") < -1.5
    assert abs(spectral_slope("noise")) < 0.3


def test_a_chart_is_mostly_paper():
    for index in range(4):
        colors, counts = np.unique(
            pixels("charts", index=index).reshape(-1, 3), axis=0, return_counts=True
        )
        paper = colors[counts.argmax()]
        assert paper.max() - paper.min() < 10
        assert counts.max() > 0.3 * counts.sum()
        assert len(colors) > 3
