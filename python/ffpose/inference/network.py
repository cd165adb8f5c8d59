"""What a network's file says of it, weights or graph, and how images become its input."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from ffpose.geometry import Camera
from ffpose.inference.source import find_source
from ffpose.preprocessing import Preprocessing
from ffpose.reprojection import Reprojection, agree

if TYPE_CHECKING:
    from ffpose.models import WeightsMetadata
    from ffpose.onnx.metadata import ModelMetadata

    Description: TypeAlias = WeightsMetadata | ModelMetadata


def describe(network: str | Path) -> Description:
    """Read the header of weights or of an exported graph.

    Args:
        network: As in `ffpose.inference.source.find_source`.

    Raises:
        FileNotFoundError: There is no such file or name.
        MissingExtraError: Weights are named, and the extra `pose` is not installed.
        ValueError: A folder holds several networks.
        ffpose.DataError: The file is not one that ffpose wrote, was altered, or is newer.
    """
    source = find_source(network)
    if source.is_graph:
        from ffpose.onnx.metadata import read_model_metadata

        return read_model_metadata(source.path)
    from ffpose.models import read_metadata

    return read_metadata(source.path)


def choose_preprocessing(
    metadata: Description, camera: Camera | None, *, reproject: bool
) -> Preprocessing:
    """Return the preprocessing from images of a set to the network's input.

    Args:
        metadata: Header of the network.
        camera: Camera of the images, with their size; None for images of several.
        reproject: Reproject images of a camera other than the weights' into the network's view.

    Raises:
        ValueError: The camera differs from the weights', and ``reproject`` is false; or the images
            are of several, and the weights of one.
    """
    plain, view = metadata.preprocessing, metadata.config.view_camera
    if view is None:
        return plain
    if camera is None:
        raise ValueError("expected images of the weights' camera, got a set of several cameras")
    if agree(plain.camera(camera), view):
        return plain
    if reproject:
        return Reprojection.of(plain, camera, view)
    expected = plain.image_camera(view, camera.width, camera.height)
    raise ValueError(
        f"expected images of the weights' camera, {expected}, got a set of {camera}; "
        "--reproject turns them into the network's view"
    )
