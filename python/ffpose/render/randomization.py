"""Domain randomisation: pictures that leave what is real, so that a network cannot lean on it.

Tobin et al. 2017, "Domain randomization for transferring deep neural networks from simulation to
the real world". All strengths are zero by default, which changes no pixel. Labels stay exact.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from ffpose.render.noise import fbm
from ffpose.render.vectors import Floats, column, rotate


@dataclass(frozen=True)
class Randomization:
    """How far each part of the picture may stray; a zero switches it off.

    Attributes:
        light: standard deviation of the sun's colour and of the Earth's light, in stops.
        exposure: standard deviation of the exposure, in stops, beside that of the sensor.
        background: share of the images that have coloured clouds in place of stars and Earth.
        materials: standard deviation of each material's colour and roughness, in stops.
    """

    light: float = 0.0
    exposure: float = 0.0
    background: float = 0.0
    materials: float = 0.0

    def __post_init__(self) -> None:
        if not all(0 <= strength < np.inf for strength in astuple(self)) or self.background > 1:
            raise ValueError(
                f"randomization: expected numbers of at least 0, background at most 1, got {self}"
            )

    @classmethod
    def of_strength(cls, strength: float) -> Randomization:
        """All parts together: 0 is none, 1 a stop of everything and no real background at all."""
        return cls(strength, strength, strength, strength)


def stops(spread: float, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Random factors about one whose logarithm to base 2 has the standard deviation `spread`."""
    return np.exp2(spread * rng.standard_normal(shape)).astype(np.float32)


def backdrop(rays: Floats, rng: np.random.Generator) -> Floats:
    """Light (3, N) along unit rays (3, N) of a wall of clouds in two random colours."""
    first, second = (column(rng.uniform(0.0, 1.0, 3)) for _ in range(2))
    scale = np.exp2(rng.uniform(1.0, 6.0))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    part = np.clip(0.5 + fbm(rotate(scale * turn, rays), 6, 0.6), 0, 1)
    result: Floats = first + (second - first) * part
    return result
