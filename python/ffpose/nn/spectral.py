"""Learnable spectral filters: `SpectralFilter`, `SequenceFilter`, and GFNet's `GlobalFilter`.

All compute ``irfft2(rfft2(x) * W)`` with `ffpose.ops.spectral_filter`. GFNet and FMLP-Rec use
``norm="ortho"``; the norms of the two transforms cancel, so the values of their weights can be used
unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import index

import torch
from torch import Tensor, nn

from ffpose.errors import expect
from ffpose.nn.resampling import resample_weight
from ffpose.ops import Layout, spectral_filter, weight_shape
from ffpose.ops.bridge import check_tensor

INIT_STD = 0.02


class SpectralFilter(nn.Module):
    """Learnable filter: multiplies the half spectrum of its input by a weight.

    The paper's filter layer (Ye et al., Sensors 2023, 23, 8633, Eq. 1-3) is layout ``"tokens"``.

    The weight is initialized to small Gaussian noise rather than ones: with ``x + filter(norm(x))``
    a filter near zero makes a new block close to the identity, while ones would double the
    residual stream in every block.

    Args:
        size: ``(X, Y)`` in layout ``"tokens"``; ``(H, W, C)`` in layout ``"grid"``.
        layout: ``"tokens"`` or ``"grid"``.
        std: Standard deviation of the real and imaginary parts at initialization.
        device: Device of the parameter.
        dtype: Dtype of the parameter: float32, float64 or half precision. Half precision input
            takes a float32 weight too, as under autocast.

    Attributes:
        weight: Real parameter ``(X, Y//2+1, 2)`` or ``(H, W//2+1, C, 2)``.

    Raises:
        ValueError: ``layout`` is unknown, or ``size`` has the wrong length or an entry below one.
        TypeError: ``dtype`` is not one of those above, or ``size`` holds no whole numbers.

    Examples:
        >>> filter = SpectralFilter((14, 14, 256), layout="grid")
        >>> filter(torch.zeros(2, 14, 14, 256)).shape
        torch.Size([2, 14, 14, 256])
    """

    def __init__(
        self,
        size: Sequence[int],
        layout: Layout = "tokens",
        *,
        std: float = INIT_STD,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        if not isinstance(size, int):  # `weight_shape` refuses the one number
            size = _whole("size", size)
        shape = weight_shape(size, layout)
        expect(min(size) >= 1, "size", "each at least 1", size)
        self.size = tuple(size)
        self.layout = layout
        self.std = std
        self.weight = _new_parameter(shape, device, dtype)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Reinitialize the weight."""
        nn.init.normal_(self.weight, std=self.std)

    def forward(self, x: Tensor) -> Tensor:
        """Filter ``x (..., *size)``; any number of leading dimensions.

        Raises:
            ValueError: The last dimensions are not ``size``, or the device is not the weight's.
            TypeError: ``x`` is no tensor, or its dtype does not match the weight's.
        """
        if not isinstance(x, Tensor) or tuple(x.shape[-len(self.size) :]) != self.size:
            raise _wrong(x, f"(..., {', '.join(map(str, self.size))})")
        return spectral_filter(x, self.weight, self.layout)

    def resized(self, size: Sequence[int]) -> SpectralFilter:
        """Return a new filter with the same kernel for another size (`ffpose.nn.resampling`).

        Its parameter has the same dtype, device and ``requires_grad``. Layout ``"grid"`` must keep
        its number of channels.

        Raises:
            ValueError: ``size`` has the wrong length, an entry below one, or other channels.
            TypeError: ``size`` holds no whole numbers.
        """
        size = _whole("size", size)
        if len(size) != len(self.size) or min(size) < 1 or size[2:] != self.size[2:]:
            wanted = ", ".join(["rows", "columns", *map(str, self.size[2:])])
            raise ValueError(f"size: expected ({wanted}), each at least 1, got {size}")
        weight = resample_weight(self.weight, self.size, size[:2], self.layout)
        twin = SpectralFilter(size, self.layout, std=self.std, device="meta")
        twin.weight = _parameter_like(self.weight, weight)
        return twin.train(self.training)

    def extra_repr(self) -> str:
        """Return the arguments shown in the representation."""
        return f"{self.size}, layout={self.layout!r}"


class SequenceFilter(nn.Module):
    """Learnable filter along the tokens of a sequence, with a half spectrum for each channel.

    This is the filter layer of FMLP-Rec (Zhou et al., "Filter-enhanced MLP is All You Need for
    Sequential Recommendation", 2022) and of many time-series models. It is layout ``"grid"`` with
    one row. ``complex_weight`` of FMLP-Rec, ``(1, L//2+1, C, 2)``, is ``weight[None]`` here.

    Args:
        length: Number of tokens L.
        dim: Number of channels C.
        std: As of `SpectralFilter`, and so are the next two.
        device: Device of the parameter.
        dtype: Dtype of the parameter.

    Attributes:
        weight: Real parameter ``(L//2+1, C, 2)``.

    Raises:
        ValueError: ``length`` or ``dim`` is below one.
        TypeError: ``dtype`` is not one of those, or an argument is no whole number.

    Examples:
        >>> filter = SequenceFilter(50, 64)
        >>> filter(torch.zeros(2, 50, 64)).shape
        torch.Size([2, 50, 64])
    """

    def __init__(
        self,
        length: int,
        dim: int,
        *,
        std: float = INIT_STD,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        length, dim = _whole("length, dim", (length, dim))
        expect(min(length, dim) >= 1, "length, dim", "each at least 1", (length, dim))
        self.length, self.dim = length, dim
        self.std = std
        shape = weight_shape((1, length, dim), "grid")[1:]
        self.weight = _new_parameter(shape, device, dtype)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Reinitialize the weight."""
        nn.init.normal_(self.weight, std=self.std)

    def forward(self, x: Tensor) -> Tensor:
        """Filter ``x (..., L, C)``; any number of leading dimensions.

        Raises:
            ValueError: The last dimensions are not ``(L, C)``, or the device is not the weight's.
            TypeError: ``x`` is no tensor, or its dtype does not match the weight's.
        """
        if not isinstance(x, Tensor) or tuple(x.shape[-2:]) != (self.length, self.dim):
            raise _wrong(x, f"(..., {self.length}, {self.dim})")
        return spectral_filter(x.unsqueeze(-3), self.weight.unsqueeze(0), "grid").squeeze(-3)

    def resized(self, length: int) -> SequenceFilter:
        """Return a new filter with the same kernel for another length, as `SpectralFilter.resized`.

        Raises:
            ValueError: ``length`` is below one.
            TypeError: ``length`` is no whole number.
        """
        (length,) = _whole("length", (length,))
        expect(length >= 1, "length", "at least 1", length)
        grid = (1, self.length, self.dim)
        weight = resample_weight(self.weight.unsqueeze(0), grid, (1, length), "grid").squeeze(0)
        twin = SequenceFilter(length, self.dim, std=self.std, device="meta")
        twin.weight = _parameter_like(self.weight, weight)
        return twin.train(self.training)

    def extra_repr(self) -> str:
        """Return the arguments shown in the representation."""
        return f"{self.length}, {self.dim}"


class GlobalFilter(nn.Module):
    """Drop-in replacement for GFNet's `GlobalFilter`: same arguments, parameter name and forward.

    Rao et al., "Global Filter Networks for Image Classification", 2021. The original casts every
    input to float32; here the output has the input's dtype. Half precision input works with the
    float32 weight, as under autocast; float64 input needs a float64 weight (``filter.double()``).

    Args:
        dim: Number of channels C.
        h: Number of rows of the grid.
        w: Number of columns of the half spectrum, ``columns // 2 + 1``.

    Attributes:
        complex_weight: Real parameter ``(h, w, dim, 2)``.

    Raises:
        ValueError: An argument is below one.
        TypeError: An argument is no whole number.
    """

    def __init__(self, dim: int, h: int = 14, w: int = 8) -> None:
        super().__init__()
        dim, h, w = _whole("dim, h, w", (dim, h, w))
        expect(min(dim, h, w) >= 1, "dim, h, w", "each at least 1", (dim, h, w))
        self.dim, self.h, self.w = dim, h, w
        self.complex_weight = nn.Parameter(torch.empty(h, w, dim, 2))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Reinitialize the weight."""
        nn.init.normal_(self.complex_weight, std=INIT_STD)

    def forward(self, x: Tensor, spatial_size: tuple[int, int] | None = None) -> Tensor:
        """Filter ``x (B, N, C)``, whose tokens are a grid in row-major order.

        Args:
            x: ``(B, N, C)`` with ``C = dim``.
            spatial_size: ``(rows, columns)`` of the grid, with product N; a square when None.

        Returns:
            ``(B, N, C)``.

        Raises:
            ValueError: The grid does not fit the weight, or ``x`` does not fit the grid.
            TypeError: ``x`` is no tensor, its dtype does not match the weight's, or
                ``spatial_size`` holds no whole numbers.
        """
        rows, columns = self._grid(spatial_size)
        wanted = (rows * columns, self.dim)
        if not isinstance(x, Tensor) or x.dim() != 3 or x.shape[1:] != wanted:
            raise _wrong(x, f"(B, {wanted[0]}, {wanted[1]}) for a grid of {(rows, columns)}")
        grid = x.reshape(x.shape[0], rows, columns, self.dim)
        return spectral_filter(grid, self.complex_weight, "grid").reshape(x.shape)

    def resized(
        self, size: tuple[int, int], spatial_size: tuple[int, int] | None = None
    ) -> GlobalFilter:
        """Return a new filter with the same kernel for another grid, as `SpectralFilter.resized`.

        Args:
            size: ``(rows, columns)`` of the new grid; if it is not square, `forward` needs
                ``spatial_size``.
            spatial_size: ``(rows, columns)`` of this filter's grid; a square when None, as in
                `forward`. It cannot be inferred, as even and odd columns have equal weight shapes.

        Raises:
            ValueError: An entry of ``size`` is below one, or ``spatial_size`` does not match the
                weight.
            TypeError: One of them holds no whole numbers.
        """
        rows, columns = self._grid(spatial_size)
        size_to_be = _whole("size", size)
        if len(size_to_be) != 2 or min(size_to_be) < 1:
            raise ValueError(f"size: expected (rows, columns), each at least 1, got {size_to_be}")
        grid = (rows, columns, self.dim)
        weight = resample_weight(self.complex_weight, grid, size_to_be, "grid")
        with torch.device("meta"):
            twin = GlobalFilter(self.dim, *weight.shape[:2])
        twin.complex_weight = _parameter_like(self.complex_weight, weight)
        return twin.train(self.training)

    def _grid(self, spatial_size: tuple[int, int] | None) -> tuple[int, int]:
        """Return rows and columns of the grid, a square when None, checked against the weight."""
        size = (self.h, self.h) if spatial_size is None else _whole("spatial_size", spatial_size)
        if len(size) != 2:
            raise ValueError(f"spatial_size: expected (rows, columns), got {spatial_size}")
        rows, columns = size
        if (rows, columns // 2 + 1) != (self.h, self.w):
            raise ValueError(
                f"spatial_size: expected {self.h} rows, and columns with"
                f" columns // 2 + 1 = {self.w}, got {(rows, columns)}"
            )
        return rows, columns

    def extra_repr(self) -> str:
        """Return the arguments shown in the representation."""
        return f"{self.dim}, h={self.h}, w={self.w}"


def _whole(name: str, values: Sequence[int] | int) -> tuple[int, ...]:
    """Return whole numbers as int; a single one gives length one, which is rejected later.

    Raises:
        TypeError: One is not, or there are no values.
    """
    try:
        given = (values,) if isinstance(values, int) else values
        # `index` of a size that is being recorded would make a constant of it.
        return tuple(v if type(v) in (int, torch.SymInt) else index(v) for v in given)
    except TypeError as error:
        raise TypeError(f"{name}: expected whole numbers, got {values!r}") from error


def _wrong(x: object, shape: str) -> Exception:
    """Return the error of an input that is no tensor, or none of ``shape``."""
    if not isinstance(x, Tensor):
        return TypeError(f"x: expected a torch.Tensor, got {type(x).__name__}")
    return ValueError(f"x: expected shape {shape}, got {tuple(x.shape)}")


def _new_parameter(
    shape: Sequence[int], device: torch.device | str | None, dtype: torch.dtype | None
) -> nn.Parameter:
    """Return an uninitialized parameter, of a dtype that the filter supports."""
    data = torch.empty(shape, device=device, dtype=dtype)
    check_tensor("dtype", data)
    return nn.Parameter(data)


def _parameter_like(parameter: nn.Parameter, data: Tensor) -> nn.Parameter:
    return nn.Parameter(data, requires_grad=parameter.requires_grad)
