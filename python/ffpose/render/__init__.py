"""Synthetic scenes: a spacecraft over the Earth, with exact labels.

An image is a pure function of (scene, seed, index, size), so sets can be made in any order, by any
number of processes, and on any number of machines. Needs the extra `render`.
"""

from ffpose.render.dataset.writer import Written, write_dataset
from ffpose.render.layers import (
    Keypoint,
    Layers,
    coordinates_limit,
    object_coordinates,
    render_layers,
)
from ffpose.render.renderer import Frame, label, render, render_empty
from ffpose.render.scene import SCENES, Scene
from ffpose.render.scene_file import SceneFile, find_scene, read_scene_file
from ffpose.render.shading.randomization import Randomization
from ffpose.render.shading.sensor import Sensor
from ffpose.render.spacecraft.meshfile import Up, load_craft

__all__ = [
    "SCENES",
    "Frame",
    "Keypoint",
    "Layers",
    "Randomization",
    "Scene",
    "SceneFile",
    "Sensor",
    "Up",
    "Written",
    "coordinates_limit",
    "find_scene",
    "label",
    "load_craft",
    "object_coordinates",
    "read_scene_file",
    "render",
    "render_empty",
    "render_layers",
    "write_dataset",
]
