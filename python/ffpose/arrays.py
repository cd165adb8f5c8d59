"""NumPy functions over the compiled core.

Arguments are float32 or float64; all arguments of a call and its result have the same dtype. Lists
of floats (read as float64) and arrays with any strides are accepted. Nothing is ever cast:
integers, half precision and mixed dtypes raise `TypeError`. Quaternions are Hamilton's, scalar
first ``(w, x, y, z)``; angles are in degrees, translations in meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose import _rust

__version__ = _rust.__version__

RealArray = NDArray[np.float32] | NDArray[np.float64]


def spectral_filter(
    x: ArrayLike,
    weight: ArrayLike,
    layout: str = "tokens",
    num_threads: int = 1,
    *,
    out: RealArray | None = None,
) -> RealArray:
    """Filter images in the frequency domain: ``irfft2(rfft2(x) * weight)``.

    The result equals that of ``torch.fft`` with its default norm, for any weight: in the DC column,
    and in the Nyquist column where the second axis is even, only the Hermitian part of the weight
    has an effect. This is the global filter of Ye et al., Sensors 2023, 23(20), 8633, Eq. 1-3
    (``"tokens"``), and of GFNet (``"grid"``).

    Args:
        x: Images ``(..., X, Y)`` transformed over both axes, or, with layout ``"grid"``, images
            ``(..., H, W, C)`` transformed over H and W for each channel. Any size, any number of
            leading axes.
        weight: Half spectrum ``(X, Y // 2 + 1, 2)`` or ``(H, W // 2 + 1, C, 2)``; the last axis
            holds real and imaginary parts.
        layout: ``"tokens"`` or ``"grid"``.
        num_threads: Largest number of threads to use; small inputs use one. The result is
            bit-identical for any number.
        out: C-contiguous array of the shape and dtype of ``x`` to write to: memory of its own, or
            all of ``x``, which is then filtered in place. A new array by default, whose page faults
            take about as long as a large filter.

    Returns:
        ``out``, or an array of the shape of ``x``.

    Raises:
        TypeError: An argument is not an array of float32 or float64, or they differ.
        ValueError: The shape of ``x``, ``weight`` or ``out``, ``layout`` or ``num_threads`` is not
            as above, ``out`` shares a part of its memory with another argument, or a call in
            another thread writes to memory of this one, or uses ``out``.

    Examples:
        A weight of one is the identity:

        >>> x = np.arange(12.0).reshape(3, 4)
        >>> weight = np.zeros((3, 3, 2))
        >>> weight[..., 0] = 1
        >>> bool(np.allclose(spectral_filter(x, weight), x))
        True
    """
    x, weight = _arrays(x=x, weight=weight)
    if weight.dtype.kind == "c":
        raise TypeError(
            "weight must have real and imaginary part in a last axis, as"
            f" np.stack((weight.real, weight.imag), -1), got {weight.dtype}"
        )
    if out is None:
        return _rust.spectral_filter(x, weight, layout, num_threads)
    if not isinstance(out, np.ndarray):
        raise TypeError(f"out must be a numpy.ndarray, got {type(out)}")
    if out.shape != x.shape:
        raise ValueError(f"out must have the shape of x {x.shape}, got {out.shape}")
    is_x = out.ctypes.data == x.ctypes.data and out.strides == x.strides and out.dtype == x.dtype
    _rust.spectral_filter(out if is_x else x, weight, layout, num_threads, out)
    return out


def normalize_quaternion(q: ArrayLike) -> RealArray:
    """Divide quaternions by their norms.

    Args:
        q: Quaternions ``(..., 4)``. A NaN propagates to its quaternion's result.

    Returns:
        Unit quaternions ``(..., 4)``, with the signs of ``q``.

    Raises:
        TypeError: ``q`` is not of float32 or float64.
        ValueError: ``q`` is not ``(..., 4)``, or a quaternion is zero; the message names its row.

    Examples:
        >>> normalize_quaternion([0.0, 3.0, 0.0, 4.0])
        array([0. , 0.6, 0. , 0.8])
    """
    return _rust.normalize_quaternion(_array(q, "q"))


def canonical_quaternion(q: ArrayLike) -> RealArray:
    """Choose the one of ``q`` and ``-q`` with ``w > 0``; both are the same rotation.

    Where ``w`` is zero, the first nonzero component is made positive.

    Args:
        q: Quaternions ``(..., 4)`` of any nonzero norm; the norm is kept.

    Returns:
        Quaternions ``(..., 4)``.

    Raises:
        TypeError: ``q`` is not of float32 or float64.
        ValueError: ``q`` is not ``(..., 4)``, or a quaternion is zero; the message names its row.

    Examples:
        >>> canonical_quaternion([[-0.6, 0.0, 0.8, 0.0], [0.6, 0.0, 0.8, 0.0]])
        array([[ 0.6,  0. , -0.8,  0. ],
               [ 0.6,  0. ,  0.8,  0. ]])
    """
    return _rust.canonical_quaternion(_array(q, "q"))


def quaternion_to_euler(q: ArrayLike) -> RealArray:
    """Convert quaternions to roll, pitch and yaw: rotations about fixed x, then y, then z (ZYX).

    Ye et al., Sensors 2023, 23(20), 8633, Eq. 12, with the minus in the pitch that inverts its
    two arctangents: ``sin(pitch) = 2 (w y - x z)``. At a pitch of ±90° (gimbal lock) roll is zero.

    Args:
        q: Quaternions ``(..., 4)`` of any nonzero norm. A NaN propagates to its quaternion's
            result.

    Returns:
        Angles ``(..., 3)`` in degrees: roll and yaw in (-180, 180], pitch in [-90, 90]; those of
        ``-q`` are the same.

    Raises:
        TypeError: ``q`` is not of float32 or float64.
        ValueError: ``q`` is not ``(..., 4)``, or a quaternion is zero; the message names its row.

    Examples:
        >>> quaternion_to_euler([1.0, 0.0, 0.0, 1.0]).round(6) + 0.0
        array([ 0.,  0., 90.])
    """
    return _rust.quaternion_to_euler(_array(q, "q"))


def euler_to_quaternion(rpy: ArrayLike) -> RealArray:
    """Convert roll, pitch and yaw to quaternions: the inverse of `quaternion_to_euler`.

    Args:
        rpy: Angles ``(..., 3)`` in degrees.

    Returns:
        Unit quaternions ``(..., 4)``, the canonical ones (`canonical_quaternion`).

    Raises:
        TypeError: ``rpy`` is not of float32 or float64.
        ValueError: ``rpy`` is not ``(..., 3)``.

    Examples:
        >>> euler_to_quaternion([180.0, 0.0, 0.0]).round(6) + 0.0
        array([0., 1., 0., 0.])
    """
    return _rust.euler_to_quaternion(_array(rpy, "rpy"))


def translation_error(t_hat: ArrayLike, t: ArrayLike) -> RealArray:
    """Compute the distances of estimated translations from the true ones.

    Args:
        t_hat: Estimated translations ``(N, 3)`` in meters.
        t: True translations ``(N, 3)`` in meters.

    Returns:
        Euclidean distances ``(N,)`` in meters.

    Raises:
        TypeError: An argument is not of float32 or float64, or the two differ.
        ValueError: A shape is not ``(N, 3)``, or a value is not finite; the message names its row.

    Examples:
        >>> translation_error([[3.0, 0.0, 14.0]], [[0.0, 0.0, 10.0]])
        array([5.])
    """
    return _rust.translation_error(*_arrays(t_hat=t_hat, t=t))


def rotation_error(q_hat: ArrayLike, q: ArrayLike) -> RealArray:
    """Compute the rotation angles between estimated and true orientations.

    Equal to ``2 acos(min(1, |<q_hat, q>|))`` of unit quaternions, but computed by the arctangent of
    the parts of ``q^-1 q_hat``, which is accurate for small angles. ``q`` and ``-q`` are the same.

    Args:
        q_hat: Estimated orientations ``(N, 4)``, of any nonzero norm.
        q: True orientations ``(N, 4)``, of any nonzero norm.

    Returns:
        Angles ``(N,)`` in degrees, from 0 to 180.

    Raises:
        TypeError: An argument is not of float32 or float64, or the two differ.
        ValueError: A shape is not ``(N, 4)``, a quaternion is zero, or a value is not finite; the
            message names its row.

    Examples:
        >>> rotation_error([[-1.0, 0.0, 0.0, -1.0]], [[1.0, 0.0, 0.0, 0.0]]).round(9)
        array([90.])
    """
    return _rust.rotation_error(*_arrays(q_hat=q_hat, q=q))


def esa_score(t_hat: ArrayLike, q_hat: ArrayLike, t: ArrayLike, q: ArrayLike) -> RealArray:
    """Compute the score of ESA's Kelvins Pose Estimation Challenge 2019 for each sample.

    The translation error divided by the true distance, plus the rotation error in radians; the
    challenge ranks by the mean.

    Args:
        t_hat: Estimated translations ``(N, 3)`` in meters.
        q_hat: Estimated orientations ``(N, 4)``.
        t: True translations ``(N, 3)`` in meters.
        q: True orientations ``(N, 4)``.

    Returns:
        Scores ``(N,)``; zero is best.

    Raises:
        TypeError: An argument is not of float32 or float64, or two differ.
        ValueError: A shape is not as above, a vector of ``q_hat``, ``t`` or ``q`` is zero, or a
            value is not finite; the message names its row.

    Examples:
        >>> q = [[1.0, 0.0, 0.0, 0.0]]
        >>> esa_score([[3.0, 0.0, 14.0]], q, [[0.0, 0.0, 10.0]], q)
        array([0.5])
    """
    return _rust.esa_score(*_arrays(t_hat=t_hat, q_hat=q_hat, t=t, q=q))


def speed_plus_score(t_hat: ArrayLike, q_hat: ArrayLike, t: ArrayLike, q: ArrayLike) -> RealArray:
    """Compute the score of the SPEED+ challenge (SPEC2021) for each sample.

    As `esa_score`, whose arguments, result and errors it has, but a relative translation error
    below 0.002173 and a rotation error below 0.169 degrees, the accuracy of the labels, each count
    as zero.

    Examples:
        >>> q = [[1.0, 0.0, 0.0, 0.0]]
        >>> speed_plus_score([[0.0, 0.0, 10.01]], q, [[0.0, 0.0, 10.0]], q)
        array([0.])
    """
    return _rust.speed_plus_score(*_arrays(t_hat=t_hat, q_hat=q_hat, t=t, q=q))


def fractal_noise(points: ArrayLike, heights: ArrayLike) -> NDArray[np.float32]:
    """Compute three-dimensional fractal value noise ``(N,)``, a sum of octaves, in float32.

    Each octave has a random value in -1…1 at every lattice point and is smooth between; its lattice
    is rotated and about twice as fine as that of the octave before. The result is bit-identical on
    every machine; NaN in a point propagates.

    Args:
        points: Points ``(3, N)``; the lattice points of the first octave are 1 apart.
        heights: Amplitudes of the octaves, ``(K,)``.
    """
    return _rust.fractal_noise(*_arrays(points=points, heights=heights))


def sample_texture(
    texels: ArrayLike,
    sides: tuple[int, int],
    wrap: tuple[int, int],
    corners: ArrayLike,
    means: ArrayLike,
    face: ArrayLike,
    weights: ArrayLike,
    levels: ArrayLike,
    shares: ArrayLike,
) -> NDArray[np.float32]:
    """Interpolate a texture with mip levels at points on the faces of a mesh, in float32.

    Values ``(4, N)`` are interpolated between the four nearest texels of the nearest level, and
    mixed with the texture's mean over the face.

    Args:
        texels: Finite texels ``(T, 4)`` of all levels one after the other, row by row, float16. A
            level has half the sides of the one before, down to one texel.
        sides: Width and height of the first level, powers of two.
        wrap: What lies beyond the border to the right and downward: 0 the texture again, 1 the
            texture mirrored, 2 the texel at the border.
        corners: Coordinates ``(F, 3, 2)`` of the faces' corners to the right and downward, 0…1 once
            over the texture, float32, as all that follows but for the means.
        means: The texture's mean ``(F, 4)`` over each face, float16.
        face: Faces ``(N,)``, int32.
        weights: Barycentric weights ``(3, N)`` of the face's corners.
        levels: Levels ``(N,)``, 0 the first; what is beyond is the last.
        shares: Share ``(N,)`` of the face's mean.
    """
    places = _array(corners, "corners")
    if places.shape[1:] != (3, 2):
        raise ValueError(f"corners must have shape (F, 3, 2), got {places.shape}")
    return _rust.sample_texture(
        _bits(texels, "texels"),
        sides,
        wrap,
        places.reshape(-1, 6),
        _bits(means, "means"),
        *_arrays(face=face, weights=weights, levels=levels, shares=shares),
    )


def shade_earth(
    rays: ArrayLike,
    nadir: Sequence[float],
    altitude: float,
    sun: Sequence[float],
    ground: Sequence[Sequence[float]],
    detail: int,
    pixel_angle: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute radiance ``(3, N)`` and transmittance ``(N,)`` of the Earth along rays from orbit.

    Lengths are in Earth radii, vectors in the camera frame. The result is bit-identical on every
    machine.

    Args:
        rays: Unit vectors ``(3, N)``.
        nadir: Unit vector to the Earth's center.
        altitude: Height of the camera above the ground, more than zero.
        sun: Unit vector to the sun.
        ground: Rotation ``(3, 3)`` into the frame of land and clouds.
        detail: Noise octaves of the clouds, 0…16; finer images need more.
        pixel_angle: Angle that one pixel covers, radians; the limb is smoothed over it.
    """
    return _rust.shade_earth(
        _array(rays, "rays"), nadir, altitude, sun, ground, detail, pixel_angle
    )


def instruction_set() -> str:
    """Return the name of the vector instruction set that the filters use on this machine.

    Returns:
        ``"scalar"``, ``"avx2"``, ``"avx512"`` or ``"neon"``; the environment variable
        ``FFPOSE_ISA`` forces one, if it is set before ffpose is imported.
    """
    return _rust.isa()


def has_vnni() -> bool:
    """Return whether the processor adds products of 8-bit numbers in 32 bits.

    AVX512-VNNI and AVX-VNNI of x86-64 do; older ones add pairs of them in 16, which saturate.
    """
    return _rust.has_vnni()


def _arrays(**values: ArrayLike) -> list[NDArray[Any]]:
    return [_array(each, name) for name, each in values.items()]


def _array(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return ``values`` as an array for the core: copied if its strides require it, never cast."""
    if isinstance(values, np.ndarray) and hasattr(values, "mask"):
        raise TypeError(f"{name} must be an array without a mask, got {type(values).__name__}")
    array = np.asarray(values, order="C")
    return array if array.flags.aligned else array.copy()


def _bits(values: ArrayLike, name: str) -> NDArray[np.uint16]:
    """Return the bits of float16 ``values``."""
    array = _array(values, name)
    if array.dtype != np.float16:
        raise TypeError(f"{name} must be float16, got {array.dtype}")
    return array.view(np.uint16)
