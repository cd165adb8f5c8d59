"""SpectralFilter and GlobalFilter against torch.fft as their users write it."""

import copy
import math

import numpy as np
import pytest
import torch
from torch import nn

from ffpose.nn import GlobalFilter, QuaternionActivation, SequenceFilter, SpectralFilter


class PlainGlobalFilter(nn.Module):
    """GFNet's layer from its paper: ortho-normed transforms, square grids, channels last."""

    def __init__(self, dim, h=14, w=8):
        super().__init__()
        self.complex_weight = nn.Parameter(torch.randn(h, w, dim, 2, dtype=torch.float32) * 0.02)

    def forward(self, x, spatial_size=None):
        batch, tokens, channels = x.shape
        rows, columns = spatial_size or (math.isqrt(tokens), math.isqrt(tokens))
        grid = x.view(batch, rows, columns, channels)
        spectrum = torch.fft.rfft2(grid, dim=(1, 2), norm="ortho")
        spectrum = spectrum * torch.view_as_complex(self.complex_weight)
        filtered = torch.fft.irfft2(spectrum, s=(rows, columns), dim=(1, 2), norm="ortho")
        return filtered.reshape(batch, tokens, channels)


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.mark.parametrize(
    ("arguments", "spatial_size"), [((6, 14, 8), None), ((5,), (14, 14)), ((3, 4, 4), (4, 7))]
)
def test_gfnet_weights_load_and_give_the_same_numbers(arguments, spatial_size):
    theirs, ours = PlainGlobalFilter(*arguments), GlobalFilter(*arguments)
    ours.load_state_dict(theirs.state_dict())
    rows, columns = spatial_size or (14, 14)
    x = torch.randn(2, rows * columns, arguments[0], requires_grad=True)
    torch.testing.assert_close(ours(x, spatial_size), theirs(x, spatial_size))
    for module in (theirs, ours):
        module(x, spatial_size).square().sum().backward()
    torch.testing.assert_close(ours.complex_weight.grad, theirs.complex_weight.grad)


@pytest.mark.parametrize(
    ("size", "layout", "shape", "dim"),
    [
        ((6, 8), "tokens", (6, 5, 2), (-2, -1)),
        ((5, 7), "tokens", (5, 4, 2), (-2, -1)),
        ((4, 6, 3), "grid", (4, 4, 3, 2), (-3, -2)),
    ],
)
def test_spectral_filter_is_rfft2_times_weight(size, layout, shape, dim):
    module = SpectralFilter(size, layout)
    assert {name: tuple(p.shape) for name, p in module.named_parameters()} == {"weight": shape}
    x = torch.randn(2, 3, *size)
    spectrum = torch.fft.rfft2(x, dim=dim) * torch.view_as_complex(module.weight)
    expected = torch.fft.irfft2(spectrum, s=[x.shape[d] for d in dim], dim=dim)
    torch.testing.assert_close(module(x), expected)
    torch.testing.assert_close(module(x[0, 0]), expected[0, 0])


