"""A study of two tiny networks on an image set of noise, for the tests of studies."""

from dataclasses import replace
from pathlib import Path

from studies import Study, Variant
from tiny_runs import train_config, write_set

SCENE = "soyuz_easy"


def write_sets(root):
    """Write the one set that the study reads, below the folder of sets."""
    write_set(root / SCENE)
    return root


def tiny_study():
    """Two variants of two epochs each."""
    base = train_config(Path("views"), Path())
    base = replace(base, data=replace(base.data, scene=SCENE))
    return Study(
        "tiny",
        "Whether a study runs.",
        base,
        (
            Variant("grid", "grid filter"),
            Variant("none", "no filter", {"model_fields": {"filter": "none"}}),
        ),
    )
