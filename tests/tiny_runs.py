"""Small random image sets and short trainings on them, for tests that need weights."""

import csv

import numpy as np
from PIL import Image

from ffpose.geometry import Pose
from ffpose.training import DataConfig, OptimizerConfig, TrainConfig

SIZE = (64, 48)
"""Width and height; 4:3, as the reader wants where there is no camera.json."""

MODEL_FIELDS = {
    "image_size": [64, 64],
    "depth": 1,
    "dim": 16,
    "heads": 2,
    "feed_forward": 16,
    "head_hidden": 16,
    "dropout": 0.1,
}


def random_pose(generator):
    q = generator.standard_normal(4)
    t = [*generator.uniform(-2, 2, 2), generator.uniform(8, 12)]
    return Pose(t, q / np.linalg.norm(q))


def write_set(root, train=10, val=4, test=6, seed=0):
    """Write an URSO set of noise with random labels."""
    generator = np.random.default_rng(seed)
    root.mkdir(parents=True)
    start, everything = 0, []
    for split, count in (("train", train), ("val", val), ("test", test)):
        names = [f"{index}_rgb.png" for index in range(start, start + count)]
        rows = [random_pose(generator).to_urso() for _ in names]
        for name in names:
            pixels = generator.integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
            Image.fromarray(pixels).save(root / name)
        (root / f"{split}_images.csv").write_text("".join(f"{name}\n" for name in names))
        write_rows(root / f"{split}_poses_gt.csv", rows)
        everything += rows
        start += count
    write_rows(root / "gt.csv", everything)
    return root


def write_rows(path, rows):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def train_config(root, out, **fields):
    """Two epochs of a network of the smallest size, with dropout and augmentation."""
    values = {
        "data": DataConfig("urso", root),
        "out": out,
        "model": "tiny",
        "model_fields": MODEL_FIELDS,
        "backbone_weights": "none",
        "epochs": 2,
        "batch_size": 4,
        "optimizer": OptimizerConfig(learning_rate=1e-3),
        "device": "cpu",
    }
    return TrainConfig(**(values | fields))
