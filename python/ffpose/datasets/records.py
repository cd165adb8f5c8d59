"""A labeled image of a dataset, and decoding its file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from ffpose.errors import DataError
from ffpose.geometry import Camera, Pose
from ffpose.images import open_image, to_rgb


@dataclass(frozen=True)
class Record:
    """A labeled image.

    Attributes:
        image: Path of the image file.
        pose: The label, in the conventions of `ffpose.geometry`.
        source: The file that lists the image.
        line: The line in that file, counted from one.
        raw_quaternion: The quaternion ``(w, x, y, z)`` as in the file, before `Pose` normalizes it
            and chooses its sign; None for a label that comes from no file.
    """

    image: Path
    pose: Pose
    source: Path
    line: int
    raw_quaternion: tuple[float, float, float, float] | None = None

    def error(self, message: str) -> DataError:
        """Return an error that names the image, and the file and line that list it."""
        return DataError(f"{self.image}: {message}", self.source, self.line)

    def fingerprint(self) -> tuple[str, int, int]:
        """Return the image's path, its size in bytes, and its modification time in nanoseconds.

        Raises:
            DataError: The file is missing.
        """
        try:
            status = self.image.stat()
        except FileNotFoundError as error:
            raise self.error("no such file") from error
        return str(self.image.resolve()), status.st_size, status.st_mtime_ns

    def size(self) -> tuple[int, int]:
        """Return the ``(width, height)`` that the image's header declares.

        Raises:
            DataError: The file is missing or not an image.
        """
        with self._open() as image:
            return image.size

    def decode(self, camera: Camera) -> Image.Image:
        """Decode the image as RGB; transparency is dropped.

        Raises:
            DataError: The file is missing, truncated or not an image, its size differs from the
                camera's, or its pixels do not convert to RGB without loss.
        """
        with self._open() as image:
            # Before decoding: a small file can declare an image that exhausts the memory.
            self._expect_size(image, camera)
            return to_rgb(image, self.image)

    def _expect_size(self, image: Image.Image, camera: Camera) -> None:
        width, height = image.size
        if (width, height) != (camera.width, camera.height):
            raise DataError(
                f"expected {camera.width}x{camera.height} pixels, as the dataset's camera "
                f"has them, got {width}x{height}",
                self.image,
            )

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
