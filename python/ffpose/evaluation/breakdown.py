"""Errors by condition: distance, lighting, background, and share of the object in the frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.datasets import Conditions
from ffpose.evaluation.metrics import PoseErrors, named_errors
from ffpose.geometry import FloatArray

Groups = Mapping[str, NDArray[np.bool_]]
"""Masks ``(N,)`` of the images in each group, by its name."""

BACK_LIT_DEG = 90.0
"""Sun angle to the viewing ray below which an image is back-lit, degrees."""


def breakdown(
    errors: PoseErrors, distance: FloatArray | None, conditions: Conditions | None
) -> dict[str, list[dict[str, Any]]]:
    """Return the median errors of groups of images, those without images left out.

    By condition: ``distance`` (terciles of the true distances ``(N,)``, meters; None for none) and,
    where conditions are known, ``lighting`` (sunlit images also as front-lit and back-lit),
    ``background`` and ``in_frame`` (share of the object in the frame). Each group has ``group``,
    ``images`` and ``median_`` errors named as in `ffpose.evaluation.metrics.PoseError`.
    """
    families = {} if distance is None else {"distance": _by_distance(distance)}
    if conditions is not None:
        back_lit = conditions.sun_angle_deg < BACK_LIT_DEG
        sunlit, share = ~conditions.eclipsed, conditions.visible_share
        families["lighting"] = {
            "sunlit": sunlit,
            "front-lit": sunlit & ~back_lit,
            "back-lit": sunlit & back_lit,
            "eclipse": ~sunlit,
        }
        families["background"] = {
            "Earth behind": conditions.earth_behind,
            "space behind": ~conditions.earth_behind,
        }
        families["in_frame"] = {
            "whole": share == 1,
            "90 % or more": (share >= 0.9) & (share < 1),
            "50 to 90 %": (share >= 0.5) & (share < 0.9),
            "less than 50 %": share < 0.5,
        }
    return {
        family: [_medians(name, errors, chosen) for name, chosen in groups.items() if chosen.any()]
        for family, groups in families.items()
    }


def _by_distance(distance: FloatArray) -> Groups:
    """Group images by terciles of the distance, named by the nearest and farthest image."""
    third = np.searchsorted(np.quantile(distance, [1 / 3, 2 / 3]), distance, side="left")
    groups = {}
    for place, name in enumerate(("near", "middle", "far")):
        chosen = third == place
        if chosen.any():
            of = distance[chosen]
            groups[f"{name}, {of.min():.1f} to {of.max():.1f} m"] = chosen
    return groups


def _medians(name: str, errors: PoseErrors, chosen: NDArray[np.bool_]) -> dict[str, Any]:
    medians = {
        f"median_{key}": float(np.median(values[chosen]))
        for key, values in named_errors(errors).items()
    }
    return {"group": name, "images": int(chosen.sum()), **medians}
