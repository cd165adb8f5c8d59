"""Rotations of an object that leave its look unchanged, and labels modulo them.

With such a rotation ``g``, in the object's frame, the attitudes ``q`` and ``q g`` give the same
image, and no network can tell them apart. Errors modulo the group are to the nearest of them, as
BOP's MSSD takes the least distance (Hodan et al., "BOP Challenge 2020", ECCVW 2020). About an axis
of any angle that one has a closed form; `STEPS` rotations stand for all where a list is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ffpose._internal.cached import cached_property
from ffpose._internal.files import read_json, shortened, write_json
from ffpose.errors import DataError, expect
from ffpose.geometry.rotations import FloatArray, conjugate, multiply, rotation_matrix

STEPS = 360
"""Rotations that stand for any angle about an axis in a list: one is within half a degree."""

MOST_FOLD = 60

MOST = 2 * MOST_FOLD
"""Rotations of the largest finite group: a prism's of 60 sides, about its axis and over it."""

ALIKE = np.cos(np.radians(0.25))
"""Product of unit quaternions or axes that are taken for one: half a degree apart, a quarter."""

REFERENCES = 500
"""Directions of which the best is the reference of canonical labels."""


class Axis(NamedTuple):
    """An axis of symmetry.

    Attributes:
        direction: ``(3,)`` in the object's frame, of any length.
        fold: The look is unchanged by turns of 360 degrees divided by it; 0 for any angle.
    """

    direction: tuple[float, float, float]
    fold: int

    @property
    def turns(self) -> FloatArray:
        """Rotations about it, unit quaternions ``(fold, 4)``, ``(STEPS, 4)`` for any angle."""
        count = self.fold or STEPS
        half = np.arange(count) * (np.pi / count)
        return np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * self.unit], axis=1)

    @property
    def unit(self) -> FloatArray:
        """Its direction ``(3,)``, of length one."""
        return np.asarray(self.direction, np.float64) / np.linalg.norm(self.direction)

    def __str__(self) -> str:
        direction = ", ".join(f"{value:.3g}" for value in np.round(self.direction, 3) + 0.0)
        return f"{f'{self.fold}-fold' if self.fold else 'any angle'} about ({direction})"


