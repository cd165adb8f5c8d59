"""Labeled images as a torch dataset; each kind of folder has a reader module of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from torch import Tensor
from torch.utils.data import Dataset

from ffpose.datasets.cache import cached_frames
from ffpose.datasets.records import Record
from ffpose.geometry import Camera, DistortedCamera, FloatArray, Pose, Target, camera_pose
from ffpose.imaging.preprocessing import Preprocessing, planes
from ffpose.imaging.transforms import Augmentation, crop_turn, random_window, turn_camera

Part = str
"""Part of a set: the name of a split, or ``"all"`` for all of its splits joined."""


class Reader(Protocol):
    """Interface of the module that reads one kind of dataset."""

    def splits(self, root: Path) -> list[str]:
        """Return the splits that the folder contains.

        Raises:
            FileNotFoundError: The folder does not exist, or lists no split.
            NotADirectoryError: ``root`` is a file.
        """

    def read(self, root: Path, split: str) -> list[Record]:
        """Return the images of a split, with converted labels and their cameras.

        Where the labels are poses of the camera each record says so (`Record.target`).

        Raises:
            ValueError: ``split`` is not in such sets.
            FileNotFoundError: The folder, or a file that lists the split, does not exist.
            NotADirectoryError: The folder is a file.
            DataError: A name, label or camera is invalid, or an image is missing or listed twice;
                the error names file and line.
        """


class Sample(NamedTuple):
    """One sample; a DataLoader collates samples into a Sample of batches.

    Attributes:
        image: Standardized image ``(3, h, w)``, float32.
        translation: Translation ``(3,)`` in meters, float32, or what the set locates in its place
            (`PoseDataset`).
        orientation: Unit quaternion ``(w, x, y, z)``, ``w >= 0``, float32 ``(4,)``.
        index: Index of the sample in the dataset.
        intrinsics: ``(fx, fy, cx, cy)`` of the camera that sees ``image``, in its pixels; float64
            ``(4,)``. The camera's distortion, if it has any, is that of ``PoseDataset.records``.
    """

    image: Tensor
    translation: Tensor
    orientation: Tensor
    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    intrinsics: Tensor


class PoseDataset(Dataset[Sample]):
    """Labeled images, preprocessed and augmented.

    Sets of spacecraft locate an object in the camera frame, and a network learns ``[t, q]``. Sets
    of places (Cambridge Landmarks, 7Scenes) locate the camera in the world, and a network learns
    ``[c, q]``: the camera's center in the world, and the rotation from the world to the camera
    frame, as PoseNet (Kendall et al., ICCV 2015) and Table 5 of Ye et al. (Sensors 2023, 23, 8633)
    do. The same pose as ``[t, q]`` has ``t = -R(q) c``, whose errors grow with those of ``q`` and
    the distance to the world's arbitrary origin.

    Args:
        records: The labeled images.
        preprocessing: Conversion from image to network input.
        augmentation: Random augmentation of each sample; None for none.
        cache: Decode and resize every image now, on all cores, into one uint8 file (3 bytes per
            pixel of a frame: 150 kB for 224 x 224), so that epochs decode nothing. DataLoader
            workers, forked or spawned, and later runs map this file (`ffpose.datasets.cache`).

    Attributes:
        records: The labeled images.
        names: Names of the images.
        poses: Labels ``(N, 7)``, float64, ``[t, q]``, or ``[c, q]`` where the target is the camera.
        target: What the labels locate.
        camera: The camera of the decoded images; None where they have several.
        preprocessing: The preprocessing, whose `Preprocessing.camera` gives the camera of the
            network's input.
        augmentation: The augmentation, or None.

    Raises:
        ValueError: There are no records, or ``augmentation`` crops at random and ``preprocessing``
            is not a center crop, or it turns cameras that have distortion or are the target.
        DataError: A record has no label; with ``cache``, an image cannot be used, as in
            `load_image`.
        OSError: With ``cache``, the disk is full.
    """

    def __init__(
        self,
        records: Sequence[Record],
        preprocessing: Preprocessing,
        augmentation: Augmentation | None = None,
        cache: bool = False,
    ) -> None:
        if not records:
            raise ValueError("dataset: expected at least one record, got none")
        if augmentation and augmentation.crops and preprocessing.mode != "center_crop":
            crop = "random_crop" if augmentation.random_crop else "turned_crop"
            raise ValueError(
                f"augmentation: {crop} expects preprocessing of mode 'center_crop', "
                f"got {preprocessing.mode!r}"
            )
        self.records, self.target = tuple(records), records[0].target
        cameras = {record.camera for record in records}
        self.camera = cameras.pop() if len(cameras) == 1 else None
        if augmentation and augmentation.turns:
            self._expect_turnable()
        self.preprocessing = preprocessing
        self.augmentation = augmentation
        self.names = [record.name for record in records]
        self.poses = np.stack([self._to_vector(record.label) for record in records])
        self._frames = cached_frames(self.records, preprocessing) if cache else None

    def __len__(self) -> int:
        return len(self.records)

    @property
    def image_size(self) -> tuple[int, int] | None:
        """``(height, width)`` of the images; None where they have several."""
        sizes = {(record.camera.height, record.camera.width) for record in self.records}
        return sizes.pop() if len(sizes) == 1 else None

    def to_pose(self, vector: ArrayLike) -> Pose:
        """Return the pose of a vector ``(7,)`` like those of ``poses``: a label or a prediction.

        Raises:
            TypeError: The values are not real numbers.
            ValueError: As `Pose`.
        """
        if self.target == "object":
            return Pose.from_vector(vector)
        values = np.asarray(vector, np.float64)
        return camera_pose(values[..., :3], values[..., 3:])

    def _to_vector(self, pose: Pose) -> FloatArray:
        """Return a pose as the vector ``(7,)`` that a network learns: the inverse of `to_pose`."""
        if self.target == "object":
            return pose.vector
        return np.concatenate([pose.camera_center, pose.q])

    @property
    def spread(self) -> float:
        """RMS distance of the positions from their mean; one where they do not vary."""
        deviation = self.poses[:, :3] - self.poses[:, :3].mean(axis=0)
        return float(np.sqrt(np.square(deviation).sum(axis=1).mean())) or 1.0

    def __getitem__(self, index: int) -> Sample:
        """Return sample ``index``, with new random augmentation.

        Raises:
            IndexError: ``index`` is out of range.
            DataError: The image cannot be used, as in `load_image`.
        """
        index = range(len(self))[index]
        preprocessing = self.preprocessing
        frame = (
            preprocessing.frame(self.load_image(index))
            if self._frames is None
            else self._frames[index]
        )
        pose = torch.from_numpy(self.poses[index]).float()
        view, camera = self._view(frame, (pose[:3], pose[3:]), self.records[index].camera)
        image, translation, orientation = (
            view if self.augmentation is None else self.augmentation(*view, camera)
        )
        intrinsics = torch.tensor((camera.fx, camera.fy, camera.cx, camera.cy), dtype=torch.float64)
        preprocessing.standardize(image)
        return Sample(image, translation, orientation, index, intrinsics)

    def load_image(self, index: int) -> Image.Image:
        """Decode image ``index`` as RGB at its size on disk.

        Raises:
            DataError: The file cannot be read, has another size than the camera, or does not
                convert to RGB; the error names the file and line that list it (`Record.decode`).
        """
        return self.records[index].decode()

    def expect_target(self, target: Target) -> None:
        """Refuse labels that do not locate what a network does.

        Raises:
            ValueError: They locate something else than ``target``.
        """
        if self.target != target:
            raise ValueError(
                f"data: expected labels that locate the {target}, as the weights do, got those in"
                f" {self.records[0].source}, which locate the {self.target}"
            )

    def _expect_turnable(self) -> None:
        """Check that the images and labels are such that turning the camera keeps them true."""
        if self.target != "object":
            raise ValueError(
                "augmentation: pan, tilt, roll and turned_crop expect labels that locate an "
                "object, got labels that locate the camera"
            )
        if any(isinstance(record.camera, DistortedCamera) for record in self.records):
            raise ValueError(
                "augmentation: pan, tilt, roll and turned_crop expect cameras without distortion; "
                "--data.undistort undistorts the images"
            )

    def _view(
        self, frame: NDArray[np.uint8], label: tuple[Tensor, Tensor], camera: Camera
    ) -> tuple[tuple[Tensor, Tensor, Tensor], Camera]:
        """Crop a frame; return the crop in [0, 1], its label, and the camera that sees it."""
        preprocessing, augmentation = self.preprocessing, self.augmentation
        window, view = preprocessing.center_window(frame.shape[:2]), preprocessing.camera(camera)
        if augmentation is not None and augmentation.crops:
            window = random_window(preprocessing, frame.shape[:2])
            crop = preprocessing.window_camera(camera, window)
            if augmentation.turned_crop:
                whole, image = preprocessing.frame_camera(camera), torch.from_numpy(planes(frame))
                return turn_camera(image, *label, whole, crop_turn(crop, view), view), view
            view = crop
        return (torch.from_numpy(preprocessing.crop(frame, window)), *label), view
