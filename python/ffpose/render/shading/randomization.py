"""Domain randomization: unrealistic variation that keeps a network from overfitting the renderer.

Tobin et al. 2017, "Domain randomization for transferring deep neural networks from simulation to
the real world". The default strengths are zero, which changes no pixel. Labels stay exact.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from ffpose.errors import expect
from ffpose.render.shading.patterns import fbm
from ffpose.render.shading.vectors import Floats, column, rotate


@dataclass(frozen=True)
class Randomization:
    """Strength of each kind of randomization; zero switches it off.

    Attributes:
        light: Standard deviation of the sun's color and of the Earth's light, in stops.
        exposure: Standard deviation of the exposure in stops, in addition to the sensor's.
        background: Fraction of images with colored clouds in place of stars and Earth.
        materials: Standard deviation of each material's color and roughness, in stops.
    """

    light: float = 0.0
    exposure: float = 0.0
    background: float = 0.0
    materials: float = 0.0

    def __post_init__(self) -> None:
        usable = all(0 <= strength < np.inf for strength in astuple(self)) and self.background <= 1
        expect(usable, "randomization", "numbers of at least 0, background at most 1", self)

    @classmethod
    def of_strength(cls, strength: float) -> Randomization:
        """Set every kind at once: 0 is none, 1 is one stop each and no real background.

        Raises:
            ValueError: ``strength`` is not from 0 to 1.
        """
        expect(0 <= strength <= 1, "randomize", "a number from 0 to 1", strength)
        return cls(strength, strength, strength, strength)


def stops(spread: float, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Draw random factors around one; their base-2 logarithm has standard deviation `spread`."""
    return np.exp2(spread * rng.standard_normal(shape)).astype(np.float32)


def backdrop(rays: Floats, rng: np.random.Generator) -> Floats:
    """Draw clouds in two random colors: radiance (3, N) along unit rays (3, N)."""
    first, second = (column(rng.uniform(0.0, 1.0, 3)) for _ in range(2))
    scale = np.exp2(rng.uniform(1.0, 6.0))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    part = np.clip(0.5 + fbm(rotate(scale * turn, rays), 6, 0.6), 0, 1)
    return np.asarray(first + (second - first) * part)
