"""What a filter at another size must do: the same to an image, as far as both sizes allow."""

import re

import numpy as np
import pytest
import torch
from scipy import ndimage

from ffpose.nn import GlobalFilter, SequenceFilter, SpectralFilter


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def spectral(size, layout):
    return SpectralFilter(size, layout, std=1.0, dtype=torch.float64)


def weight_of_kernel(taps, rows, columns):
    """The half spectrum ``(rows, columns//2+1, 2)`` of odd-sided taps about the origin."""
    plane = torch.zeros(rows, columns, dtype=torch.float64)
    plane[: taps.shape[0], : taps.shape[1]] = taps
    about_origin = plane.roll((-(taps.shape[0] // 2), -(taps.shape[1] // 2)), (0, 1))
    return torch.view_as_real(torch.fft.rfft2(about_origin))


SIZES = [(6, 8), (5, 7), (6, 7), (1, 4), (2, 2), (9, 1)]
PAIRS = [((6, 8), (12, 16)), ((6, 8), (7, 9)), ((5, 7), (8, 7)), ((1, 4), (3, 5)), ((2, 2), (6, 3))]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("layout", ["tokens", "grid"])
def test_the_same_size_is_the_same_filter(size, layout):
    size = size if layout == "tokens" else (*size, 3)
    module = spectral(size, layout)
    x = torch.randn(2, *size, dtype=torch.float64)
    torch.testing.assert_close(module.resized(size)(x), module(x))


@pytest.mark.parametrize(("small", "large"), PAIRS)
def test_up_and_down_again_is_the_same_filter(small, large):
    module = spectral(small, "tokens")
    x = torch.randn(2, *small, dtype=torch.float64)
    torch.testing.assert_close(module.resized(large).resized(small)(x), module(x))


@pytest.mark.parametrize("size", [(5, 6), (8, 9), (11, 16)])
def test_a_small_kernel_acts_alike_on_any_plane(size):
    taps = torch.randn(3, 5, dtype=torch.float64)
    module = spectral((7, 8), "tokens")
    module.load_state_dict({"weight": weight_of_kernel(taps, 7, 8)})
    x = torch.randn(*size, dtype=torch.float64)
    expected = ndimage.convolve(x.numpy(), taps.numpy(), mode="wrap")
    torch.testing.assert_close(module.resized(size)(x), torch.from_numpy(expected))


@pytest.mark.parametrize("size", [(3, 4), (2, 3), (12, 16), (5, 31)])
def test_the_gain_of_a_constant_is_kept(size):
    module = spectral((6, 8), "tokens")
    gain = module(torch.ones(6, 8, dtype=torch.float64))
    y = module.resized(size)(torch.ones(size, dtype=torch.float64))
    torch.testing.assert_close(y, gain[0, 0].expand(size))


@pytest.mark.parametrize(("small", "large"), [((3, 4), (6, 8)), ((5, 3), (5, 9)), ((1, 1), (6, 7))])
def test_smaller_it_does_what_the_old_filter_does_to_the_repeated_image(small, large):
    module = spectral(large, "tokens")
    x = torch.randn(small, dtype=torch.float64)
    repeats = [whole // part for whole, part in zip(large, small, strict=True)]
    expected = module(x.repeat(repeats))[: small[0], : small[1]]
    torch.testing.assert_close(module.resized(small)(x), expected)


def test_a_symmetric_kernel_stays_symmetric():
    module = spectral((6, 8), "tokens")
    with torch.no_grad():
        module.weight[..., 1] = 0  # a real response, which is made even in the lone columns
    assert module.resized((9, 12)).weight[..., 1].abs().max() < 1e-12


def test_channels_keep_their_own_kernels():
    module = spectral((6, 5, 2), "grid")
    x = torch.randn(9, 8, 2, dtype=torch.float64)
    y = module.resized((9, 8, 2))(x)
    for channel in range(2):
        plane = spectral((6, 5), "tokens")
        plane.load_state_dict({"weight": module.weight[:, :, channel]})
        torch.testing.assert_close(y[..., channel], plane.resized((9, 8))(x[..., channel]))


def test_a_sequence_is_a_grid_of_one_row():
    module = SequenceFilter(6, 3, dtype=torch.float64)
    grid = spectral((1, 6, 3), "grid")
    grid.load_state_dict({"weight": module.weight[None]})
    x = torch.randn(2, 9, 3, dtype=torch.float64)
    expected = grid.resized((1, 9, 3))(x.unsqueeze(1)).squeeze(1)
    torch.testing.assert_close(module.resized(9)(x), expected)


@pytest.mark.parametrize("columns", [14, 15])
def test_global_filter_at_another_resolution(columns):
    module = GlobalFilter(2, 14, 8)
    taps = torch.randn(3, 3, dtype=torch.float64)
    weight = weight_of_kernel(taps, 14, columns).float()
    module.load_state_dict({"complex_weight": weight[:, :, None].expand(-1, -1, 2, -1)})
    spatial_size = None if columns == 14 else (14, columns)
    resized = module.resized((24, 20), spatial_size)
    assert (resized.h, resized.w, resized.dim) == (24, 11, 2)
    x = torch.randn(1, 24, 20, 2)
    expected = ndimage.convolve(x[0, ..., 1].double().numpy(), taps.numpy(), mode="wrap")
    y = resized(x.reshape(1, 480, 2), (24, 20))[0, :, 1].reshape(24, 20)
    torch.testing.assert_close(y, torch.from_numpy(expected).float())


@pytest.mark.parametrize(
    ("module", "size"),
    [
        (SpectralFilter((4, 6), dtype=torch.float64), (8, 6)),
        (SpectralFilter((4, 6, 2), "grid"), (8, 6, 2)),
        (SequenceFilter(6, 2, dtype=torch.float64), 9),
        (GlobalFilter(2, 4, 3), (8, 8)),
    ],
)
def test_the_copy_is_one_of_its_own(module, size):
    module.requires_grad_(False).eval()
    (before,) = (parameter.clone() for parameter in module.parameters())
    twin = module.resized(size)
    (parameter,) = twin.parameters()
    assert type(twin) is type(module)
    assert (parameter.dtype, parameter.requires_grad, twin.training) == (before.dtype, False, False)
    with torch.no_grad():
        parameter.zero_()
    torch.testing.assert_close(next(module.parameters()), before)


@pytest.mark.parametrize(
    ("module", "arguments", "text"),
    [
        (SpectralFilter((4, 6)), ((4,),), r"\(rows, columns\), .* got \(4,\)"),
        (SpectralFilter((4, 6)), ((4, 0),), r"at least 1, got \(4, 0\)"),
        (SpectralFilter((4, 6, 2), "grid"), ((8, 8),), r"\(rows, columns, 2\), .* got \(8, 8\)"),
        (SpectralFilter((4, 6, 2), "grid"), ((8, 8, 3),), r"\(rows, columns, 2\), .*\(8, 8, 3\)"),
        (SequenceFilter(4, 2), (0,), "at least 1, got 0"),
        (GlobalFilter(2, 4, 3), ((8, 0),), r"at least 1, got \(8, 0\)"),
        (GlobalFilter(2, 4, 3), ((8,),), r"\(rows, columns\), .* got \(8,\)"),
        (GlobalFilter(2, 4, 4), ((8, 8),), r"expected 4 rows, .* = 4, got \(4, 4\)"),
        (GlobalFilter(2, 4, 3), ((8, 8), (4, 6)), r"expected 4 rows, .* = 3, got \(4, 6\)"),
    ],
)
def test_wrong_sizes(module, arguments, text):
    with pytest.raises(ValueError, match=text):
        module.resized(*arguments)


WRONG = [1.5, (1.5, 2), None, "ab", ([4], 4)]


@pytest.mark.parametrize("size", WRONG, ids=str)
def test_sizes_that_are_no_whole_numbers_are_refused(size):
    text = re.escape(f"size: expected whole numbers, got {size!r}")
    with pytest.raises(TypeError, match=f"^{text}"):
        SpectralFilter((4, 6)).resized(size)
    filter = GlobalFilter(2, 4, 3)
    with pytest.raises(TypeError, match=f"^{text}"):
        filter.resized(size)
    with pytest.raises(TypeError, match=r"^length: expected whole numbers, got"):
        SequenceFilter(4, 2).resized(size)
    if size is not None:
        with pytest.raises(TypeError, match=f"^spatial_{text}"):
            filter(torch.zeros(1, 16, 2), size)


@pytest.mark.parametrize("of", [np.array, torch.tensor], ids=["NumPy", "torch"])
def test_whole_numbers_of_others_are_kept_as_int(of):
    size, length = of([8, 6]), of([9])[0]
    made = (SpectralFilter(size), SpectralFilter((4, 6)).resized(size))
    assert [type(n) for module in made for n in module.size] == [int] * 4
    made = (SequenceFilter(length, 2), SequenceFilter(4, 2).resized(length))
    assert [type(module.length) for module in made] == [int] * 2
    grid = GlobalFilter(2, 4, 3).resized(size)
    assert (type(grid.h), type(grid.w)) == (int, int)
    assert grid(torch.zeros(1, 48, 2), size).shape == (1, 48, 2)


def test_another_default_device_changes_nothing():
    module = spectral((4, 6), "tokens")
    expected = module.resized((8, 7)).weight
    with torch.device("meta"):
        resized = module.resized((8, 7))
    assert torch.equal(resized.weight, expected)
