"""A trained network in torch, and the way from images to its input."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ffpose.geometry import Camera, FloatArray, Pose, poses
from ffpose.models import FilterformerPose, read_metadata
from ffpose.preprocessing import Preprocessing
from ffpose.reprojection import expect_aspect, for_images


class Predictor:
    """A trained model and the way from an image to its input.

    Args:
        model: The network; it is put in evaluation mode.
        preprocessing: From image to network input.
        camera: The camera whose images the preprocessing takes, of any size; None: any image.

    Attributes:
        model: As given.
        preprocessing: As given.
        camera: As given.

    Example:
        ``Predictor.from_weights("soyuz-easy")(Image.open("0_rgb.png").convert("RGB"))``
    """

    def __init__(
        self, model: FilterformerPose, preprocessing: Preprocessing, camera: Camera | None = None
    ) -> None:
        self.model = model.eval()
        self.preprocessing = preprocessing
        self.camera = camera

    @classmethod
    def from_weights(
        cls, weights: str | Path, *, camera: Camera | None = None, any_camera: bool = False
    ) -> Predictor:
        """Load weights.

        Weights that do not know their camera take any image, resized to their input.

        Args:
            weights: The file, or the name of weights that come with the package.
            camera: The camera of the images to come, which are turned by geometry into the
                network's view; None: that of the weights.
            any_camera: Resize any image to the network's input, as if the weights' camera had
                taken it.

        Raises:
            FileNotFoundError: There is no such file or name.
            ValueError: The weights were altered, are of another kind of network, or both a camera
                and any are asked for.
        """
        metadata = read_metadata(weights)
        preprocessing, expected = for_images(
            metadata.preprocessing,
            metadata.config.view_camera,
            metadata.camera,
            camera=camera,
            any_camera=any_camera,
        )
        return cls(FilterformerPose.from_pretrained(weights), preprocessing, expected)

    def __call__(self, image: Image.Image) -> Pose:
        """Return the pose of the spacecraft in an RGB image, with its uncertainty if it has one.

        Raises:
            ValueError: The image has not the aspect ratio of its camera.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[Image.Image]) -> list[Pose]:
        """Return the poses of several RGB images, at least one, which the network sees at once.

        Raises:
            ValueError: As for one image.
        """
        for image in images:
            expect_aspect(self.camera, *image.size)
        with torch.inference_mode():
            prediction = self.model(torch.stack([self.preprocessing(i) for i in images]))
        return poses(**{name: _rows(values) for name, values in prediction._asdict().items()})


def _rows(values: Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