@dataclass(frozen=True)
class SymmetryGroup:
    """The group of rotations that some axes of symmetry generate; without axes, the identity.

    Attributes:
        axes: What generates it; at most one of them of any angle.

    Raises:
        ValueError: A number is out of range, or the axes go together in no finite group, or leave
            no attitude, as a sphere's.
    """

    axes: tuple[Axis, ...] = ()

    def __post_init__(self) -> None:
        for axis in self.axes:
            if len(axis.direction) != 3 or not 0 < np.linalg.norm(axis.direction) < np.inf:
                raise ValueError(f"axis: expected a direction of 3 numbers, got {axis.direction}")
            expect(0 <= axis.fold <= MOST_FOLD, "fold", f"0 to {MOST_FOLD}, 0 for any", axis.fold)
        _ = self._finite

    @cached_property
    def rotations(self) -> FloatArray:
        """All of its rotations, unit quaternions ``(G, 4)``, the identity first."""
        if self._free is None:
            return self._finite
        return multiply(self._finite[:, None], self._free.turns).reshape(-1, 4)

    @property
    def _free(self) -> Axis | None:
        """The axis of any angle, if there is one."""
        return next((axis for axis in self.axes if axis.fold == 0), None)

    @cached_property
    def _finite(self) -> FloatArray:
        """Rotations ``(F, 4)``, the identity first; times the turns about `_free` they are all."""
        found = np.array([[1.0, 0.0, 0.0, 0.0]])
        turns = np.concatenate([axis.turns[1:] for axis in self.axes if axis.fold] or [found])
        before = 0
        while before < len(found):
            before = len(found)
            for turn in turns:
                new = multiply(found, turn)
                there = (np.abs(new @ found.T) > ALIKE).any(axis=1)
                found = np.concatenate([found, new[~there]])
                expect(len(found) <= MOST, "axes", "those of a finite group", self)
        if self._free is None:
            return found
        along = rotation_matrix(found) @ self._free.unit @ self._free.unit
        others = [axis.unit @ self._free.unit for axis in self.axes if axis.fold == 0]
        if np.abs([*along, *others]).min() < ALIKE:
            raise ValueError(f"axes: expected some that leave an attitude, got {self}")
        # The finite ones turn about the axis or reverse it, and one that does stands for all.
        return np.concatenate([found[:1], found[along < 0][:1]])

    def _products(self, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the products ``(..., F)`` of turns ``(..., 4)`` with `_finite`, and with `_spun`.

        Of ``g (cos s + u sin s)``, about the axis ``u`` of any angle, the product with a turn is
        ``a cos s + b sin s`` with those of ``g`` and ``g u``: at most ``hypot(a, b)``, at ``s =
        atan2(b, a)``.
        """
        return turns @ self._finite.T, turns @ self._spun.T

    @cached_property
    def _spun(self) -> FloatArray:
        """Half turns about `_free` and then `_finite`, ``(F, 4)``; zero without such an axis."""
        unit = np.zeros(3) if self._free is None else self._free.unit
        return multiply(self._finite, np.array([0.0, *unit]))

    def has(self, rotations: FloatArray) -> bool:
        """Return whether unit quaternions ``(N, 4)`` are all among its own, within a degree."""
        nearest = np.hypot(*self._products(rotations)).max(axis=1)
        return bool((nearest > np.cos(np.radians(0.5))).all())

    def __len__(self) -> int:
        return len(self.rotations)

    def __str__(self) -> str:
        return "; ".join(map(str, self.axes)) or "none"

    def nearest(self, q_hat: FloatArray, q: FloatArray) -> FloatArray:
        """Return the attitudes ``q g`` of the looks of ``q (..., 4)`` nearest to ``q_hat``.

        ``q_hat`` are quaternions ``(..., 4)`` of any nonzero norm, ``q`` unit ones.
        """
        if len(self) == 1:
            return q
        a, b = self._products(multiply(conjugate(q), q_hat))
        chosen = np.hypot(a, b).argmax(axis=-1)
        a, b = (np.take_along_axis(each, chosen[..., None], axis=-1) for each in (a, b))
        spin = np.arctan2(b * np.copysign(1, a), np.abs(a))
        turn = self._finite[chosen] * np.cos(spin) + self._spun[chosen] * np.sin(spin)
        return multiply(q, turn)

    def folded(self, predicted: FloatArray, truth: FloatArray) -> FloatArray:
        """Return true poses ``(N, 7)`` with the attitude `nearest` to that of predicted ones."""
        return np.concatenate([truth[:, :3], self.nearest(predicted[:, 3:], truth[:, 3:])], axis=1)

    @cached_property
    def references(self) -> FloatArray:
        """A direction ``(3,)`` and where the rotations take it, ``(G, 3)``.

        Of all viewing directions of one look the one nearest to the first of these is canonical: of
        a direction ``d`` that nearest to row ``g`` is ``gᵀ d``. The reference is as far from its
        images as can be, so that few looks lie where two canonical labels meet.
        """
        number = np.arange(REFERENCES) + 0.5
        z = 1 - 2 * number / REFERENCES
        turn, radius = number * (np.pi * (3 - np.sqrt(5))), np.sqrt(1 - z * z)
        directions = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
        matrices = rotation_matrix(self.rotations)
        if len(self) == 1:
            return np.asarray(matrices @ directions[0])
        nearest = np.einsum("ni,gij,nj->gn", directions, matrices[1:], directions).max(axis=0)
        return np.asarray(matrices @ directions[nearest.argmin()])

    def to_json(self) -> list[dict[str, Any]]:
        """Return the axes as plain values; `from_json` is the inverse."""
        return [
            {"axis": list(map(float, axis.direction)), "fold": axis.fold or "any"}
            for axis in self.axes
        ]

    @classmethod
    def from_json(cls, axes: Any) -> SymmetryGroup:
        """Return the group of a list of ``{"axis": [x, y, z], "fold": 4}``, or fold "any"."""
        if not isinstance(axes, list):
            raise ValueError(f"axes: expected a list, got {shortened(axes)}")
        return cls(tuple(_axis(each) for each in axes))

    @classmethod
    def read(cls, path: Path) -> SymmetryGroup:
        """Read a file, ``{"axes": [...]}`` with what `from_json` takes; other keys are notes.

        Raises:
            FileNotFoundError: There is no such file.
            DataError: It is not JSON, or not such a document.
        """
        document = read_json(path)
        if not isinstance(document, dict) or "axes" not in document:
            raise DataError(f"expected an object with axes, got {shortened(document)}", path)
        try:
            return cls.from_json(document["axes"])
        except ValueError as error:
            raise DataError(str(error), path) from error

    @classmethod
    def chosen(cls, name: str) -> SymmetryGroup | None:
        """Return what a user's ``auto`` (None), ``none`` or file stands for; errors as `read`."""
        if name == "auto":
            return None
        return cls() if name == "none" else cls.read(Path(name))

    def write(self, path: Path, **notes: Any) -> None:
        """Write the file, with ``notes`` beside the axes."""
        write_json(path, {"axes": self.to_json(), **notes}, 1)


def _axis(value: Any) -> Axis:
    match value:
        case {"axis": [x, y, z], "fold": fold, **more} if not more and all(
            isinstance(each, int | float) and np.isfinite(each) for each in (x, y, z)
        ):
            if fold == "any":
                return Axis((x, y, z), 0)
            if isinstance(fold, int) and 2 <= fold <= MOST_FOLD:
                return Axis((x, y, z), fold)
    raise ValueError(
        f'axes: expected {{"axis": [x, y, z], "fold": 2 to {MOST_FOLD} or "any"}}, '
        f"got {shortened(value)}"
    )


IDENTITY = SymmetryGroup()
"""The group of an object all of whose attitudes look different."""
