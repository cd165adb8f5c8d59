"""Training tasks: the batches, the loss and the validation data of a network.

The training loop (`ffpose.training.engine`) is independent of data and loss; a task supplies both.
`FrameTask` is the paper's, and that of any network: whole images and the joint loss. `ObjectTask`
trains a network with a second look on stored patches. Both are validated alike, on the poses of
whole images.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.utils.data import DataLoader

from ffpose.datasets import PoseDataset, Sample
from ffpose.errors import expect
from ffpose.models import BaseNetwork, FrameNetwork, PolarPose
from ffpose.nn.orientation import QuaternionHead
from ffpose.training.losses import JointLoss, LossTerms
from ffpose.training.object_objective import ObjectObjective
from ffpose.training.patches import PatchBatch, PatchBatches, Prepared
from ffpose.training.processes import Processes

LEAST_BATCHES = 4
"""Batches of an epoch for each worker, or more: fewer do not pay for its start."""

VALIDATION_BATCH = 20
"""Batch size for validating a network with a second look on whole images."""


@dataclass(eq=False)
class Task(ABC):
    """Interface between the training loop and the data and loss of a network.

    Attributes:
        val_set: Whole validation images, which select the best epoch.
        loss: Its parameters are trained without weight decay and not saved with weights.
        batch_size: Number of images of a batch, in each process.
        workers: Number of processes that prepare batches.
        processes: This process's place among those that train together.
    """

    val_set: PoseDataset
    loss: nn.Module
    batch_size: int
    workers: int
    processes: Processes

    @property
    @abstractmethod
    def images(self) -> int:
        """Number of training images that an epoch uses, over all processes."""

    @property
    def steps(self) -> int:
        """Number of batches per epoch in this process, the last of which may be smaller."""
        return -(-(self.images // self.processes.world) // self.batch_size)

    @abstractmethod
    def batches(self, seed: int) -> Iterator[Any]:
        """Iterate once over the training split, in an order drawn from ``seed``."""

    @abstractmethod
    def terms(self, model: BaseNetwork, batch: Any, device: torch.device) -> LossTerms:
        """Return the loss of a batch."""

    def names(self, batch: Any) -> str:
        """Return the names of a batch's images, or their indices, for error messages."""
        return ", ".join(map(str, batch.index.tolist()))

    def weights(self) -> dict[str, float]:
        """Return the learnable weights of the loss's terms, for the table of results."""
        learned = self.loss.named_parameters()
        return {name: value.item() for name, value in learned if value.dim() == 0}

    def validation(self) -> Iterator[Sample]:
        """Iterate over this process's share of the validation split."""
        share = self.processes.share(len(self.val_set))
        return iter(DataLoader(self.val_set, VALIDATION_BATCH, sampler=share))


class Objective(nn.Module):
    """The loss of a batch, as a module of all that is trained."""

    def __init__(self, task: Task, model: BaseNetwork, device: torch.device) -> None:
        super().__init__()
        self.model, self.loss = model, task.loss
        self._task, self._device = task, device

    def forward(self, batch: Any) -> LossTerms:
        """Return the loss of a batch."""
        return self._task.terms(self.model, batch, self._device)


@dataclass(eq=False)
class FrameTask(Task):
    """Pose from whole images: a network's two losses, joined."""

    loss: JointLoss
    train_set: PoseDataset

    @property
    def images(self) -> int:
        """Number of training images that an epoch uses, over all processes."""
        world = self.processes.world
        return len(self.train_set) // world * world

    def batches(self, seed: int) -> Iterator[Sample]:
        """Iterate once over the training split, in an order drawn from ``seed``.

        Raises:
            ValueError: There are fewer images than processes.
        """
        count = len(self.train_set)
        expect(self.images > 0, "processes", f"at most {count}, one an image", self.processes.world)
        generator = torch.Generator().manual_seed(seed)
        order = torch.randperm(count, generator=generator)
        own = order[self.processes.share(self.images)].tolist()
        generator.manual_seed(seed + self.processes.rank)  # of the workers, for the augmentation
        return self._loader(self.train_set, sampler=own, generator=generator)

    def _loader(self, images: PoseDataset, **options: Any) -> Iterator[Sample]:
        return iter(DataLoader(images, self.batch_size, num_workers=self.workers, **options))

    def terms(self, model: BaseNetwork, batch: Sample, device: torch.device) -> LossTerms:
        """Return the joint loss of a batch."""
        t, q = batch.translation.to(device), batch.orientation.to(device)
        assert isinstance(model, FrameNetwork)
        found = model.regress(batch.image.to(device))
        with torch.autocast(device.type, enabled=False):  # half precision is the network's alone
            t_hat, raw = (part.float() for part in found)
            translation, head = model.translation_loss(t_hat, t), model.orientation
            orientation = (
                self.loss.quaternion_distance(head.decode(raw), q)  # as Eq. 10, antipodal or not
                if isinstance(head, QuaternionHead)
                else head.loss(raw, q)
            )
            return self.loss.joined(translation.mean(), orientation.mean())

    def names(self, batch: Sample) -> str:
        """Return the file names of a batch."""
        return ", ".join(self.train_set.names[int(i)] for i in torch.as_tensor(batch.index))

    def validation(self) -> Iterator[Sample]:
        """Iterate over this process's share of the validation split."""
        return self._loader(self.val_set, sampler=self.processes.share(len(self.val_set)))


@dataclass(eq=False)
class ObjectTask(Task):
    """Pose with a second look, trained on stored patches.

    On Linux ``workers`` processes augment patches, for all of ``processes`` that are on this
    machine; otherwise, and with 0, a thread of each does.
    """

    loss: ObjectObjective
    patches: PatchBatches

    @property
    def images(self) -> int:
        """Number of training images that an epoch uses, over all processes: whole batches only."""
        together = self.batch_size * self.processes.world
        return len(self.patches) // together * together

    def batches(self, seed: int) -> Iterator[Prepared]:
        """Iterate once over the training split, in an order drawn from ``seed``."""
        epoch = self.patches.epoch(seed, self.batch_size, self.processes)
        workers = min(self.processes.workers(self.workers), len(epoch) // LEAST_BATCHES)
        if workers == 0 or sys.platform != "linux":  # others copy the patches to each worker
            return prefetched(epoch[number] for number in range(len(epoch)))
        own = torch.Generator()  # or the network's random numbers would depend on the workers
        forked: dict[str, Any] = {"num_workers": workers, "multiprocessing_context": "fork"}
        return iter(DataLoader(epoch, batch_size=None, generator=own, **forked))

    def terms(self, model: BaseNetwork, batch: Prepared, device: torch.device) -> LossTerms:
        """Return the loss of a batch."""
        assert isinstance(model, PolarPose)
        if not isinstance(batch, PatchBatch):
            with torch.no_grad(), torch.autocast(device.type, enabled=False):
                batch = self.patches.augmented(batch)
        result: LossTerms = self.loss(model, batch)
        return result


def prefetched(batches: Iterator[Prepared]) -> Iterator[Prepared]:
    """Yield batches, and prepare the next one in a thread meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        upcoming = pool.submit(next, batches, None)
        while (batch := upcoming.result()) is not None:
            upcoming = pool.submit(next, batches, None)
            yield batch
