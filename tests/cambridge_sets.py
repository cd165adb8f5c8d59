"""A scene of Cambridge Landmarks in small: images of noise with random labels."""

import numpy as np
from PIL import Image


def write_landmarks(scene):
    """Write twelve images to train on and four to test."""
    (scene / "seq1").mkdir(parents=True)
    generator = np.random.default_rng(0)
    for split, indices in (("train", range(12)), ("test", range(12, 16))):
        lines = ["Visual Landmark Dataset V1", "ImageFile, Camera Position [X Y Z W P Q R]", ""]
        for index in indices:
            pixels = generator.integers(0, 256, (36, 64, 3), dtype=np.uint8)
            Image.fromarray(pixels).save(scene / f"seq1/{index}.png")
            t, q = generator.uniform(-9, 9, 3), generator.standard_normal(4)
            numbers = " ".join(f"{x:.6f}" for x in [*t, *(q / np.linalg.norm(q))])
            lines.append(f"seq1/{index}.png {numbers}")
        (scene / f"dataset_{split}.txt").write_text("\n".join(lines) + "\n")
