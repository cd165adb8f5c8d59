"""Devices other than the CPU: the same modules and the same numbers, without Rust."""

import copy

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from ffpose import _rust
from ffpose.nn import GlobalFilter, QuaternionActivation, SequenceFilter, SpectralFilter
from ffpose.ops import spectral_filter

# torch's own second derivatives call what torch deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")

LAYERS = [
    (SpectralFilter((7, 6), dtype=torch.float64), (2, 7, 6)),
    (SpectralFilter((6, 5, 3), "grid", dtype=torch.float64), (2, 6, 5, 3)),
    (GlobalFilter(3, 4, 3).double(), (2, 16, 3)),
    (SequenceFilter(9, 2, dtype=torch.float64), (2, 9, 2)),
    (QuaternionActivation(), (5, 4)),
]
layers = pytest.mark.parametrize(("layer", "shape"), LAYERS, ids=lambda value: type(value).__name__)
RUST = [
    "filter_tensors",
    "filter_tensors_backward",
    "normalize_quaternion",
    "normalize_quaternion_backward",
]


class AsOnCuda(TorchDispatchMode):
    """Gives our operators the kernels that a CUDA tensor would meet; the tensors stay here."""

    KEYS = torch._C.DispatchKeySet(torch._C.DispatchKey.CUDA)

    def __init__(self):
        super().__init__()
        self.calls = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if func.namespace != "ffpose":
            return func(*args, **(kwargs or {}))
        self.calls.add(str(func))
        with WithoutIndices():
            return func.redispatch(self.KEYS, *args, **(kwargs or {}))


class WithoutIndices(TorchDispatchMode):
    """Refuses lists of indices, which are copied to the device and which it waits for."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        assert "aten::index" not in func.name()
        return func(*args, **(kwargs or {}))


def results(layer, x):
    """The layer's result, its gradients, and the gradients of those."""
    inputs = [x.requires_grad_(), *layer.parameters()]
    y = layer(x)
    gradients = torch.autograd.grad(y.pow(3).sum(), inputs, create_graph=True)
    second = torch.autograd.grad(sum(each.square().sum() for each in gradients), inputs)
    return [y, *gradients, *second]


def doubles(shape):
    return torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def unreachable(*_):
    raise AssertionError("Rust was called")


@layers
def test_the_kernels_of_other_devices_give_the_cpus_numbers(layer, shape, monkeypatch):
    expected = results(layer, doubles(shape))
    for name in RUST:
        monkeypatch.setattr(_rust, name, unreachable)
    with AsOnCuda() as mode:
        got = results(layer, doubles(shape))
    # A filter's backward is an operator too.
    assert len(mode.calls) == (1 if isinstance(layer, QuaternionActivation) else 2)
    torch.testing.assert_close(got, expected)


def test_a_weight_may_begin_anywhere_in_a_tensor():
    """As one of several that a hypernetwork gives in one vector."""
    x, weight = doubles((2, 7, 6)), doubles(57)[1:].view(7, 4, 2)
    expected = torch.fft.irfft2(torch.fft.rfft2(x) * torch.view_as_complex(weight.clone()))
    with AsOnCuda() as mode:
        torch.testing.assert_close(spectral_filter(x, weight), expected)
    assert mode.calls


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@layers
def test_cuda_gives_the_cpus_numbers(layer, shape):
    expected = results(layer, doubles(shape))
    got = results(copy.deepcopy(layer).cuda(), doubles(shape).cuda())
    assert {each.device.type for each in got} == {"cuda"}
    torch.testing.assert_close([each.cpu() for each in got], expected)
