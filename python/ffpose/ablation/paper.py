"""The ablations of the paper: Tables 1 to 3 of Ye et al., Sensors 2023, 23, 8633, section 4.4.

Whole images, the network and the three stages as published. The paper's numbers are of URSO
(``sets`` of `ffpose.ablation.run.ablate`); on rendered scenes they stand beside for orientation.
"""

from __future__ import annotations

from pathlib import Path

from ffpose.ablation.study import Published, Study, Variant
from ffpose.training.config import DataConfig, TrainConfig
from ffpose.training.stages import PAPER_STAGES

BASE = TrainConfig(
    data=DataConfig(
        "scenes",
        Path("views"),
        scene="soyuz_hard",
        count=4000,
        validation=100,
        seed=202,
        cache=True,
        workers=2,
    ),
    out=Path(),
    model="base",
    stages=PAPER_STAGES,
)

NOTES = (
    "The paper's numbers are means over URSO's images, its milliseconds those of its own machine."
)

TABLE_1 = Study(
    name="table1",
    about="Widths of the generated perceptrons for translation and orientation, at N = 5.",
    base=BASE,
    variants=tuple(
        Variant(
            f"{translation}-{orientation}",
            f"{translation} for translation, {orientation} for orientation",
            {
                "model_fields": {
                    "depth": 5,
                    "translation_mlp_dim": translation,
                    "orientation_mlp_dim": orientation,
                }
            },
            paper,
        )
        for translation, orientation, paper in (
            (128, 128, Published(0.8956, 6.3023)),
            (128, 256, Published(0.8735, 5.8025)),
            (256, 256, Published(0.8546, 6.1258)),
        )
    ),
    notes=f"{NOTES} Its text gives the best translation to 128/256, its table to 256/256.",
)

TABLE_2 = Study(
    name="table2",
    about="The number N of filterformer blocks in each branch.",
    base=BASE,
    variants=tuple(
        Variant(f"n{depth}", f"N = {depth}", {"model_fields": {"depth": depth}}, paper)
        for depth, paper in (
            (3, Published(1.0125, 6.5437, 61.61)),
            (4, Published(0.9233, 5.9961, 64.89)),
            (5, Published(0.8735, 5.8025, 68.11)),
            (6, Published(0.8155, 5.3566, 71.46)),
            (7, Published(0.7541, 5.2023, 74.73)),
            (8, Published(0.7623, 5.3562, 78.01)),
            (9, Published(0.7496, 5.3534, 81.49)),
        )
    ),
    notes=NOTES,
)

SCENES = {
    "soyuz_easy": (Published(0.4918, 4.6122), Published(0.5103, 5.1259)),
    "soyuz_hard": (Published(0.7541, 5.2023), Published(0.7283, 6.3654)),
    "dragon_hard": (Published(0.8160, 5.5256), Published(0.8076, 7.9168)),
}
"""Table 3: with filter, without."""

TABLE_3 = Study(
    name="table3",
    about="With and without the filter (FilterformerPose, TransformerPose), on three scenes.",
    base=BASE,
    variants=tuple(
        Variant(
            f"{scene}-{filter}",
            f"{network} on {scene}",
            {"data": {"scene": scene}, "model_fields": {"filter": filter}},
            paper,
        )
        for scene, numbers in SCENES.items()
        for (network, filter), paper in zip(
            (("FilterformerPose", "tokens"), ("TransformerPose", "none")), numbers, strict=True
        )
    ),
    notes=NOTES,
)