def test_ones_pass_everything_and_a_new_filter_little():
    module = SpectralFilter((8, 6))
    x = torch.randn(4, 8, 6)
    assert module(x).std() < 0.05 * x.std()
    with torch.no_grad():
        module.weight.copy_(torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(module(x), x)


def test_half_precision_input_keeps_its_dtype():
    module = SpectralFilter((8, 6))
    assert module(torch.randn(2, 8, 6).bfloat16()).dtype == torch.bfloat16


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize(
    ("module", "shape"),
    [
        (SpectralFilter((8, 6)), (2, 8, 6)),
        (SpectralFilter((4, 6, 3), "grid"), (2, 4, 6, 3)),
        (GlobalFilter(3, 4, 3), (2, 16, 3)),
    ],
)
def test_modules_of_half_precision_train(module, shape, dtype):
    module = copy.deepcopy(module).to(dtype)
    (weight,) = module.parameters()
    x = torch.randn(shape, dtype=dtype, requires_grad=True)
    y = module(x)
    y.sum().backward()
    assert {t.dtype for t in (y, x.grad, weight.grad)} == {dtype}


def test_global_filter_of_float64_computes_in_float64():
    x, module = torch.randn(2, 16, 3, dtype=torch.float64), GlobalFilter(3, 4, 3)
    with pytest.raises(TypeError, match=r"expected torch.float64 .* got torch.float32"):
        module(x)
    module.double()
    expected = PlainGlobalFilter(3, 4, 3)
    expected.complex_weight = module.complex_weight
    torch.testing.assert_close(module(x), expected(x), rtol=0, atol=1e-14)


def test_autocast_may_hand_over_half_precision():
    linear, module = nn.Linear(6, 6), SpectralFilter((8, 6))
    with torch.autocast("cpu", torch.bfloat16):
        y = module(linear(torch.randn(2, 8, 6)))
    y.float().sum().backward()
    assert (y.dtype, module.weight.grad.dtype) == (torch.bfloat16, torch.float32)


def test_dtype_device_and_std_of_the_parameter():
    module = SpectralFilter((8, 6), std=0.5, dtype=torch.float64)
    assert module.weight.dtype == torch.float64
    assert 0.3 < module.weight.std() < 0.7
    assert SpectralFilter((8, 6), device="meta").weight.is_meta


@pytest.mark.parametrize(
    "build", [lambda: SpectralFilter((6, 8)), lambda: SequenceFilter(9, 4), lambda: GlobalFilter(4)]
)
def test_a_filter_built_without_memory_is_filled_later(build):
    """The recipe of large models: meta device, `to_empty`, `reset_parameters`."""
    with torch.device("meta"):
        module = build()
    module.to_empty(device="cpu")
    (parameter,) = module.parameters()
    nn.init.constant_(parameter, torch.nan)
    module.reset_parameters()
    assert 0.01 < parameter.std() < 0.04


def test_print_tells_size_and_layout():
    assert repr(SpectralFilter((8, 6))) == "SpectralFilter((8, 6), layout='tokens')"
    assert repr(GlobalFilter(3, 4, 3)) == "GlobalFilter(3, h=4, w=3)"


def test_copies_are_independent():
    module = SpectralFilter((8, 6))
    twin = copy.deepcopy(module)
    x = torch.randn(1, 8, 6)
    before = twin(x)
    with torch.no_grad():
        module.weight.zero_()
    torch.testing.assert_close(twin(x), before)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (((8, 6), "rows"), r"'tokens', 'grid'.*'rows'"),
        (((8, 6, 3),), "expected 2 sizes, got 3"),
        ((196,), "'tokens' expected 2 sizes, got the one number 196"),
        ((14, "grid"), "'grid' expected 3 sizes, got the one number 14"),
        (((8, 6), "grid"), "expected 3 sizes, got 2"),
        (((8, 0),), r"at least 1, got \(8, 0\)"),
    ],
)
def test_wrong_construction(arguments, text):
    with pytest.raises(ValueError, match=text):
        SpectralFilter(*arguments)


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: SpectralFilter("ab"), "size: expected whole numbers, got 'ab'"),
        (lambda: SpectralFilter(None), "size: expected whole numbers, got None"),
        (lambda: SpectralFilter((8, 6.0)), r"size: expected whole numbers, got \(8, 6\.0\)"),
        (lambda: SequenceFilter("a", 2), r"length, dim: expected whole numbers, got \('a', 2\)"),
        (lambda: GlobalFilter(3, None), r"dim, h, w: expected whole .* got \(3, None, 8\)"),
    ],
)
def test_sizes_that_are_no_whole_numbers(build, text):
    with pytest.raises(TypeError, match=text):
        build()


@pytest.mark.parametrize("module", [SpectralFilter((8, 6)), SequenceFilter(8, 6), GlobalFilter(6)])
@pytest.mark.parametrize("x", [None, "ab", np.zeros((8, 6), np.float32)], ids=["None", "ab", "np"])
def test_an_input_that_is_no_tensor(module, x):
    with pytest.raises(TypeError, match=rf"x: expected a torch\.Tensor, got {type(x).__name__}"):
        module(x)


@pytest.mark.parametrize(
    ("x", "error", "text"),
    [
        (torch.zeros(2, 8, 5), ValueError, r"\(..., 8, 6\), got \(2, 8, 5\)"),
        (torch.zeros(6), ValueError, r"\(..., 8, 6\), got \(6,\)"),
        (torch.zeros(8, 6).double(), TypeError, r"torch.float64.*torch.float32"),
        (torch.zeros(8, 6, device="meta"), ValueError, r"expected device meta.*got cpu"),
    ],
)
def test_wrong_input(x, error, text):
    with pytest.raises(error, match=text):
        SpectralFilter((8, 6))(x)


