"""SequenceFilter against torch.fft as FMLP-Rec's users write it."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn
from torch.utils._python_dispatch import TorchDispatchMode

from ffpose.nn import SequenceFilter


class PlainFilterLayer(nn.Module):
    """FMLP-Rec's layer from its paper: ortho-normed transforms along the sequence."""

    def __init__(self, length, dim):
        super().__init__()
        self.complex_weight = nn.Parameter(torch.randn(1, length // 2 + 1, dim, 2) * 0.02)

    def forward(self, x):
        spectrum = torch.fft.rfft(x, dim=1, norm="ortho") * torch.view_as_complex(
            self.complex_weight
        )
        return torch.fft.irfft(spectrum, n=x.shape[1], dim=1, norm="ortho")


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.mark.parametrize("length", [1, 2, 7, 50])
def test_numbers_and_gradients_are_those_of_torch_fft(length):
    theirs, ours = PlainFilterLayer(length, 5), SequenceFilter(length, 5)
    ours.load_state_dict({"weight": theirs.complex_weight.squeeze(0)})
    x, twin = (torch.ones(2, length, 5).cumsum(1).sin().requires_grad_() for _ in range(2))
    torch.testing.assert_close(ours(x), theirs(twin))
    ours(x).square().sum().backward()
    theirs(twin).square().sum().backward()
    torch.testing.assert_close(x.grad, twin.grad)
    torch.testing.assert_close(ours.weight.grad, theirs.complex_weight.grad.squeeze(0))


def test_any_leading_dimensions():
    module = SequenceFilter(6, 3)
    x = torch.randn(2, 4, 6, 3)
    assert module(x).shape == x.shape
    torch.testing.assert_close(module(x)[1, 2], module(x[1, 2]))


class Operators(TorchDispatchMode):
    """Lists the operators that run."""

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        self.names.append(function._schema.name)
        return function(*arguments, **(options or {}))


def test_nothing_is_copied_on_the_way_to_the_kernel():
    module = SequenceFilter(6, 3)
    with torch.no_grad(), Operators() as operators:
        module(torch.zeros(2, 6, 3, requires_grad=True))
    views = {"aten::zeros", "aten::unsqueeze", "aten::squeeze"}
    assert set(operators.names) - views == {"ffpose::spectral_filter"}


def test_dtype_device_std_and_print():
    module = SequenceFilter(50, 40, std=0.5, dtype=torch.float64)
    assert (module.weight.dtype, tuple(module.weight.shape)) == (torch.float64, (26, 40, 2))
    assert 0.3 < module.weight.std() < 0.7
    assert SequenceFilter(6, 3, device="meta").weight.is_meta
    assert SequenceFilter(6, 3)(torch.randn(2, 6, 3).bfloat16()).dtype == torch.bfloat16
    assert repr(module) == "SequenceFilter(50, 40)"


@pytest.mark.parametrize("arguments", [(0, 3), (6, 0)])
def test_wrong_construction(arguments):
    with pytest.raises(ValueError, match="length, dim: expected each at least 1, got"):
        SequenceFilter(*arguments)


@pytest.mark.parametrize(
    ("x", "error", "text"),
    [
        (torch.zeros(2, 5, 3), ValueError, r"\(..., 6, 3\), got \(2, 5, 3\)"),
        (torch.zeros(3), ValueError, r"\(..., 6, 3\), got \(3,\)"),
        (torch.zeros(6, 3).double(), TypeError, r"torch.float64.*torch.float32"),
        (torch.zeros(6, 3, device="meta"), ValueError, r"expected device meta.*got cpu"),
    ],
)
def test_wrong_input(x, error, text):
    with pytest.raises(error, match=text):
        SequenceFilter(6, 3)(x)


def results(module, x, grad):
    """The filter's output and both gradients, with channels last."""
    module.zero_grad()
    x = x.clone().requires_grad_()
    y = module(x)
    y.backward(grad)
    return y.detach(), x.grad, module.weight.grad.movedim(1, -1)


@settings(max_examples=200, deadline=None)
@given(
    st.integers(1, 60),
    st.integers(2, 40),
    st.integers(1, 20),
    st.sampled_from([torch.float32, torch.float64]),
    st.sampled_from([1e30, float("inf"), float("nan")]),
    st.data(),
)
def test_a_channel_depends_on_no_other(length, channels, batch, dtype, value, data):
    module = SequenceFilter(length, channels, dtype=dtype)
    x, grad = (torch.randn(batch, length, channels, dtype=dtype) for _ in range(2))
    expected = results(module, x, grad)
    channel = data.draw(st.integers(0, channels - 1))
    x[..., channel] = value
    grad[..., channel] = value
    others = [other for other in range(channels) if other != channel]
    for got, want in zip(results(module, x, grad), expected, strict=True):
        assert torch.equal(got[..., others], want[..., others])


@pytest.mark.parametrize("length", [49, 50])
def test_small_channels_are_as_exact_as_large_ones(length):
    module = SequenceFilter(length, 32)
    module.weight.data.copy_(torch.tensor([1.0, 0.0]))  # changes nothing
    x = torch.randn(1, length, 32)
    x[..., :16] *= 1e4
    error = (module(x) - x).detach().abs().amax((0, 1)) / x.abs().amax((0, 1))
    assert error.max() < 2e-6
