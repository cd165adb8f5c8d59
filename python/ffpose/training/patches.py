"""Training batches for a network with a second look: stored patches with geometric augmentation.

Each sample is augmented anew: the frame of the first look is mirrored or not, and rotated about the
boresight; the virtual camera of the second look is pointed to where a first look might have found
the object, and rotated about the viewing ray by any angle. Each is one homography of the stored
pixels, and the label changes exactly with it (`ffpose.models.virtual_camera`). Of the attitudes in
which a symmetric object looks the same, the label is the one that is seen from the direction
nearest to a reference in the object's frame (`ffpose.geometry.symmetry`): equivariant to the
camera's rotation about the viewing ray, and of no prediction, so that attitude, object coordinates
and keypoints agree. Brightness, blur and noise are varied before, in the stored pixels, as a camera
makes them: a polar view has a seam and rings of other resolutions, which they do not know.

A CPU makes each view from the part of its patch that it shows. A GPU makes all views of a batch at
once from whole patches. It holds all of them where its memory has room (`PatchBatches.held`), and
processes on the CPU only draw which are shown; otherwise they read those (`PatchBatches.stored`).

Some samples are negatives, so that the network learns whether the object is in view: empty scenes
and other spacecraft, looked at as if the object were there, and images that are not scenes at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from ffpose.errors import expect
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.geometry.warping import pixel_centers, sample_planes, source_planes
from ffpose.imaging.patches import Arrays
from ffpose.models import PolarPose
from ffpose.models.second_look import in_front, offset_of
from ffpose.models.virtual_camera import VirtualCamera, source_pixels
from ffpose.nn.rotations import (
    quaternion_product,
    quaternion_to_matrix,
    toward,
    turned_about_axis,
)
from ffpose.render.shading.sensor import through_jpeg
from ffpose.training.clutter import clutter
from ffpose.training.config import PatchAugmentation
from ffpose.training.photometry import Photometry, draw
from ffpose.training.processes import ALONE, Processes

CPU = torch.device("cpu")

OUTLIER = 5.0
"""Errors of a first look that misses relative to those of one that does not."""

NEGATIVE = 3.0
"""The same of a first look at what is not the object, whose size it takes for the object's."""

SCENES = 0.75
"""Share of the negatives that are scenes, where a set has any."""

FRAME_MARGIN = 0.02
"""Least distance of the object's origin from the border after a rotation, relative to the frame."""


class PatchBatch(NamedTuple):
    """Inputs and targets of both looks for ``B`` samples.

    Attributes:
        frames: ``(F, 3, h, w)``, standardized input of the first look for the first F samples.
        translation: ``(F, 3)``, where they show the object, meters.
        crops: ``(B, 3, h, w)``, standardized input of the second look.
        tan_half_angle: ``(B,)``, of half the angle that a view covers (`VirtualCamera`).
        orientation: ``(B, 4)``, unit quaternions in the virtual camera's frame.
        offset: ``(B, 3)``, as `ffpose.models.second_look.offset_of`.
        coordinates: ``(B, 4, rows, columns)``: object coordinates in [-1, 1], and its mask, 0 or 1.
        keypoints: ``(B, K, 2)``, places of the object's keypoints, column and row relative to the
            view's width and height: outside of 0 to 1 where the view does not show them.
        present: ``(B,)`` bool, whether the sample shows the object.
        index: ``(B,)``, indices of the samples in the set.
    """

    frames: Tensor
    translation: Tensor
    crops: Tensor
    tan_half_angle: Tensor
    orientation: Tensor
    offset: Tensor
    coordinates: Tensor
    keypoints: Tensor
    present: Tensor
    index: Tensor  # type: ignore[assignment]  # hides tuple.index, which means nothing here


class StoredBatch(NamedTuple):
    """What is stored of ``B`` samples, as `PatchBatch` and `DrawnBatch` name it.

    Attributes:
        frames: ``(F, h, w, 3)`` uint8.
        translation: ``(F, 3)`` float32.
        windows: ``(B - C, S, S, 3)`` uint8, of the samples that are scenes, after the first C.
        coordinates: ``(B, S/2, S/2, 4)`` uint8.
        labels: ``(B, 13)`` float32, of the windows; of the first C, of images of the set.
    """

    frames: Tensor
    translation: Tensor
    windows: Tensor
    coordinates: Tensor
    labels: Tensor
    index: Tensor  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    negatives: int
    seed: int


