"""What the reader of a page has before its first command, in small.

Every page has a checkout of ffpose; some have weights of the reader's own, images, or a published
set in its own layout.
"""

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image

from cambridge_sets import write_landmarks
from ffpose.geometry import URSO_CAMERA
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.models import build_network
from speedplus_sets import write_speedplus
from tiny_runs import SIZE, random_pose, write_set

ROOT = Path(__file__).parents[1]
VIEW = URSO_CAMERA.resized(*SIZE)
"""The camera of small images in URSO's layout, which have no camera.json."""

POSENET = {"backbone": "compact_resnet_narrow", "reduction": 16}
FILTERFORMER = {
    "backbone": "compact_resnet_narrow",
    "translation_reduction": 16,
    "orientation_reduction": 8,
    "depth": 1,
    "dim": 16,
    "heads": 2,
}
LOOKING = {
    "first_stride": 2,
    "object_size": [16, 96],
    "object_width": 32,
    "channels": [4, 8, 12],
    "blocks": [1, 1],
    "directions": 50,
    # An export takes as long as the network has looks.
    "looks": 1,
    "candidates": 1,
}
"""A network with a second look."""


def write_checkout(folder):
    """Write what the pages name of the sources."""
    (folder / "docs/images").mkdir(parents=True)
    shutil.copy(ROOT / "docs/images/soyuz_unseen.jpg", folder / "docs/images")
    shutil.copytree(ROOT / "configs", folder / "configs")


def write_weights(path, model, fields):
    """Write random weights of a fixed seed, with the camera of small images in their header."""
    torch.manual_seed(1)
    width, height = SIZE
    camera = (VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)
    fields = {**fields, "image_size": [height, width], "camera": camera}
    path.parent.mkdir(parents=True, exist_ok=True)
    network = build_network(model, backbone_weights="none", **fields)
    network.save_pretrained(path, preprocessing=Preprocessing((height, width)))


def write_filterformer(path):
    write_weights(path, "tiny", FILTERFORMER)


def write_looking(path):
    """Write weights of a network with a second look."""
    write_weights(path, "polar", LOOKING)


def write_picture(path, seed=0):
    width, height = SIZE
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def write_pictures(folder):
    for number in range(4):
        write_picture(folder / f"{number}.png", number)


def write_camera(path):
    """Write a camera of its own: of URSO's shape, but with a longer lens."""
    camera = {"width": 128, "height": 96, "fx": 90.0, "fy": 90.0, "cx": 64.0, "cy": 48.0}
    path.write_text(json.dumps(camera))


def write_mesh(path):
    """Write a box with a wing, no two sides of which look alike, in millimeters."""
    wing = trimesh.creation.box((600, 3000, 50))
    wing.apply_translation((300, 2000, 400))
    trimesh.util.concatenate([trimesh.creation.box((2000, 1500, 3000)), wing]).export(path)


def write_csv_set(folder):
    """Write labeled images as kind csv, and their camera."""
    width, height = SIZE
    generator = np.random.default_rng(5)
    for split, count in (("train", 6), ("val", 4), ("test", 2)):
        rows = ["image,tx,ty,tz,qw,qx,qy,qz"]
        for number in range(count):
            name = f"{split}-{number}.png"
            write_picture(folder / name, number)
            pose = random_pose(generator)
            rows.append(",".join([name, *map(str, [*pose.t, *pose.q])]))
        (folder / f"{split}.csv").write_text("\n".join(rows) + "\n")
    camera = {"width": width, "height": height, "fx": 40.0, "fy": 40.0, "cx": 32.0, "cy": 24.0}
    (folder / "camera.json").write_text(json.dumps(camera))


def write_stages(path):
    """Write two of the paper's stages, of an epoch each."""
    second = "{name: translation, epochs: 1, freeze: [backbone, orientation_branch]}"
    path.write_text(f"stages: [{{name: joint, epochs: 1}}, {second}]\n")


OF_PAGES = {
    "README.md": {"look.safetensors": write_looking},
    "docs/datasets.md": {"data/speedplus": partial(write_speedplus, count=4)},
    "docs/deployment.md": {
        "look.safetensors": write_looking,
        "runs/small/best.safetensors": write_filterformer,
        "calibration_images": write_pictures,
        "images": write_set,
    },
    "docs/models.md": {"image.png": write_picture},
    "docs/network.md": {
        "URSO/soyuz_hard": write_set,
        "Cambridge/KingsCollege": write_landmarks,
        "image.png": write_picture,
        "camera.json": write_camera,
    },
    "docs/onboard.md": {"look.safetensors": write_looking},
    "docs/own-spacecraft.md": {
        "satellite.glb": write_mesh,
        "camera.json": write_camera,
        "image.png": write_picture,
        "real": write_csv_set,
    },
    "docs/scenes.md": {"camera.json": write_camera, "satellite.glb": write_mesh},
    "docs/training.md": {
        "URSO/soyuz_hard": write_set,
        "stages.yaml": write_stages,
        "real": write_csv_set,
    },
}
"""For each page the files and folders that its reader has, and what writes them."""


def write_files(page, folder):
    """Write what the reader of a page has."""
    write_checkout(folder)
    for name, write in OF_PAGES.get(page, {}).items():
        write(folder / name)