@pytest.mark.parametrize(
    ("shape", "spatial_size", "text"),
    [
        ((2, 16), None, r"\(B, 16, 3\).*, got \(2, 16\)"),
        ((2, 16, 4), None, r"\(B, 16, 3\).*, got \(2, 16, 4\)"),
        ((2, 15, 3), None, r"\(B, 16, 3\).*, got \(2, 15, 3\)"),
        ((2, 9, 3), None, r"\(B, 16, 3\).*, got \(2, 9, 3\)"),
        ((2, 16, 3), (4, 5), r"\(B, 20, 3\).*, got \(2, 16, 3\)"),
        ((2, 16, 3), (2, 8), r"4 rows, and columns .* = 3, got \(2, 8\)"),
        ((2, 16, 3), 4, r"spatial_size: expected \(rows, columns\), got 4"),
        ((2, 16, 3), 0, r"spatial_size: expected \(rows, columns\), got 0"),
        ((2, 16, 3), (4, 4, 1), r"spatial_size: expected \(rows, columns\), got \(4, 4, 1\)"),
        ((2, 16, 3), (-4, -4), r"4 rows, and columns .* = 3, got \(-4, -4\)"),
    ],
)
def test_wrong_input_of_global_filter(shape, spatial_size, text):
    with pytest.raises(ValueError, match=text):
        GlobalFilter(3, 4, 3)(torch.zeros(shape), spatial_size)


def test_a_grid_that_is_not_square_is_named():
    with pytest.raises(ValueError, match=r"4 rows, and columns .* = 5, got \(4, 4\)"):
        GlobalFilter(3, 4, 5)(torch.zeros(2, 16, 3))


def test_global_filters_of_four_stages_compile_whole():
    """One class, one compiled forward: the token count varies from stage to stage."""
    torch.compiler.reset()
    for rows in (14, 7, 28, 56):
        module = GlobalFilter(4, rows, rows // 2 + 1)
        compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
        for batch in (2, 3):
            x = torch.randn(batch, rows * rows, 4)
            torch.testing.assert_close(compiled(x), module(x))


def test_global_filter_compiles_with_dynamic_shapes():
    module = GlobalFilter(4)
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager", dynamic=True)
    for batch in (2, 5):
        x = torch.randn(batch, 196, 4)
        torch.testing.assert_close(compiled(x), module(x))
    module.compile(backend="aot_eager", dynamic=True)
    with pytest.raises(ValueError, match=r"\(B, 196, 4\).*, got \(2, 195, 4\)"):
        module(torch.randn(2, 195, 4))


@pytest.mark.parametrize("dtype", [torch.complex64, torch.int32])
def test_a_dtype_that_is_not_taken_is_refused_when_built(dtype):
    for build in (
        lambda: SpectralFilter((8, 6), dtype=dtype),
        lambda: SequenceFilter(8, 6, dtype=dtype),
    ):
        with pytest.raises(TypeError, match=f"dtype: expected one of torch.float32.* got {dtype}"):
            build()


def test_resized_takes_no_single_number():
    with pytest.raises(ValueError, match=r"size: expected \(rows, columns\).* got \(7,\)"):
        SpectralFilter((8, 6)).resized(7)
    with pytest.raises(ValueError, match=r"size: expected \(rows, columns\).* got \(7,\)"):
        GlobalFilter(3, 4, 3).resized(7)


@pytest.mark.filterwarnings("ignore:.torch.jit", "ignore::torch.jit.TracerWarning")
@pytest.mark.parametrize(
    ("module", "shape"),
    [
        (SpectralFilter((8, 6)), (8, 6)),
        (SpectralFilter((4, 6, 3), "grid"), (4, 6, 3)),
        (GlobalFilter(3, 4, 3), (16, 3)),
        (SequenceFilter(9, 2), (9, 2)),
        (QuaternionActivation(), (4,)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_traced_layer_is_saved_loaded_and_trained_on(module, shape, tmp_path):
    torch.jit.save(torch.jit.trace(module, torch.randn(2, *shape)), tmp_path / "layer.pt")
    loaded = torch.jit.load(tmp_path / "layer.pt")
    x = torch.randn(5, *shape)
    theirs, ours = (
        [i.requires_grad_() for i in (x.clone(), *m.parameters())] for m in (loaded, module)
    )
    expected, got = module(ours[0]), loaded(theirs[0])
    torch.testing.assert_close(got, expected)
    gradients = [
        torch.autograd.grad(y.pow(3).sum(), i) for y, i in ((got, theirs), (expected, ours))
    ]
    torch.testing.assert_close(*gradients)


def test_wrong_construction_of_global_filter():
    with pytest.raises(ValueError, match=r"at least 1, got \(3, 0, 8\)"):
        GlobalFilter(3, 0)
