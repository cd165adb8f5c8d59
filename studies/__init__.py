"""Ablations: one network changed in one place at a time, trained again at an equal budget.

`studies.study` says what a study is, `mixers`, `networks` and `paper` which there are,
`run` trains and tests its variants, `table` writes the results. From the root of the repository:
``python -m studies NAME --out DIR``.
"""

from __future__ import annotations

from studies.mixers import MIXERS
from studies.networks import NETWORKS
from studies.paper import TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5
from studies.study import Published, Study, Variant

__all__ = ["STUDIES", "Published", "Study", "Variant"]

STUDIES: dict[str, Study] = {
    study.name: study for study in (MIXERS, NETWORKS, TABLE_1, TABLE_2, TABLE_3, TABLE_4, TABLE_5)
}
"""The studies that there are, by name."""
