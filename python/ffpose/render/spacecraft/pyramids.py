"""Pyramids of the images that a mesh file's materials use, of which one at a time is decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from ffpose.errors import DataError
from ffpose.render.spacecraft.meshassets import one_line
from ffpose.render.spacecraft.textures import (
    MAX_SIDE,
    REPEAT,
    Convert,
    Pyramid,
    build_pyramid,
    largest_side,
)


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


class Pyramids:
    """Pyramids that all together fit in `BUDGET`, each made when it is first asked for.

    ``keys`` are of all that will be. ``opened`` opens an image of which Pillow has read the head:
    its pixels are gone when its pyramid is made.
    """

    def __init__(self, keys: Iterable[Key], opened: Callable[[Any], Any]) -> None:
        self._opened = opened
        self._made: dict[Key, Pyramid] = {}
        wanted = dict.fromkeys(keys)
        sizes = {image: opened(image).size for image in dict.fromkeys(key.image for key in wanted)}
        self._most = largest_side([sizes[key.image] for key in wanted])

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
