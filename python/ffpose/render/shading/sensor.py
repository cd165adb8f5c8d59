"""Camera sensor model: optics, exposure, noise, response curve, 8-bit quantization.

Every random step draws from the generator that the caller passes.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import expect, require
from ffpose.render.shading.vectors import Floats, dot

CURVE_STEPS = 4096
CURVE_TOP = 4.0
GAIN_LIMITS = (0.6, 10.0)
CRAFT_LEVEL = 0.55
FRAME_LEVEL = 0.9
BLOOM_LIMIT = 200.0
BLOOM_CELL = 4
"""Pixels per cell of the coarse grid on which glare is computed."""
GAIN_STEP = 4
"""Of so many rows and columns one is looked at to choose the exposure."""
BLUR_LIMIT = 20.0
"""Largest `Sensor.blur_px`: no camera in use is farther out of focus."""
MOTION_LIMIT = 200.0


@dataclass(frozen=True)
class Sensor:
    """Parameters of a camera sensor; zero switches an effect off.

    Attributes:
        blur_px: Standard deviation of the optics' blur, in pixels of an image 1280 wide; at most
            `BLUR_LIMIT`.
        vignette: Fraction of the light lost in the corners.
        bloom: Fraction of the light beyond full scale that glare spreads around.
        full_well: Electrons at full scale, at least 1; sets the shot noise.
        read_noise: Standard deviation in electrons.
        exposure_spread: Standard deviation of the exposure error, in stops.
        motion_px: Largest motion blur, in pixels of an image 1280 wide; length and direction are
            random. The label is the pose at the middle of the exposure.
        jpeg_quality: Quality 1…100 of a JPEG compression that the image goes through.
    """

    blur_px: float = 0.7
    vignette: float = 0.2
    bloom: float = 0.05
    full_well: float = 9000.0
    read_noise: float = 12.0
    exposure_spread: float = 0.25
    motion_px: float = 0.0
    jpeg_quality: int = 0

    def __post_init__(self) -> None:
        for name in ("bloom", "read_noise", "exposure_spread"):
            value = getattr(self, name)
            expect(0 <= value < math.inf, name, "a finite number of at least 0", value)
        expect(
            1 <= self.full_well < math.inf,
            "full_well",
            "a finite number of at least 1",
            self.full_well,
        )
        expect(0 <= self.vignette < 1, "vignette", "at least 0 and below 1", self.vignette)
        for name, most in (("blur_px", BLUR_LIMIT), ("motion_px", MOTION_LIMIT)):
            expect(0 <= getattr(self, name) <= most, name, f"0…{most}", getattr(self, name))
        expect(self.jpeg_quality in range(101), "jpeg_quality", "0…100", self.jpeg_quality)


def choose_gain(
    radiance: Floats, craft: Floats, spread: float, rng: np.random.Generator, side: int = 1
) -> float:
    """Choose an exposure as a camera operator would, with a random error of ``spread`` stops.

    The brighter parts of ``craft`` (3, N), radiance of samples on the spacecraft, of which there
    may be none, come near full scale, unless much of the frame (H, W, 3) would saturate. There are
    ``side`` pixels of the frame along each side of one of ``radiance``, 1 or 2.
    """
    step = GAIN_STEP // side
    frame = _luminance(np.moveaxis(radiance[::step, ::step], -1, 0).reshape(3, -1))
    gain = FRAME_LEVEL / max(_quantile(frame, 0.85), 1e-6)
    if craft.shape[1]:
        gain = min(gain, CRAFT_LEVEL / max(_quantile(_luminance(craft), 0.9), 1e-6))
    return float(np.clip(gain, *GAIN_LIMITS) * 2 ** rng.normal(0.0, spread))


def expose(
    radiance: Floats, gain: float, sensor: Sensor, rng: np.random.Generator, side: int = 1
) -> NDArray[np.uint8]:
    """Turn radiance (H, W, 3) into 8-bit pixel values; the response is sRGB with a soft shoulder.

    Radiance is linear, sunlit white paint about 1, and 1/gain is full scale. There are ``side``
    pixels of the sensor along each side of one of ``radiance``, 1 or 2: the noise is that of their
    mean, and the cells on which glare is computed stay those of the sensor.
    """
    electrons, noise = sensor.full_well * side**2, sensor.read_noise * side
    sensor = replace(sensor, full_well=electrons, read_noise=noise)  # of the mean of its pixels
    signal = radiance * np.float32(gain)
    if sensor.bloom > 0:
        _add_bloom(signal, sensor.bloom, BLOOM_CELL // side)
    if sensor.blur_px > 0:
        signal = _blur(signal, sensor.blur_px * signal.shape[1] / 1280)
    if sensor.motion_px > 0:
        signal = _smear(signal, sensor.motion_px * signal.shape[1] / 1280, rng)
    if sensor.vignette > 0:
        signal *= _vignette(*signal.shape[:2], sensor.vignette)
    _add_noise(signal, sensor, rng)
    signal *= np.float32(CURVE_STEPS / CURVE_TOP)
    np.clip(signal, 0, CURVE_STEPS - 1, out=signal)
    image = _curve().take(signal.astype(np.int32))
    return through_jpeg(image, sensor.jpeg_quality) if sensor.jpeg_quality else image


def _luminance(rgb: Floats) -> Floats:
    return dot((0.2126, 0.7152, 0.0722), rgb)


def _quantile(values: Floats, part: float) -> float:
    place = int(part * (len(values) - 1))
    return float(np.partition(values, place)[place])


def _add_noise(signal: Floats, sensor: Sensor, rng: np.random.Generator) -> None:
    """Add read noise and shot noise (normal approximation), in one draw for each value."""
    spread = np.maximum(signal, 0)
    spread *= np.float32(1 / sensor.full_well)
    spread += np.float32((sensor.read_noise / sensor.full_well) ** 2)
    np.sqrt(spread, out=spread)
    spread *= rng.standard_normal(signal.shape, dtype=np.float32)
    signal += spread


def _blur(image: Floats, sigma: float) -> Floats:
    """Blur by a separable kernel of standard deviation `sigma`, replicating the border."""
    center, *sides = _bell(sigma)
    reach = len(sides)
    for axis in (0, 1):
        width = [(reach, reach) if each == axis else (0, 0) for each in range(3)]
        padded = np.pad(image, width, mode="edge")
        size = image.shape[axis]
        image = image * center
        for step, side in enumerate(sides, start=1):
            for start in (reach - step, reach + step):
                part = slice(start, start + size)
                image += side * (padded[part] if axis == 0 else padded[:, part])
    return image


def _bell(sigma: float) -> Floats:
    """Return blur weights at 0, 1, … pixels of variance sigma²: three taps, or a Gaussian."""
    if sigma * sigma / 2 <= 1 / 3:
        side = np.float32(sigma * sigma / 2)
        return np.array([1 - 2 * side, side], dtype=np.float32)
    bell = np.exp(-0.5 * (np.arange(math.ceil(4 * sigma) + 1) / sigma) ** 2)
    return np.asarray(bell / (2 * bell.sum() - 1), dtype=np.float32)


def _smear(image: Floats, longest: float, rng: np.random.Generator) -> Floats:
    """Apply motion blur along a random segment of at most `longest` pixels, about its middle."""
    length, angle = rng.uniform(0.0, longest), rng.uniform(0.0, math.pi)
    reach = math.ceil(length / 2) + 1
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    steps = math.ceil(length) + 1
    total = np.zeros_like(image)
    for way in (np.arange(steps) + 0.5) / steps * length - length / 2:
        total += _moved(padded, reach, way * math.cos(angle), way * math.sin(angle), image.shape)
    total *= np.float32(1 / steps)
    return total


def _moved(padded: Floats, reach: int, x: float, y: float, shape: tuple[int, ...]) -> Floats:
    """Return the inner part, of the given shape, of a padded image shifted by (x, y) pixels."""
    column, row = math.floor(x), math.floor(y)
    right, down = x - column, y - row
    moved = np.zeros(shape, dtype=np.float32)
    for i, vertical in ((row, 1 - down), (row + 1, down)):
        for j, horizontal in ((column, 1 - right), (column + 1, right)):
            part = padded[reach + i : reach + i + shape[0], reach + j : reach + j + shape[1]]
            moved += np.float32(vertical * horizontal) * part
    return moved


def through_jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return an image ``(H, W, 3)`` as a JPEG file of a quality has it, read-only."""
    pillow = require("PIL.Image", "render")
    file = io.BytesIO()
    pillow.fromarray(image).save(file, "JPEG", quality=quality)
    with pillow.open(file) as read:
        return np.asarray(read.convert("RGB"))


