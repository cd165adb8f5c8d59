"""Labeled images as a torch dataset; each kind of folder has a reader module of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from torch.utils.data import Dataset

from ffpose.datasets.cache import cached_frames
from ffpose.datasets.records import Record
from ffpose.geometry import Camera
from ffpose.preprocessing import Preprocessing, Window
from ffpose.transforms import Augmentation, random_window, standardize

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)

Part = Split | Literal["all"]
"""Part of a set: one split, or ``"all"`` for all of its splits joined."""


class Reader(Protocol):
    """Interface of the module that reads one kind of dataset."""

    def splits(self, root: Path) -> list[Split]:
        """Return the splits that the folder contains."""

    def read(self, root: Path, split: Split) -> tuple[list[Record], Camera]:
        """Return the images of a split, with converted labels, and their camera."""


class Sample(NamedTuple):
    """One sample; a DataLoader collates samples into a Sample of batches.

    Attributes:
        image: Standardized image ``(3, h, w)``, float32.
        translation: Translation ``(3,)`` in meters, float32.
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
        camera: Camera of all images, which must have its size.
        preprocessing: Conversion from image to network input.
        augmentation: Random augmentation of each sample; None for none.
        cache: Decode and resize every image now, on all cores, into one uint8 file (3 bytes per
            pixel of a frame: 150 kB for 224 x 224), so that epochs decode nothing. DataLoader
            workers, forked or spawned, and later runs map this file (`ffpose.datasets.cache`).

    Attributes:
        records: The labeled images.
        names: File names of the images.
        poses: Labels ``(N, 7)``, float64, ``[t, q]``.
        camera: The camera of the images as they are on disk.
        preprocessing: The preprocessing, whose `Preprocessing.camera` gives the camera of the
            network's input.
        augmentation: The augmentation, or None.

    Raises:
        ValueError: There are no records, or ``augmentation`` crops at random and ``preprocessing``
            is not a center crop.
        DataError: With ``cache``, an image cannot be used, as in `load_image`.
        OSError: With ``cache``, the disk is full.
    """

    def __init__(
        self,
        records: Sequence[Record],
        camera: Camera,
        preprocessing: Preprocessing,
        augmentation: Augmentation | None = None,
        cache: bool = False,
    ) -> None:
        if not records:
            raise ValueError("dataset: expected at least one record, got none")
        if augmentation and augmentation.random_crop and preprocessing.mode != "center_crop":
            raise ValueError(
                "augmentation: random_crop expects preprocessing of mode 'center_crop', "
                f"got {preprocessing.mode!r}"
            )
        self.records = tuple(records)
        self.camera = camera
        self.preprocessing = preprocessing
        self.augmentation = augmentation
        self.names = [record.image.name for record in records]
        self.poses = np.stack([record.pose.vector for record in records])
        self._frames = cached_frames(self.records, camera, preprocessing) if cache else None

    def __len__(self) -> int:
        return len(self.records)

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
            camera = self.preprocessing.camera(self.camera)
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
        return self.records[index].decode(self.camera)

    def _frame(self, index: int) -> NDArray[np.uint8]:
        return self.preprocessing.frame(self.load_image(index))

    def _window(self, frame: NDArray[np.uint8]) -> Window:
        if self.augmentation is not None and self.augmentation.random_crop:
            return random_window(self.preprocessing, frame.shape[:2])
        return self.preprocessing.center_window(frame.shape[:2])
