"""A trained network in torch with its preprocessing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ffpose.geometry import Camera, FloatArray, Pose, Target, poses
from ffpose.models import PoseNetwork, load_network, read_metadata
from ffpose.preprocessing import Preprocessing
from ffpose.reprojection import expect_aspect, for_images


class Predictor:
    """A trained model with its preprocessing: predicts the pose in an image.

    Args:
        model: The network; it is put in evaluation mode.
        preprocessing: Conversion from image to network input.
        camera: Camera of the images, at any image size; None accepts images of any camera.
        locates: What the network locates. Where it is the camera, poses are those of the world in
            the camera frame.

    Attributes:
        model: The network.
        preprocessing: Conversion from image to network input.
        camera: Camera of the images, or None.
        locates: What the network locates.

    Examples:
        ``Predictor.from_weights("soyuz-easy")(Image.open("0_rgb.png").convert("RGB"))``
    """

    def __init__(
        self,
        model: PoseNetwork,
        preprocessing: Preprocessing,
        camera: Camera | None = None,
        locates: Target = "object",
    ) -> None:
        self.model = model.eval()
        self.preprocessing = preprocessing
        self.camera = camera
        self.locates: Target = locates

    @classmethod
    def from_weights(
        cls, weights: str | Path, *, camera: Camera | None = None, any_camera: bool = False
    ) -> Predictor:
        """Load weights.

        Weights that have no camera in their header accept any image, resized to their input.

        Args:
            weights: Weights file, or the name of shipped weights.
            camera: Camera of the images, which are reprojected to the network's view; None for
                the weights' own camera.
            any_camera: Resize any image to the network's input, as if taken by the weights' camera.

        Raises:
            FileNotFoundError: ``weights`` is neither a file nor a name of shipped weights.
            ValueError: The weights were altered or are of another kind of network, or both
                ``camera`` and ``any_camera`` are given, or neither for weights that were trained
                on undistorted images.
        """
        metadata = read_metadata(weights)
        preprocessing, expected = for_images(
            metadata.preprocessing,
            metadata.config.view_camera,
            metadata.camera,
            camera=camera,
            any_camera=any_camera,
            undistorted=metadata.undistorted,
        )
        return cls(load_network(weights), preprocessing, expected, metadata.locates)

    def __call__(self, image: Image.Image) -> Pose:
        """Predict the pose of the spacecraft in an RGB image, with uncertainty if available.

        Raises:
            ValueError: The aspect ratio of the image differs from its camera's.
        """
        return self.batch([image])[0]

    def batch(self, images: Sequence[Image.Image]) -> list[Pose]:
        """Predict the poses in RGB images, at least one, as one batch.

        Raises:
            ValueError: The aspect ratio of an image differs from its camera's.
        """
        for image in images:
            expect_aspect(self.camera, *image.size)
        with torch.inference_mode():
            prediction = self.model(torch.stack([self.preprocessing(i) for i in images]))
        outputs = {name: _rows(values) for name, values in prediction._asdict().items()}
        return poses(**outputs, locates=self.locates)


def _rows(values: Tensor) -> FloatArray:
    return np.asarray(values.double().cpu().numpy())
