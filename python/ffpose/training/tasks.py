"""What a network learns from and is judged by: batches of a split, the loss of one, the validation.

The loop (`ffpose.training.engine`) knows no data and no loss; it steps through a task. `FrameTask`
is the paper's: whole images and its joint loss. `ObjectTask` trains a network with a second look on
stored views. Both are judged alike: by the poses of whole images of the validation split.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor, nn
from torch.utils.data import DataLoader

from ffpose.datasets import PoseDataset, Sample
from ffpose.losses import LossTerms, PoseLoss
from ffpose.models import FilterformerPose
from ffpose.preprocessing import Preprocessing
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.provenance import describe_data
from ffpose.training.views import ViewBatch, ViewBatches

VALIDATION_BATCH = 20
"""Whole images of a network with a second look that are validated at once."""


class Task(Protocol):
    """What the loop needs to train a network.

    Attributes:
        preprocessing: From an image to the network's input.
    """

    preprocessing: Preprocessing

    @property
    def loss(self) -> nn.Module:
        """Its parameters are trained beside the network's, without weight decay, and not saved."""

    @property
    def images(self) -> int:
        """Images of the training split."""

    @property
    def steps(self) -> int:
        """Batches an epoch."""

    def batches(self, seed: int) -> Iterator[Any]:
        """Pass once over the training split, in an order drawn from ``seed``."""

    def terms(self, model: FilterformerPose, batch: Any, device: torch.device) -> LossTerms:
        """Return the loss of a batch."""

    def size(self, batch: Any) -> int:
        """Images of a batch."""

    def names(self, batch: Any) -> str:
        """Return the images of a batch, for an error."""

    def weights(self) -> dict[str, float]:
        """Return the learnable weights of the loss, for the table of results."""

    def validation(self) -> Iterator[Sample]:
        """Pass over the validation split."""

    def describe(self, kind: str) -> dict[str, Any]:
        """Return which images these are, for the header of the weights."""

    def empty(self) -> Iterator[Tensor] | None:
        """Pass over images without an object, standardized; None for a network that cannot tell."""


def _loader(dataset: PoseDataset, batch_size: int, workers: int, **options: Any) -> Any:
    return DataLoader(dataset, batch_size=batch_size, num_workers=workers, **options)


