"""How the images of a set become the input of a network, by what its file says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from ffpose.config import looks_twice
from ffpose.geometry import Camera
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import Reprojection, agree, bends

if TYPE_CHECKING:
    from ffpose.models import WeightsMetadata
    from ffpose.onnx.metadata import ModelMetadata

    Description: TypeAlias = WeightsMetadata | ModelMetadata


def choose_preprocessing(
    metadata: Description, camera: Camera | None, *, reproject: bool
) -> Preprocessing:
    """Return the preprocessing from images of a set to the network's input.

    Args:
        metadata: Header of the network.
        camera: Camera of the images, with their size; None for images of several.
        reproject: Reproject images of a camera other than the weights' into the network's view.

    Raises:
        ValueError: The camera differs from the weights', or has distortion, which a network with a
            second look does not know, and ``reproject`` is false; or the images are of several, and
            the weights of one.
    """
    plain, view = metadata.preprocessing, metadata.config.view_camera
    if view is None:
        return plain
    if camera is None:
        raise ValueError("expected images of the weights' camera, got a set of several cameras")
    bent = looks_twice(metadata.config) and bends(camera)
    if agree(plain.camera(camera), view) and not bent:
        return plain
    if reproject:
        return Reprojection.of(plain, camera, view)
    if bent:
        raise ValueError(
            f"expected images of a camera without distortion, got a set of {camera}; "
            "--data.undistort takes it out"
        )
    expected = plain.image_camera(view, camera.width, camera.height)
    raise ValueError(
        f"expected images of the weights' camera, {expected}, got a set of {camera}; "
        "--reproject turns them into the network's view"
    )
