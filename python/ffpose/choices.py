"""The words that choose a layer's form: what `ffpose.config` names and `ffpose.nn` builds."""

from __future__ import annotations

from typing import Literal

FilterKind = Literal["tokens", "grid", "none"]
"""Of a filterformer block: see `ffpose.nn.make_filter`."""

NormPlace = Literal["pre", "post"]
"""Whether sublayers normalise before or after themselves."""

PositionKind = Literal["learned", "sinusoidal"]
"""The code of a token's place: see `ffpose.nn.PositionCode`."""
