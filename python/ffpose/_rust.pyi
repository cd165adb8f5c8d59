"""Compiled core. Arrays must be C-contiguous, aligned, and of one dtype within a call.

Every function raises TypeError for an argument that is not an array of float32 or float64 (of
uint16 and int32 for a texture),
ValueError for a shape, stride or value, or memory that a call in another thread writes to, or uses
where this one writes, and MemoryError if working memory cannot be allocated.

The functions for torch tensors write to tensors that the caller allocated and that do not overlap
the inputs, except that the filter's result may be its input itself. They also take bfloat16, with
a weight of the same dtype or of float32, and run in torch's threads. A tensor that another thread
gave other memory meanwhile is a RuntimeError.
"""

from collections.abc import Sequence
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

__all__ = [
    "Tracker",
    "__version__",
    "canonical_quaternion",
    "esa_score",
    "euler_to_quaternion",
    "filter_tensors",
    "filter_tensors_backward",
    "fractal_noise",
    "has_vnni",
    "isa",
    "isas",
    "normalize_quaternion",
    "normalize_quaternion_backward",
    "quaternion_to_euler",
    "rotation_error",
    "sample_texture",
    "shade_earth",
    "spectral_filter",
    "spectral_filter_backward",
    "speed_plus_score",
    "translation_error",
]

__version__: str

_Real = TypeVar("_Real", np.float32, np.float64)

def spectral_filter(
    x: NDArray[_Real],
    weight: NDArray[_Real],
    layout: str,
    num_threads: int = 1,
    out: NDArray[_Real] | None = None,
) -> NDArray[_Real]: ...
def spectral_filter_backward(
    grad: NDArray[_Real],
    x: NDArray[_Real],
    weight: NDArray[_Real],
    layout: str,
    need_x: bool,
    need_weight: bool,
    num_threads: int = 1,
) -> tuple[NDArray[_Real] | None, NDArray[_Real] | None]: ...
def filter_tensors(x: Tensor, weight: Tensor, y: Tensor, layout: str, num_threads: int) -> None: ...
def filter_tensors_backward(
    grad: Tensor,
    x: Tensor,
    weight: Tensor,
    grad_x: Tensor | None,
    grad_weight: Tensor | None,
    layout: str,
    num_threads: int,
) -> None: ...
def has_vnni() -> bool: ...
def isa() -> str: ...
def isas() -> list[str]: ...
def fractal_noise(
    points: NDArray[np.float32], heights: NDArray[np.float32]
) -> NDArray[np.float32]: ...
def sample_texture(
    texels: NDArray[np.uint16],
    sides: tuple[int, int],
    wrap: tuple[int, int],
    corners: NDArray[np.float32],
    means: NDArray[np.uint16],
    face: NDArray[np.int32],
    weights: NDArray[np.float32],
    levels: NDArray[np.float32],
    shares: NDArray[np.float32],
) -> NDArray[np.float32]: ...
def shade_earth(
    rays: NDArray[np.float32],
    nadir: Sequence[float],
    altitude: float,
    sun: Sequence[float],
    ground: Sequence[Sequence[float]],
    detail: int,
    pixel_angle: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def normalize_quaternion(q: NDArray[_Real]) -> NDArray[_Real]: ...
def normalize_quaternion_backward(grad: NDArray[_Real], q: NDArray[_Real]) -> NDArray[_Real]: ...
def canonical_quaternion(q: NDArray[_Real]) -> NDArray[_Real]: ...
def quaternion_to_euler(q: NDArray[_Real]) -> NDArray[_Real]: ...
def euler_to_quaternion(rpy: NDArray[_Real]) -> NDArray[_Real]: ...
def translation_error(t_hat: NDArray[_Real], t: NDArray[_Real]) -> NDArray[_Real]: ...
def rotation_error(q_hat: NDArray[_Real], q: NDArray[_Real]) -> NDArray[_Real]: ...
def esa_score(
    t_hat: NDArray[_Real], q_hat: NDArray[_Real], t: NDArray[_Real], q: NDArray[_Real]
) -> NDArray[_Real]: ...
def speed_plus_score(
    t_hat: NDArray[_Real], q_hat: NDArray[_Real], t: NDArray[_Real], q: NDArray[_Real]
) -> NDArray[_Real]: ...

_Axes = Sequence[tuple[Sequence[float], int]]
"""Directions, and the numbers of turns about them, 0 for any angle."""

@final
class Tracker:
    def __new__(cls, settings: dict[str, list[float]], axes: _Axes) -> Tracker: ...
    @staticmethod
    def from_state(state: bytes, tag: bytes, axes: _Axes) -> Tracker: ...
    def state(self, tag: bytes) -> bytes: ...
    def step(
        self,
        time: float,
        poses: Sequence[tuple[Any, ...]] | None,
        camera_rate: Sequence[float],
    ) -> dict[str, Any]: ...
    def expected(self, time: float, camera_rate: Sequence[float]) -> list[float] | None: ...
    def alternative(self) -> dict[str, Any] | None: ...
    @property
    def time(self) -> float | None: ...