class DrawnBatch(NamedTuple):
    """Which samples a batch shows, of patches that a GPU holds.

    Attributes:
        index: ``(B,)``, indices of the samples in the set.
        frames: Number of samples that have a frame, the first ones.
        negatives: Number of samples that do not show the object, the first ones.
        scenes: Indices of the patches without an object that the last of these show.
        changed: Places in `StoredBatch.windows` of those that went through a JPEG file.
        jpeg: ``(J, S, S, 3)`` uint8, what the files show.
        seed: Of the random numbers of their augmentation.
    """

    index: Tensor  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    frames: int
    negatives: int
    scenes: Tensor
    changed: Tensor
    jpeg: Tensor
    seed: int


Prepared = PatchBatch | StoredBatch | DrawnBatch
"""A batch as `PatchEpoch` gives it: made, or as far as the CPU goes for a GPU."""

HELD_SHARE = 0.5
"""Largest share of a GPU's free memory that patches take; the network needs the rest."""


class PatchBatches:
    """A set of stored patches, and its augmented batches for one network.

    Args:
        model: The network; its configuration gives the geometry of both looks.
        arrays: Patches of one or several sets, as `ffpose.imaging.patches` stores them.
        empty: Patches without an object; may be empty.
        augmentation: Ranges of the augmentation.
        std: Standard deviation of the input's preprocessing, whose mean is zero.
        cells: Rows and columns of the coordinate map.
        keypoints: Points of the object ``(K, 3)``, meters; there may be none.
        symmetry: Rotations that leave the object's look unchanged.
        device: Where the batches are made.

    Attributes:
        held: All patches on the device, with an object and without, by the names of their arrays;
            None where they stay in the memory of the CPU.
    """

    held: tuple[dict[str, Tensor], dict[str, Tensor]] | None = None

    def __init__(
        self,
        model: PolarPose,
        arrays: Sequence[Arrays],
        empty: Sequence[Arrays],
        augmentation: PatchAugmentation,
        std: tuple[float, float, float],
        cells: tuple[int, int],
        keypoints: NDArray[np.float64],
        symmetry: SymmetryGroup = IDENTITY,
        device: torch.device = CPU,
    ) -> None:
        self.model, self.sets, self.empty = model, tuple(arrays), tuple(empty)
        self.augmentation, self.cells, self.device = augmentation, cells, device
        self.photometry = Photometry(augmentation, std, device)
        self.together = device.type != "cpu"
        self.keypoints = torch.from_numpy(keypoints).float().to(device)
        self.symmetries = torch.from_numpy(symmetry.rotations).float().to(device)
        self.references = torch.from_numpy(symmetry.references).float().to(device)
        self.places = _places(self.sets)
        self.empty_places = _places(self.empty)
        config = model.config
        assert config.camera is not None  # a second look needs it
        fx, fy, cx, cy = (value / config.first_stride for value in config.camera)
        matrix = torch.tensor([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self.frame_matrix, self.frame_inverse = matrix.to(device), matrix.inverse().to(device)
        self.frame_pixels = pixel_centers(*self.sets[0]["frames"].shape[1:3]).to(device)
        if device.type == "cuda":
            parts = [part for each in (*self.sets, *self.empty) for part in each.values()]
            need = sum(part.nbytes for part in parts)
            free, _ = torch.cuda.mem_get_info(device)
            if need <= HELD_SHARE * free:
                self.hold()

    def __len__(self) -> int:
        return len(self.places)

    def epoch(self, seed: int, batch_size: int, processes: Processes = ALONE) -> PatchEpoch:
        """Return one pass over a process's share, in an order drawn from ``seed``.

        Raises:
            ValueError: ``batch_size`` is less than one or more than the number of samples.
        """
        most = len(self) // processes.world
        expect(1 <= batch_size <= most, "batch_size", f"1 to {most}", batch_size)
        order = torch.randperm(len(self), generator=torch.Generator().manual_seed(seed))
        own = order[processes.share(most * processes.world)]
        return PatchEpoch(self, own, batch_size, (seed, processes.rank))

    def hold(self) -> None:
        """Hold all patches on the device."""
        names = ("frames", "windows", "coordinates", "labels")
        self.held = (
            {name: _joined(self.sets, name, self.device) for name in names},
            {name: _joined(self.empty, name, self.device) for name in ("windows", "labels")},
        )

    def drawn(self, index: Tensor, generator: torch.Generator) -> DrawnBatch:
        """Draw what a batch shows of the samples ``index``; a share of the windows as JPEG has it.

        ``generator`` is on the CPU, and draws the seed of the augmentation.
        """
        a, count = self.augmentation, len(index)
        first = max(1, _rounded(a.frames * count, generator))
        negatives = min(_rounded(a.empty * count, generator), count - 1)
        scenes = _rounded(SCENES * negatives, generator) if self.empty else 0
        chosen = index[:0]
        if scenes:
            chosen = torch.randint(len(self.empty_places), (scenes,), generator=generator)
        shown = [
            *((self.empty, place) for place in self.empty_places[chosen.numpy()]),
            *((self.sets, place) for place in self.places[index[negatives:].numpy()]),
        ]
        changed, files = list[int](), list[NDArray[np.uint8]]()
        if a.jpeg > 0:
            for number, (sets, (n, row)) in enumerate(shown):
                if draw(generator) < a.jpeg:
                    window = np.array(sets[n]["windows"][row])
                    files.append(through_jpeg(window, round(30 + 60 * draw(generator))))
                    changed.append(number)
        jpeg = torch.from_numpy(np.stack(files)) if files else torch.zeros(0, dtype=torch.uint8)
        seed = int(torch.randint(1 << 62, (), generator=generator))
        rows = torch.tensor(changed, dtype=torch.long)
        return DrawnBatch(index, first, negatives, chosen, rows, jpeg, seed)

    def gathered(self, drawn: DrawnBatch) -> StoredBatch:
        """Return what is stored of drawn samples, from where the patches are."""
        index, negatives, chosen = drawn.index, drawn.negatives, drawn.scenes
        windows, labels = self._gather("windows", index[negatives:]), self._gather("labels", index)
        translation = labels[: drawn.frames, :3].clone()  # of the samples, before others' labels
        if len(chosen):
            windows = torch.cat((self._gather("windows", chosen, empty=True), windows))
            rows = slice(negatives - len(chosen), negatives)
            labels[rows] = self._gather("labels", chosen, empty=True)
        if len(drawn.changed):
            windows[drawn.changed.to(windows.device)] = drawn.jpeg.to(windows.device)
        return StoredBatch(
            self._gather("frames", index[: drawn.frames]),
            translation.float(),
            windows,
            self._gather("coordinates", index),
            labels.float(),
            index,
            negatives,
            drawn.seed,
        )

    def augmented(self, batch: StoredBatch | DrawnBatch) -> PatchBatch:
        """Return what both looks see of samples, on the device of this set."""
        stored = self.gathered(batch) if isinstance(batch, DrawnBatch) else batch
        a, device, count = self.augmentation, self.device, len(stored.labels)
        generator = torch.Generator(device).manual_seed(stored.seed)
        frames, t_frame, windows, coordinates, labels = (part.to(device) for part in stored[:5])
        frames, t_frame = self._turned_frames(_images(frames), t_frame, generator)
        t, q = labels[:, :3], labels[:, 3:7]
        present = torch.arange(count, device=device) >= stored.negatives
        points = self._looked_at(t, present, generator)
        shares = torch.rand(count, generator=generator, device=device)
        view = self.model.view_at(points, math.radians(a.twist_deg) * (2 * shares - 1))
        symmetry = self._canonical(view.rotation @ quaternion_to_matrix(q))
        q, turn = quaternion_product(q, symmetry), quaternion_to_matrix(symmetry)
        intrinsics = labels[:, 7:11]
        no_scenes = count - len(windows)
        pixels = source_pixels(view.of(slice(no_scenes, None)), intrinsics[no_scenes:])
        crops = self._seen(windows, pixels, generator)
        if no_scenes:
            crops = torch.cat((self._clutter(no_scenes, view, generator), crops))
        frames = self._varied(frames, generator)
        return PatchBatch(
            frames.contiguous(memory_format=torch.channels_last),
            t_frame,
            crops.contiguous(memory_format=torch.channels_last),
            view.tan_half_angle,
            quaternion_product(view.quaternion, q),
            offset_of(view.points(t), view),
            self._coordinates(coordinates, view, intrinsics, turn),
            view.places(t[:, None] + self.keypoints @ quaternion_to_matrix(q).mT),
            present,
            stored.index,
        )

    def _canonical(self, rotation: Tensor) -> Tensor:
        """Return the symmetries ``(B, 4)`` after which views have their label.

        ``rotation (B, 3, 3)`` is from the object's frame to the virtual camera's.
        """
        seen_from = -rotation[:, 2]  # the camera's direction in the object's frame
        return self.symmetries[(seen_from @ self.references.mT).argmax(dim=1)]

    def _gather(self, name: str, index: Tensor, *, empty: bool = False) -> Tensor:
        if self.held is not None:
            return self.held[empty][name][index.to(self.device)]
        sets, places = (self.empty, self.empty_places) if empty else (self.sets, self.places)
        return torch.from_numpy(np.stack([sets[n][name][row] for n, row in places[index.numpy()]]))

    def _turned_frames(
        self, frames: Tensor, t: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Mirror every other frame, and rotate it, where the object stays in it.

        A mirror image shows no attitude that the object can have, and all that the first look is
        asked for: where the object is.
        """
        height, width = frames.shape[-2:]
        limit, device = math.radians(self.augmentation.roll_deg), self.device
        angles = limit * (2 * torch.rand(len(t), generator=generator, device=device) - 1)
        turn = quaternion_to_matrix(turned_about_axis(angles))
        mirrored = torch.randint(2, (len(t), 1), generator=generator, device=device)
        turn[:, :, 0] *= 1 - 2 * mirrored
        moved = (turn @ t[:, :, None])[..., 0]
        x, y, depth = (moved @ self.frame_matrix.mT).unbind(-1)
        u, v = x / depth, y / depth
        room = FRAME_MARGIN * width
        inside = (u > room) & (u < width - room) & (v > room) & (v < height - room)
        turn = torch.where(inside[:, None, None], turn, torch.eye(3, device=device))
        homographies = self.frame_matrix @ turn.mT @ self.frame_inverse
        planes = source_planes(homographies, self.frame_pixels)
        return sample_planes(frames, *planes), torch.where(inside[:, None], moved, t)

    def _looked_at(self, t: Tensor, present: Tensor, generator: torch.Generator) -> Tensor:
        """Return positions where a first look might find what is at ``t (B, 3)``, meters."""
        a, device = self.augmentation, self.device
        outlier = torch.rand(len(t), generator=generator, device=device) < a.look_outliers
        scale = torch.where(present, 1 + (OUTLIER - 1) * outlier.float(), NEGATIVE)[:, None]
        error = torch.randn(len(t), 3, generator=generator, device=device) * scale
        lateral = a.look_lateral * self.model.config.object_radius_m * error[:, :2]
        distance = t.norm(dim=-1, keepdim=True)
        places = torch.cat((lateral, distance), dim=1)[:, :, None]
        points = (quaternion_to_matrix(toward(t)) @ places)[..., 0]
        return in_front(points * torch.exp(a.look_distance * error[:, 2:]))

    def _varied(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Vary images ``(B, 3, h, w)`` in [0, 255] as a camera does, and standardize them."""
        if self.together:
            return self.photometry.together(images, generator)
        return torch.cat([self.photometry.one(image, generator) for image in images[:, None]])

    def _seen(self, windows: Tensor, pixels: Tensor, generator: torch.Generator) -> Tensor:
        """Return the views ``(B, 3, h, w)`` of windows ``(B, S, S, 3)`` at ``pixels (B, h, w, 2)``.

        On a CPU only the part of each window that is seen is varied, a third of it in the mean.
        """
        if self.together:
            return sample_planes(self._varied(_images(windows), generator), *pixels.unbind(-1))
        seen = []
        for window, places in zip(windows, pixels, strict=True):
            (left, right), (top, bottom) = (_span(axis, len(window)) for axis in places.unbind(-1))
            part = _images(window[None, top:bottom, left:right])
            image = self.photometry.one(part, generator)
            within = places[None] - torch.tensor([left, top])
            seen.append(sample_planes(image, *within.unbind(-1)))
        return torch.cat(seen)

    def _clutter(self, count: int, view: VirtualCamera, generator: torch.Generator) -> Tensor:
        """Return views ``(count, 3, h, w)`` of images that are no scenes."""
        pictures = 255 * clutter(count, (view.width, view.width), generator)
        u, v = view.image_plane().float() + view.width / 2
        shape = (count, *u.shape)
        return sample_planes(self._varied(pictures, generator), u.expand(shape), v.expand(shape))

    def _coordinates(
        self, stored: Tensor, view: VirtualCamera, intrinsics: Tensor, turn: Tensor
    ) -> Tensor:
        """Look up coordinates, turned by the inverses of ``turn``, and mask at cells' centers."""
        cells = source_pixels(view.resized(self.cells), intrinsics / 2).floor()
        side = stored.shape[1]
        inside = ((cells >= 0) & (cells < side)).all(-1)
        u, v = cells.clamp(0, side - 1).long().unbind(-1)
        rows = torch.arange(len(stored), device=self.device)[:, None, None]
        values = stored[rows, v, u] * inside[..., None]
        found = values.permute(0, 3, 1, 2) / 127.5
        found[:, :3] -= 1
        found[:, 3] /= 2
        if len(self.symmetries) > 1:
            found[:, :3] = torch.einsum("bji,bjhw->bihw", turn, found[:, :3])
        return found


@dataclass(eq=False)
class PatchEpoch(Dataset[Prepared]):
    """The whole batches of one pass over the samples of ``order``, each made when it is asked for.

    They are made in full on a CPU; for a GPU they are read, or only drawn, and made there. The
    random numbers of a batch come from ``seed`` and its number alone, so that it is the same
    whichever thread or process makes it.
    """

    patches: PatchBatches
    order: Tensor
    batch_size: int
    seed: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.order) // self.batch_size

    def __getitem__(self, number: int) -> Prepared:
        """Make a batch, read it, or draw it."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        (seed,) = np.random.SeedSequence([*self.seed, number]).generate_state(1)
        start = number * self.batch_size
        # A copy: a worker's queue moves what it sends to shared memory, in a thread of its own, and
        # would free the order under the next batch.
        index = self.order[start : start + self.batch_size].clone()
        drawn = self.patches.drawn(index, torch.Generator().manual_seed(int(seed)))
        if self.patches.held is not None:
            return drawn
        stored = self.patches.gathered(drawn)
        return self.patches.augmented(stored) if self.patches.device.type == "cpu" else stored


def _rounded(number: float, generator: torch.Generator) -> int:
    """Round down or up, so that the mean is the number: of few samples a share is below a half."""
    return math.floor(number + draw(generator))


def _span(places: Tensor, side: int) -> tuple[int, int]:
    """Return the range of an image's rows or columns from which ``places`` are interpolated.

    Its ends are even, so that halving loses nothing; ``side`` is.
    """
    least, most = (int(edge.floor()) // 2 * 2 for edge in places.aminmax())
    first = min(max(least - 2, 0), side - 2)
    return first, max(min(most + 4, side), first + 2)


def _places(sets: Sequence[Arrays]) -> NDArray[np.intp]:
    """Return set and row ``(N, 2)`` of each sample."""
    places = [(n, row) for n, each in enumerate(sets) for row in range(len(each["labels"]))]
    return np.array(places, np.intp).reshape(-1, 2)


def _joined(sets: Sequence[Arrays], name: str, device: torch.device) -> Tensor:
    """Return an array of all sets on a device, where one after the other is brought."""
    parts = [torch.tensor(each[name], device=device) for each in sets]
    return torch.cat(parts) if parts else torch.zeros(0, device=device)


def _images(pixels: Tensor) -> Tensor:
    """Convert uint8 pixels ``(B, H, W, 3)`` to float images ``(B, 3, H, W)`` in [0, 255]."""
    return pixels.permute(0, 3, 1, 2).float()
