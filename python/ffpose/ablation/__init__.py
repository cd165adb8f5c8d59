"""Ablations: one network changed in one place at a time, trained again at an equal budget.

`ffpose.ablation.study` says what a study is, `attitude`, `networks` and `paper` which there are,
`run` works one off, and `table` writes what it came to. Nothing here loads torch before a study
runs.
"""

from __future__ import annotations

from ffpose.ablation.attitude import ATTITUDE, FILTERS, MIXERS
from ffpose.ablation.networks import NETWORKS
from ffpose.ablation.paper import TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5
from ffpose.ablation.study import Published, Study, Variant

__all__ = ["STUDIES", "Published", "Study", "Variant", "get_study"]

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (ATTITUDE, FILTERS, MIXERS, NETWORKS, TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5)
}
"""The studies that there are, by name."""


def get_study(name: str) -> Study:
    """Return a study of `STUDIES`.

    Raises:
        ValueError: There is none of that name; the message lists the names.
    """
    if name not in STUDIES:
        raise ValueError(f"study: expected one of {', '.join(STUDIES)}, got {name!r}")
    return STUDIES[name]