class FrameTask:
    """Pose from whole images, with the paper's joint loss.

    Args:
        train_set: Images to learn from.
        val_set: Images that choose the best epoch.
        loss: The joint loss.
        batch_size: Images a step.
        workers: Processes that read images beside this one.
    """

    def __init__(
        self,
        train_set: PoseDataset,
        val_set: PoseDataset,
        loss: PoseLoss,
        batch_size: int,
        workers: int,
    ) -> None:
        self.train_set, self.val_set, self.loss = train_set, val_set, loss
        self.batch_size, self.workers = batch_size, workers
        self.preprocessing = train_set.preprocessing

    @property
    def images(self) -> int:
        """Images of the training split."""
        return len(self.train_set)

    @property
    def steps(self) -> int:
        """Batches an epoch."""
        return -(-self.images // self.batch_size)

    def batches(self, seed: int) -> Iterator[Sample]:
        """Pass once over the training split, in an order drawn from ``seed``."""
        generator = torch.Generator().manual_seed(seed)
        return iter(
            _loader(
                self.train_set, self.batch_size, self.workers, shuffle=True, generator=generator
            )
        )

    def terms(self, model: FilterformerPose, batch: Sample, device: torch.device) -> LossTerms:
        """Return the joint loss of a batch."""
        images = batch.image.to(device)
        t, q = batch.translation.to(device), batch.orientation.to(device)
        if model.config.orientation_head == "quaternion":
            pose = model(images)
            result: LossTerms = self.loss(pose.translation, pose.orientation, t, q)
            return result
        t_hat, numbers = model.regress(images)
        distance = torch.linalg.vector_norm(t - t_hat, dim=-1).mean()
        return self.loss.joined(distance, model.orientation.loss(numbers, q).mean())

    def size(self, batch: Sample) -> int:
        """Images of a batch."""
        return len(batch.image)

    def names(self, batch: Sample) -> str:
        """Return the file names of a batch."""
        return ", ".join(self.train_set.names[int(i)] for i in torch.as_tensor(batch.index))

    def weights(self) -> dict[str, float]:
        """Return the two learnable weights."""
        return {"s_t": self.loss.s_t.item(), "s_q": self.loss.s_q.item()}

    def validation(self) -> Iterator[Sample]:
        """Pass over the validation split."""
        return iter(_loader(self.val_set, self.batch_size, self.workers))

    def describe(self, kind: str) -> dict[str, Any]:
        """Return kind, number, size and digest of the training images."""
        return describe_data(self.train_set, kind)

    def empty(self) -> None:
        """Return nothing: the network does not tell."""


class ObjectTask:
    """Pose by a second look, from stored views.

    Args:
        views: Makes batches of the training split.
        val_set: Whole images that choose the best epoch.
        loss: The terms and their weights.
        batch_size: Images a step.
        empty_images: Whole images without an object ``(N, H, W, 3)``, uint8; None for none.
    """

    def __init__(
        self,
        views: ViewBatches,
        val_set: PoseDataset,
        loss: ObjectObjective,
        batch_size: int,
        empty_images: NDArray[np.uint8] | None = None,
    ) -> None:
        self.views, self.val_set, self.loss, self.batch_size = views, val_set, loss, batch_size
        self.preprocessing = val_set.preprocessing
        self.empty_images = empty_images

    @property
    def images(self) -> int:
        """Images of the training split that an epoch uses: whole batches."""
        return self.steps * self.batch_size

    @property
    def steps(self) -> int:
        """Batches an epoch."""
        return len(self.views) // self.batch_size

    def batches(self, seed: int) -> Iterator[ViewBatch]:
        """Pass once over the training split, in an order drawn from ``seed``."""
        return prefetched(self.views.epoch(seed, self.batch_size))

    def terms(self, model: FilterformerPose, batch: ViewBatch, device: torch.device) -> LossTerms:
        """Return the loss of a batch."""
        result: LossTerms = self.loss(model, ViewBatch(*(part.to(device) for part in batch)))
        return result

    def size(self, batch: ViewBatch) -> int:
        """Images of a batch."""
        return len(batch.crops)

    def names(self, batch: ViewBatch) -> str:
        """Return the numbers of a batch's views."""
        return ", ".join(map(str, batch.index.tolist()))

    def weights(self) -> dict[str, float]:
        """Return no weights: they are fixed."""
        return {}

    def validation(self) -> Iterator[Sample]:
        """Pass over the validation split."""
        return iter(_loader(self.val_set, VALIDATION_BATCH, 0))

    def describe(self, kind: str) -> dict[str, Any]:
        """Return kind, number, size and digest of the labels of the training views."""
        digest = hashlib.sha256()
        for arrays in self.views.sets:
            digest.update(np.ascontiguousarray(arrays["labels"], "<f8").tobytes())
        camera = self.val_set.camera
        return {
            "kind": kind,
            "count": len(self.views),
            "image_size": [camera.width, camera.height],
            "digest": digest.hexdigest(),
        }

    def empty(self) -> Iterator[Tensor] | None:
        """Pass over whole images without an object."""
        if self.empty_images is None:
            return None
        return standardized(self.empty_images, self.preprocessing)


def standardized(images: NDArray[np.uint8], preprocessing: Preprocessing) -> Iterator[Tensor]:
    """Yield images ``(N, H, W, 3)`` of the input's size as the network takes them, in batches."""
    for start in range(0, len(images), VALIDATION_BATCH):
        part = images[start : start + VALIDATION_BATCH]
        yield torch.stack([preprocessing(Image.fromarray(image)) for image in part])


def prefetched(batches: Iterator[ViewBatch]) -> Iterator[ViewBatch]:
    """Yield batches, the next one made by a thread while one is trained on."""
    with ThreadPoolExecutor(1) as pool:
        upcoming = pool.submit(next, batches, None)
        while (batch := upcoming.result()) is not None:
            upcoming = pool.submit(next, batches, None)
            yield batch


def trained_together(model: nn.Module, loss: nn.Module) -> list[Tensor]:
    """Return the parameters of network and loss."""
    return [*model.parameters(), *loss.parameters()]
