"""Options of textures in MTL files: ``map_Kd -s 2 2 1 -o 0.5 0 0 -clamp on solar panel.png``."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ffpose.errors import DataError
from ffpose.render.spacecraft.textures import Source

logger = logging.getLogger(__name__)

OPTION = r"-[a-z]+(?:\s+(?:[-+.\d][-+.\de]*|on|off|[rgbmlz]))+\s+"
OPTIONS = re.compile(rf"^(?:{OPTION})+")
"""What stands before a texture's name."""


class Options(NamedTuple):
    """What options say of a texture, the coordinates of which count from the lower left.

    Attributes:
        scale: By what coordinates are multiplied: two shows the texture twice.
        offset: What is then added to them.
        clamp: Whether the border's texels continue outside, in place of the texture.
        multiplier: Of the lateral components of a normal map.
    """

    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False
    multiplier: float = 1.0

    def source(self) -> Source:
        """Return what is done to coordinates that count from the upper left."""
        across, down = self.offset[0], 1 - self.scale[1] - self.offset[1]
        return Source(offset=(across, down), scale=self.scale)


def texture_options(name: str, source: Path) -> Options:
    """Read the options before a texture's name; others than those of `Options` are told.

    A DataError if a value is not what its option has.
    """
    found = OPTIONS.match(name)
    options, unknown = Options(), list[str]()
    for part in re.findall(OPTION, found[0]) if found else ():
        key, *values = part.split()
        try:
            if key == "-s":
                options = options._replace(scale=_pair(values, 1.0))
            elif key == "-o":
                options = options._replace(offset=_pair(values, 0.0))
            elif key == "-clamp":
                options = options._replace(clamp={"on": True, "off": False}[values[0]])
            elif key == "-bm":
                options = options._replace(multiplier=_number(values[0]))
            else:
                unknown.append(part.strip())
        except (KeyError, ValueError):
            expected = "on or off" if key == "-clamp" else "finite numbers"
            text = f"expected {expected} after {key} of a texture, got {' '.join(values)!r}"
            raise DataError(text, source) from None
    if unknown:
        logger.warning("%s: options of a texture are left out: %s", source, " ".join(unknown))
    return options


def _pair(values: list[str], missing: float) -> tuple[float, float]:
    """Return the first two of up to three numbers."""
    across, up, *_ = [*map(_number, values), missing]
    return across, up


def _number(value: str) -> float:
    number = float(value)
    if abs(number) > float(np.finfo(np.float32).max):
        raise ValueError(value)
    return number
