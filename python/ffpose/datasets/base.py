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
from ffpose.datasets.targets import Target, to_pose, to_vector
from ffpose.geometry import DistortedCamera, Pose
from ffpose.preprocessing import Preprocessing, Window
from ffpose.transforms import Augmentation, random_window, standardize

Part = str
"""Part of a set: the name of a split, or ``"all"`` for all of its splits joined."""


class Reader(Protocol):
    """Interface of the module that reads one kind of dataset.

    Attributes:
        TARGET: What the labels of its sets locate.
    """

    TARGET: Target

    def splits(self, root: Path) -> list[str]:
        """Return the splits that the folder contains."""

    def read(self, root: Path, split: str) -> list[Record]:
        """Return the images of a split, with converted labels and their cameras."""


class Sample(NamedTuple):
    """One sample; a DataLoader collates samples into a Sample of batches.

    Attributes:
        image: Standardized image ``(3, h, w)``, float32.
        translation: Translation ``(3,)`` in meters, float32, or what the set locates in its place
            (`ffpose.datasets.targets`).
        orientation: Unit quaternion ``(w, x, y, z)``, ``w >= 0``, float32 ``(4,)``.
        index: Index of the sample in the dataset.
    """

    image: Tensor
    translation: Tensor
    orientation: Tensor
    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here


class PoseDataset(Dataset[Sample]):
    """Labeled images, preprocessed and augmented.

    Args:
        records: The labeled images.
        preprocessing: Conversion from image to network input.
        augmentation: Random augmentation of each sample; None for none.
        cache: Decode and resize every image now, on all cores, into one uint8 file (3 bytes per
            pixel of a frame: 150 kB for 224 x 224), so that epochs decode nothing. DataLoader
            workers, forked or spawned, and later runs map this file (`ffpose.datasets.cache`).
        target: What the labels locate.

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
        target: Target = "object",
    ) -> None:
        if not records:
            raise ValueError("dataset: expected at least one record, got none")
        if augmentation and augmentation.random_crop and preprocessing.mode != "center_crop":
            raise ValueError(
                "augmentation: random_crop expects preprocessing of mode 'center_crop', "
                f"got {preprocessing.mode!r}"
            )
        self.records, self.target = tuple(records), target
        cameras = {record.camera for record in records}
        self.camera = cameras.pop() if len(cameras) == 1 else None
        if augmentation and augmentation.turns:
            self._expect_turnable()
        self.preprocessing = preprocessing
        self.augmentation = augmentation
        self.names = [record.name for record in records]
        self.poses = np.stack([to_vector(record.label, target) for record in records])
        self._frames = cached_frames(self.records, preprocessing) if cache else None

    def __len__(self) -> int:
        return len(self.records)

    @property
    def image_size(self) -> tuple[int, int] | None:
        """``(width, height)`` of the images; None where they have several."""
        sizes = {(record.camera.width, record.camera.height) for record in self.records}
        return sizes.pop() if len(sizes) == 1 else None

    def to_pose(self, vector: ArrayLike) -> Pose:
        """Return the pose of a vector like those of ``poses``: a label or a prediction."""
        return to_pose(vector, self.target)

    def __getitem__(self, index: int) -> Sample:
        """Return sample ``index``, with new random augmentation.

        Raises:
            IndexError: ``index`` is out of range.
            DataError: The image cannot be used, as in `load_image`.
        """
        index = range(len(self))[index]
        frame = self._frame(index) if self._frames is None else self._frames[index]
        image = torch.from_numpy(self.preprocessing.cut(frame, self._window(frame)))
        pose = torch.from_numpy(self.poses[index]).float()
        translation, orientation = pose[:3], pose[3:]
        if self.augmentation is not None:
            camera = self.preprocessing.camera(self.records[index].camera)
            image, translation, orientation = self.augmentation(
                image, translation, orientation, camera
            )
        return Sample(standardize(image, self.preprocessing), translation, orientation, index)

    def load_image(self, index: int) -> Image.Image:
        """Decode image ``index`` as RGB at its size on disk.

        Raises:
            DataError: The file cannot be read, has another size than the camera, or does not
                convert to RGB; the error names the file and line that list it (`Record.decode`).
        """
        return self.records[index].decode()

    def _expect_turnable(self) -> None:
        """Check that the images and labels are such that turning the camera keeps them true."""
        if self.target != "object":
            raise ValueError(
                "augmentation: pan, tilt and roll keep an object's origin in view, and expect "
                "labels that locate one, got labels that locate the camera"
            )
        if any(isinstance(record.camera, DistortedCamera) for record in self.records):
            raise ValueError(
                "augmentation: pan, tilt and roll expect cameras without distortion; "
                "--data.undistort undistorts the images"
            )

    def _frame(self, index: int) -> NDArray[np.uint8]:
        return self.preprocessing.frame(self.load_image(index))

    def _window(self, frame: NDArray[np.uint8]) -> Window:
        if self.augmentation is not None and self.augmentation.random_crop:
            return random_window(self.preprocessing, frame.shape[:2])
        return self.preprocessing.center_window(frame.shape[:2])
