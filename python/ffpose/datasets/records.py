"""An image of a dataset, its camera and its label, and decoding its file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from ffpose.errors import DataError
from ffpose.geometry import CAMERA_FILE, Camera, DistortedCamera, Pose, Target
from ffpose.imaging.images import DEEP_MODES, MODES, check_white, open_image, to_rgb
from ffpose.imaging.undistortion import undistort


@dataclass(frozen=True)
class Decoding:
    """Conversion from image files to images, as the user states it.

    Attributes:
        undistort: Undistort the images of cameras with distortion.
        white: Level that becomes 255 in monochrome images of more than 8 bits, such as 4095 for 12
            bits, or the percentile of each image's own levels, such as ``"p99.5"``; None for images
            of 8 bits.

    Raises:
        ValueError: ``white`` is neither a positive number nor a percentile.
    """

    undistort: bool = False
    white: float | str | None = None

    def __post_init__(self) -> None:
        if self.white is not None:
            check_white("white", self.white)

    def completed(self, undistort: bool, white: float | str | None) -> Decoding:
        """Return this, and what it leaves open from the decoding of a network's training."""
        return Decoding(self.undistort or undistort, white if self.white is None else self.white)


AS_ON_DISK = Decoding()


@dataclass(frozen=True)
class Record:
    """An image, its camera, and its label if it has one.

    Attributes:
        image: Path of the image file.
        name: Name of the image, unique in its set: the path relative to the set's folder or to the
            folder of its images, with slashes.
        camera: Camera of the decoded image, which must have its size.
        pose: The label, in the conventions of `ffpose.geometry`; None in a split without labels.
        source: The file that lists the image.
        line: The line in that file, counted from one; None where it is not told.
        raw_quaternion: The quaternion ``(w, x, y, z)`` as in the file, before the reader normalizes
            it and `Pose` chooses its sign; None for a label that comes from no quaternion.
        lens: Camera of the file, where decoding undistorts it; None where it does not.
        white: Level or percentile that becomes 255, as for `Decoding`.
        time: Time of the middle of the exposure, seconds; None where the set has none.
        target: What the label locates.
    """

    image: Path
    name: str
    camera: Camera
    pose: Pose | None
    source: Path
    line: int | None
    raw_quaternion: tuple[float, float, float, float] | None = None
    lens: DistortedCamera | None = None
    white: float | str | None = None
    time: float | None = None
    target: Target = "object"

    def decoded_by(self, decoding: Decoding) -> Record:
        """Return the record whose image is decoded as ``decoding`` says."""
        record = replace(self, white=decoding.white)
        if decoding.undistort and isinstance(self.camera, DistortedCamera):
            return replace(record, camera=self.camera.pinhole, lens=self.camera)
        return record

    @property
    def label(self) -> Pose:
        """The label of an image that must have one.

        Raises:
            DataError: It has none.
        """
        if self.pose is None:
            raise self.error("expected a label, got an image of a split without labels")
        return self.pose

    def error(self, message: str) -> DataError:
        """Return an error that names the image, and the file and line that list it."""
        return DataError(f"{self.image}: {message}", self.source, self.line)

    def fingerprint(self) -> tuple[object, ...]:
        """Return what the decoded image depends on.

        Returns:
            The image's path, its size in bytes, its modification time in nanoseconds, its camera's
            size, and how it is decoded.

        Raises:
            DataError: The file is missing.
        """
        try:
            status = self.image.stat()
        except FileNotFoundError as error:
            raise self.error("no such file") from error
        file = str(self.image.resolve()), status.st_size, status.st_mtime_ns
        return *file, self.camera.width, self.camera.height, self.lens, self.white

    def size(self) -> tuple[int, int]:
        """Return the ``(width, height)`` that the image's header declares.

        Raises:
            DataError: The file is missing or not an image.
        """
        with self._open() as image:
            return image.size

    def decode(self) -> Image.Image:
        """Decode the image as RGB; transparency is dropped.

        Raises:
            DataError: The file is missing, truncated or not an image, its size differs from the
                camera's, or its pixels do not convert to RGB without loss.
        """
        with self._open() as image:
            # Before decoding: a small file can declare an image that exhausts the memory.
            size = (self.camera.width, self.camera.height)
            if image.size != size:
                text = "expected {}x{} pixels, as the dataset's camera has them, got {}x{}"
                raise DataError(text.format(*size, *image.size), self.image)
            if self.white is None and image.mode in DEEP_MODES:
                expected = f"pixels of mode {', '.join(MODES)} where no white level is stated"
                raise DataError(f"expected {expected} (--data.white), got {image.mode}", self.image)
            pixels = to_rgb(image, self.image, self.white)
        return pixels if self.lens is None else undistort(pixels, self.lens)

    @contextmanager
    def _open(self) -> Iterator[Image.Image]:
        """Open the image; errors in the context name the file and line that list it as well."""
        try:
            with open_image(self.image) as image:
                yield image
        except FileNotFoundError as error:
            raise self.error("no such file") from error
        except DataError as error:
            raise self.error(error.message) from error


def with_camera(records: Sequence[Record], root: Path, published: Camera) -> list[Record]:
    """Return records with their set's camera.

    That is the one of ``camera.json``, else the published one at the size of the first image.
    Smaller images of the published ones' shape are taken as resized. A DataError if the camera is
    invalid, or the images are larger than the published ones or of another shape.
    """
    path = root / CAMERA_FILE
    if path.exists():
        camera = Camera.read(path)
    else:
        width, height = records[0].size()
        if not published.has_aspect(width, height) or width > published.width:
            raise records[0].error(
                f"expected at most {published.width}x{published.height} pixels, of that shape, "
                f"where there is no {path.name}, got {width}x{height}"
            )
        camera = published.resized(width, height)
    return [replace(record, camera=camera) for record in records]


def expect_in_front(records: Iterable[Record]) -> None:
    """Refuse labels that place an object at the camera or behind it.

    Raises:
        DataError: Such a label; the error names file and line that list its image.
    """
    for record in records:
        if record.target == "object" and (depth := record.label.t[2]) <= 0:
            raise record.error(f"expected an object in front of the camera, z > 0, got z = {depth}")
