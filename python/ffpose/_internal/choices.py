"""Names of the layer variants that `ffpose.config` selects and `ffpose.nn` builds."""

from __future__ import annotations

from typing import Literal

FilterKind = Literal["tokens", "grid", "none"]
"""Filter of a filterformer block; see `ffpose.nn.make_filter`."""

NormPlace = Literal["pre", "post"]
"""Place of the normalization: before or after each sublayer."""

PositionKind = Literal["learned", "sinusoidal"]
"""Position code of the tokens; see `ffpose.nn.PositionCode`."""

PolarMixer = Literal["filter", "depthwise3", "depthwise7", "attention", "filterformer"]
"""What mixes the cells of a polar map; see `ffpose.nn.polar.PolarBlock`."""
