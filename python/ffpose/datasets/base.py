"""Labelled images as a torch data set; how a folder is read is the business of its own file."""

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
"""What can be asked of a set: a split, or all that it holds, one after the other."""


class Reader(Protocol):
    """What the module of each kind of data set offers."""

    def splits(self, root: Path) -> list[Split]:
        """Return the splits that the folder holds."""

    def read(self, root: Path, split: Split) -> tuple[list[Record], Camera]:
        """Return the labelled images of a split, labels converted, and their camera."""


class Sample(NamedTuple):
    """One training sample; a DataLoader stacks them into a Sample of batches.

    Attributes:
        image: float32 ``(3, h, w)``, standardised.
        translation: float32 ``(3,)``, metres.
        orientation: float32 ``(4,)``, unit quaternion ``(w, x, y, z)``, ``w >= 0``.
        index: Its place in the data set.
    """

    image: Tensor
    translation: Tensor
    orientation: Tensor
    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here


class PoseDataset(Dataset[Sample]):
    """Labelled images, preprocessed and augmented.

    Args:
        records: The labelled images.
        camera: The one camera of all images, which have its size.
        preprocessing: From image to network input.
        augmentation: Applied to each sample anew; None for none.
        cache: Decode and resize every image now, on all cores, into one file of uint8 (3 bytes a
            pixel of the frame: 150 kB for 224 x 224), so that an epoch decodes nothing. Workers of
            a DataLoader map it, forked or spawned, and so does the next run
            (`ffpose.datasets.cache`).

    Attributes:
        records: As given.
        names: The images' file names.
        poses: Labels ``(N, 7)``, float64, ``[t, q]``.
        camera: The camera of the images as they are on disk.
        preprocessing: As given; its `Preprocessing.camera` is that of the network's input.
        augmentation: As given.

    Raises:
        ValueError: No records, or a random crop without the preprocessing that leaves room for it.
        DataError: With ``cache``, as `load_image`.
        OSError: With ``cache``, there is no room for it.
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
            raise ValueError("data set: expected at least one record, got none")
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
        """Return sample ``index``, its changes drawn anew.

        Raises:
            IndexError: There is no such sample.
            DataError: As `load_image`.
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
        """Decode image ``index`` as it is on disk, as RGB.

        Raises:
            DataError: The file cannot be read, or its size or pixels are not what they should be;
                the error names the file and line that list it (`Record.decode`).
        """
        return self.records[index].decode(self.camera)

    def _frame(self, index: int) -> NDArray[np.uint8]:
        return self.preprocessing.frame(self.load_image(index))

    def _window(self, frame: NDArray[np.uint8]) -> Window:
        if self.augmentation is not None and self.augmentation.random_crop:
            return random_window(self.preprocessing, frame.shape[:2])
        return self.preprocessing.center_window(frame.shape[:2])