def _add_bloom(signal: Floats, share: float, cell: int) -> None:
    """Spread the light beyond full scale over a wide halo, by cells of `cell` pixels; in place."""
    if signal.max() <= 1:
        return
    height, width = (side // cell for side in signal.shape[:2])
    whole = signal[: height * cell, : width * cell]
    beyond = np.clip(whole - 1, 0, BLOOM_LIMIT).reshape(height, cell, width, cell, 3)
    excess = np.zeros((height, width, 3), dtype=np.float32)
    for row, column in np.ndindex(cell, cell):  # several times as fast as a mean over two axes
        excess += beyond[:, row, :, column]
    excess /= cell * cell
    spectrum = np.fft.rfft2(excess, (2 * height, 2 * width), axes=(0, 1))
    spectrum *= _halo_spectrum(height, width)[..., None]
    halo = np.fft.irfft2(spectrum, axes=(0, 1))[:height, :width]
    glare: Floats = np.maximum(halo * share, 0).astype(np.float32)
    signal += _stretch(_stretch(glare, signal.shape[0], 0, cell), signal.shape[1], 1, cell)


def _stretch(coarse: Floats, size: int, axis: int, cell: int) -> Floats:
    """Interpolate one axis of (h, w, 3) linearly, `cell` pixels for each cell."""
    place = (np.arange(size) + 0.5) / cell - 0.5
    place = np.clip(place, 0, coarse.shape[axis] - 1.001).astype(np.float32)
    low = place.astype(np.intp)
    part = (place - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    first = coarse.take(low, axis)
    step = coarse.take(low + 1, axis)
    step -= first
    step *= part
    first += step
    return first


@lru_cache(maxsize=4)
def _halo_spectrum(height: int, width: int) -> NDArray[np.complex128]:
    """Return the spectrum of a halo of weight one, a narrow and a wide bell, at twice the size."""
    y = np.fft.fftfreq(2 * height, 1 / (2 * height))[:, None]
    x = np.fft.fftfreq(2 * width, 1 / (2 * width))[None, :]
    distance = (x * x + y * y) / width**2
    halo = sum(
        weight * bell / bell.sum()
        for weight, bell in (
            (0.7, np.exp(-distance / (2 * 0.012**2))),
            (0.3, 1 / (1 + distance / 0.02**2) ** 1.5),
        )
    )
    return np.fft.rfft2(halo)


@lru_cache(maxsize=4)
def _vignette(height: int, width: int, loss: float) -> Floats:
    y = (np.arange(height) + 0.5) / height * 2 - 1
    x = (np.arange(width) + 0.5) / width * 2 - 1
    kept = 1 - loss * (y[:, None] ** 2 + x[None, :] ** 2) / 2
    return kept[..., None].astype(np.float32)


@lru_cache(maxsize=1)
def _curve() -> NDArray[np.uint8]:
    """Tabulate the response from radiance 0…`CURVE_TOP` to 8 bits: sRGB, a shoulder above 0.7."""
    x = (np.arange(CURVE_STEPS) + 0.5) * CURVE_TOP / CURVE_STEPS
    knee = 0.7
    x = np.where(x < knee, x, knee + (1 - knee) * (1 - np.exp(-(x - knee) / (1 - knee))))
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(encoded * 255), dtype=np.uint8)
