"""Textures as pyramids of linear light: each level averages four texels of the one before.

Averages are of light, not of codes, and weighted by alpha, so that a far surface has the mean color
of its texture (Williams 1983, "Pyramidal parametrics"). A pyramid has sides of powers of two; an
image of other sides is averaged by area.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import one_line

Floats = NDArray[np.float32]

BUDGET = 1 << 28
"""Most bytes of all textures of a spacecraft together; larger ones are averaged down."""

TEXEL_BYTES = 8
"""Four channels of 16 bits."""

MAX_SIDE = 4096
"""Most texels along a side of a texture."""

BAND_TEXELS = 1 << 20
"""Texels of an image that are decoded at once."""

REPEAT, MIRROR, CLAMP = range(3)
"""What lies beyond the border of a texture."""

Convert = Callable[[NDArray[np.uint8]], Floats]


def linear(code: ArrayLike) -> NDArray[np.float64]:
    """Return the linear light of sRGB values in 0…1."""
    value = np.asarray(code, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


class Source(NamedTuple):
    """Where the coordinates of a texture come from: a set, and KHR_texture_transform."""

    set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    def transformed(self, coordinates: NDArray[Any]) -> Floats:
        """Return coordinates (V, 2) scaled, then rotated, then moved.

        A ValueError if they are not finite.
        """
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        turn = np.array([[c, s], [-s, c]])
        with np.errstate(over="ignore", invalid="ignore"):
            placed = coordinates.astype(np.float64) * self.scale @ turn.T + self.offset
            result: Floats = placed.astype(np.float32)
        if not np.isfinite(result).all():
            raise ValueError("expected finite texture coordinates, got NaN or infinity")
        return result


@dataclass(frozen=True, eq=False)
class Pyramid:
    """Levels of a texture, (H, W, 4) each half as large as the one before, as float16.

    Attributes:
        texels: (N, 4) texels of all levels one after the other, row by row.
        width: Texels of the finest level to the right, a power of two.
        height: Texels of the finest level downward, a power of two.
        wrap: What lies beyond the border to the right and downward: REPEAT, MIRROR or CLAMP.
    """

    texels: NDArray[np.float16]
    width: int
    height: int
    wrap: tuple[int, int] = (REPEAT, REPEAT)

    def level(self, number: int) -> NDArray[np.float16]:
        """Return one level (H, W, 4)."""
        sides = _sides(self.width, self.height)
        start = sum(width * height for width, height in sides[:number])
        width, height = sides[number]
        return self.texels[start : start + width * height].reshape(height, width, 4)


def build_pyramid(
    image: Any, convert: Convert, most: int = MAX_SIDE, wrap: tuple[int, int] = (REPEAT, REPEAT)
) -> Pyramid:
    """Build the pyramid of a Pillow image, of which a band at a time is in memory as numbers.

    ``convert`` takes codes (N, W, 4) to values that may be averaged; the finest level has sides of
    at most ``most`` texels.
    """
    image = _eight_bits(image)
    width, height = (_power_of_two(side, most) for side in image.size)
    sides = _sides(width, height)
    texels = np.empty((sum(columns * lines for columns, lines in sides), 4), np.float16)
    pyramid = Pyramid(texels, width, height, wrap)
    finest = pyramid.level(0)
    rows = max(1, BAND_TEXELS * height // (image.width * image.height))
    edges = np.linspace(0, image.height, height + 1)
    for first in range(0, height, rows):
        part = edges[first : first + rows + 1]
        top, bottom = math.floor(part[0]), math.ceil(part[-1])
        codes = np.asarray(image.crop((0, top, image.width, bottom)).convert("RGBA"))
        values = averaged(convert(codes), np.linspace(0, image.width, width + 1), 1)
        finest[first : first + rows] = averaged(values, part - top, 0)
    for number in range(1, len(sides)):
        _halve(pyramid.level(number - 1), pyramid.level(number))
    return pyramid


def _halve(fine: NDArray[np.float16], coarse: NDArray[np.float16]) -> None:
    """Write the means of the next finer level's texels to a level, a band at a time."""
    down, across = fine.shape[0] // coarse.shape[0], fine.shape[1] // coarse.shape[1]
    rows = max(1, BAND_TEXELS // fine.shape[1] // down)
    for first in range(0, coarse.shape[0], rows):
        values: Floats = fine[first * down : (first + rows) * down].astype(np.float32)
        coarse[first : first + rows] = _mean(_mean(values, down, 0), across, 1)


def largest_side(sizes: Sequence[tuple[int, int]]) -> int:
    """Return the largest side of finest levels with which textures of these sizes fit `BUDGET`."""
    side = MAX_SIDE
    while side > 1:
        finest = [(_power_of_two(w, side), _power_of_two(h, side)) for w, h in sizes]
        texels = sum(columns * lines for each in finest for columns, lines in _sides(*each))
        if texels * TEXEL_BYTES <= BUDGET:
            break
        side //= 2
    return side


def averaged(values: Floats, edges: NDArray[np.float64], axis: int) -> Floats:
    """Return the means of cells between edges along an axis, whose values are constant by index."""
    count = values.shape[axis]
    cells = len(edges) - 1
    if np.array_equal(edges, np.arange(cells + 1) * (count // cells)):
        return _mean(values, count // cells, axis)
    sums = np.cumsum(values, axis=axis, dtype=np.float64)
    sums = np.insert(sums, 0, 0.0, axis=axis)
    low = np.minimum(edges.astype(np.intp), count - 1)
    shape = [1, 1, 1]
    shape[axis] = -1
    part = (edges - low).reshape(shape)
    at = sums.take(low, axis) * (1 - part) + sums.take(low + 1, axis) * part
    widths = np.diff(edges).reshape(shape)
    return np.asarray(np.diff(at, axis=axis) / widths, dtype=np.float32)


def _mean(values: Floats, step: int, axis: int) -> Floats:
    """Return the means of ``step`` values each along an axis, of which there is a multiple."""
    if step == 1:
        return values
    parts = values.swapaxes(0, axis)
    total = parts[::step].copy()
    for first in range(1, step):
        total += parts[first::step]
    total *= np.float32(1 / step)
    return total.swapaxes(0, axis)


def _sides(width: int, height: int) -> list[tuple[int, int]]:
    """Return width and height of each level, the last of one texel."""
    sides = [(width, height)]
    while sides[-1] != (1, 1):
        width, height = max(1, width // 2), max(1, height // 2)
        sides.append((width, height))
    return sides


def _power_of_two(side: int, most: int) -> int:
    """Return the power of two nearest to a side, at most ``most``."""
    return min(1 << round(math.log2(side)), most)


def _eight_bits(image: Any) -> Any:
    """Return an image of one channel of 16 or 32 bits as one of 8."""
    return image.point(lambda code: code / 256).convert("L") if image.mode[0] == "I" else image


class Key(NamedTuple):
    """What a pyramid is made of.

    Attributes:
        image: Number or name of the image in the file.
        convert: What turns its codes into values; for one pyramid always the same function.
        wrap: What lies beyond its border to the right and downward.
    """

    image: int | str
    convert: Convert
    wrap: tuple[int, int] = (REPEAT, REPEAT)


@dataclass(frozen=True)
class Texture:
    """A texture of a material.

    Attributes:
        image: Its values at every resolution.
        layer: Which of `Mesh.layers` has its coordinates.
    """

    image: Pyramid
    layer: int = 0


Slots = dict[str, tuple[Key, Source]]
"""What the textures of a material are made of, and where their coordinates come from, by field."""


class Pyramids:
    """Pyramids that all together fit in `BUDGET`, each made when it is first asked for.

    ``slots`` are those of all materials. ``opened`` opens an image of which Pillow has read the
    head: its pixels are gone when its pyramid is made.
    """

    def __init__(self, slots: Iterable[Slots], opened: Callable[[Any], Any]) -> None:
        self._opened = opened
        self._made: dict[Key, Pyramid] = {}
        wanted = dict.fromkeys(key for each in slots for key, _ in each.values())
        sizes = {image: opened(image).size for image in dict.fromkeys(key.image for key in wanted)}
        self._most = largest_side([sizes[key.image] for key in wanted])

    def textures(self, slots: Slots) -> tuple[dict[str, Texture], tuple[Source, ...]]:
        """Return a material's textures by field, and the sources of their layers of coordinates."""
        sources, found = dict[Source, int](), dict[str, Texture]()
        for field, (key, source) in slots.items():
            found[field] = Texture(self.get(key), sources.setdefault(source, len(sources)))
        return found, tuple(sources)

    def get(self, key: Key) -> Pyramid:
        """Return a pyramid; a DataError if its image cannot be decoded."""
        if key not in self._made:
            self._made[key] = self.build(key)
        return self._made[key]

    def build(self, key: Key, most: int = MAX_SIDE) -> Pyramid:
        """Return a pyramid of at most so many texels a side, which is not kept."""
        image = self._opened(key.image)
        try:
            return build_pyramid(image, key.convert, min(most, self._most), key.wrap)
        except (OSError, SyntaxError, ValueError) as error:
            text = f"expected texture {key.image!r} that can be decoded, got {one_line(error)}"
            raise DataError(text) from error
