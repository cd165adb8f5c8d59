"""The spectral filter on tensors: numbers, derivatives, graphs, and what it refuses."""

import math
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch._dynamo import compiled_autograd
from torch.utils._python_dispatch import TorchDispatchMode

from ffpose import _rust
from ffpose.ops import spectral_filter, weight_shape
from ffpose.ops.fourier import filter_backward_by_fft, filter_by_fft

forward_op = torch.ops.ffpose.spectral_filter
backward_op = torch.ops.ffpose.spectral_filter_backward

# torch's own forward-mode derivatives call what torch deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")

HALVES = [torch.bfloat16, torch.float16]
PLANE = {"tokens": (-2, -1), "grid": (-3, -2)}
SHAPES = [
    ("tokens", (2, 6, 5)),
    ("tokens", (3, 1, 5, 8)),
    ("tokens", (4, 6)),
    ("tokens", (2, 1, 1)),
    ("tokens", (2, 7, 2)),
    ("grid", (2, 4, 6, 3)),
    ("grid", (2, 5, 7, 2)),
    ("grid", (3, 5, 4)),
    ("grid", (2, 2, 2, 1, 3)),
]


def by_definition(x, weight, layout):
    """What the operator is: torch.fft as its users write it, in float64."""
    dim = PLANE[layout]
    spectrum = torch.fft.rfft2(x.double(), dim=dim)
    product = spectrum * torch.view_as_complex(weight.double().contiguous())
    return torch.fft.irfft2(product, s=[x.shape[d] for d in dim], dim=dim)


def peak_of_spectrum(x, layout):
    """The largest magnitude of each image's spectrum, (batch,)."""
    return torch.fft.rfft2(x.double(), dim=PLANE[layout]).abs().flatten(1).amax(1)


def arguments(layout, shape, dtype=torch.float64, requires_grad=False, weight_dtype=None):
    rank = 2 if layout == "tokens" else 3
    if weight_dtype is None:
        weight_dtype = torch.float32 if dtype in HALVES else dtype
    x = torch.randn(shape, dtype=dtype)
    weight = torch.randn(weight_shape(shape[-rank:], layout), dtype=weight_dtype)
    return x.requires_grad_(requires_grad), weight.requires_grad_(requires_grad)


class Operators(TorchDispatchMode):
    """Lists the operators that run."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.seen.append(func)
        return func(*args, **(kwargs or {}))


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


shapes = st.one_of(
    st.tuples(st.just("tokens"), st.tuples(*[st.integers(1, 40)] * 2)),
    st.tuples(st.just("grid"), st.tuples(*[st.integers(1, 24)] * 2, st.integers(1, 5))),
)


@settings(max_examples=200, deadline=None)
@given(shapes, st.integers(1, 3), st.integers(0, 2**31))
@example(("tokens", (1, 2)), 2, 338)  # the two images' shares of the weight's gradient cancel
def test_float32_is_as_near_as_float32_can_be(layout_and_size, batch, seed):
    layout, size = layout_and_size
    torch.manual_seed(seed)
    x, weight = arguments(layout, (batch, *size), torch.float32, requires_grad=True)
    exact_x, exact_weight = (t.detach().double().requires_grad_() for t in (x, weight))
    grad = torch.randn_like(x)
    y, exact = spectral_filter(x, weight, layout), by_definition(exact_x, exact_weight, layout)
    y.backward(grad)
    exact.backward(grad.double())
    points = size[0] * size[1]
    tolerance = 4 * torch.finfo(torch.float32).eps * max(1.0, math.log2(points))
    for got, expected in ((y, exact), (x.grad, exact_x.grad)):
        assert (got - expected).abs().max() <= tolerance * expected.abs().max()
    # The gradient for the weight, a sum of products of two spectra, may cancel: the spectra count.
    peaks = peak_of_spectrum(x, layout) * peak_of_spectrum(grad, layout)
    largest = 2 / points * peaks.sum()
    assert (weight.grad - exact_weight.grad).abs().max() <= tolerance * largest


@pytest.mark.parametrize(("layout", "shape"), SHAPES)
def test_derivatives_of_first_and_second_order(layout, shape):
    inputs = arguments(layout, shape, requires_grad=True)

    def function(x, weight):
        return spectral_filter(x, weight, layout)

    checks = {"check_batched_grad": True}
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True, **checks)
    assert torch.autograd.gradgradcheck(function, inputs, check_fwd_over_rev=True, **checks)


@pytest.mark.parametrize("by", [spectral_filter, forward_op])
@pytest.mark.parametrize("of", [0, 1], ids=["x", "weight"])
def test_an_argument_may_change_before_the_only_gradient_which_does_not_need_it(of, by):
    inputs = arguments("grid", (2, 6, 5, 3))
    needed = inputs[of].requires_grad_()
    (expected,) = torch.autograd.grad(by_definition(*inputs, "grid").sum(), needed)
    y = by(*inputs, "grid")
    with torch.no_grad():
        needed.zero_()
    torch.testing.assert_close(torch.autograd.grad(y.sum(), needed)[0], expected)


@pytest.mark.parametrize("of", [0, 1], ids=["x", "weight"])
def test_derivatives_of_one_argument_alone(of):
    inputs = arguments("grid", (2, 6, 5, 3))
    inputs[of].requires_grad_()

    def function(x, weight):
        return spectral_filter(x, weight, "grid").pow(2)

    checks = {"check_batched_grad": True}
    assert torch.autograd.gradcheck(function, inputs, check_forward_ad=True, **checks)
    assert torch.autograd.gradgradcheck(function, inputs, check_fwd_over_rev=True, **checks)


# opcheck reads `.grad` of a tensor that is no leaf, and torch warns of that.
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")
@pytest.mark.parametrize("needs", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize(("layout", "shape"), SHAPES[:1] + SHAPES[5:6])
def test_opcheck(layout, shape, needs):
    for requires_grad in (True, False):
        x, weight = arguments(layout, shape, torch.float32, requires_grad=requires_grad)
        grad = torch.randn(shape, requires_grad=requires_grad)
        torch.library.opcheck(forward_op.default, (x, weight, layout))
        torch.library.opcheck(backward_op, (grad, x, weight, layout, *needs))


@pytest.mark.parametrize(("layout", "shape"), SHAPES)
def test_other_devices_compute_the_same_by_torch_fft(layout, shape):
    x, weight = arguments(layout, shape)
    grad = torch.randn_like(x)
    torch.testing.assert_close(filter_by_fft(x, weight, layout), spectral_filter(x, weight, layout))
    got = filter_backward_by_fft(grad, x, weight, layout, True, True)
    torch.testing.assert_close(got, backward_op(grad, x, weight, layout, True, True))


@pytest.mark.parametrize("by", [spectral_filter, filter_by_fft])
def test_columns_without_partner_act_by_their_hermitian_part(by):
    x, weight = arguments("tokens", (5, 6))
    columns = torch.view_as_complex(weight)[:, [0, 3]]
    mirrored = torch.stack([columns[-row % 5] for row in range(5)]).conj()
    projected = torch.view_as_complex(weight).clone()
    projected[:, [0, 3]] = (columns + mirrored) / 2
    expected = by(x, torch.view_as_real(projected), "tokens")
    torch.testing.assert_close(by(x, weight, "tokens"), expected)


@pytest.mark.parametrize(
    ("layout", "shape"),
    [
        *(("grid", (1, length, channels)) for length in (50, 57, 200) for channels in (1, 3, 64)),
        *(("grid", shape) for shape in ((7, 7, 32), (14, 15, 3), (10, 10, 16), (31, 31, 20))),
        *(("tokens", shape) for shape in ((196, 128), (49, 100), (197, 64), (3, 64))),
    ],
)
def test_a_frequency_that_is_stopped_leaves_nothing(layout, shape):
    """A mean 1e4 times as large as the rest is gone, to the rounding of the rest."""
    x = torch.randn(2, *shape) + 1e4
    weight = torch.zeros(weight_shape(shape, layout))
    weight[..., 0] = 1
    weight[0, 0] = 0
    y = spectral_filter(x, weight, layout).double()
    bound = 16 * torch.finfo(torch.float32).eps * y.std()
    assert (y.mean(dim=(1, 2)).abs() <= bound).all()


@pytest.mark.parametrize("dtype", HALVES)
@pytest.mark.parametrize("by", [spectral_filter, filter_by_fft])
def test_half_precision_is_rounded_once(dtype, by):
    x, weight = arguments("grid", (2, 6, 4, 3), dtype)
    y = by(x, weight, "grid")
    assert y.dtype == dtype
    torch.testing.assert_close(y, by(x.float(), weight, "grid").to(dtype), rtol=0, atol=0)
    halved = weight.to(dtype)
    expected = by(x.float(), halved.float(), "grid").to(dtype)
    torch.testing.assert_close(by(x, halved, "grid"), expected, rtol=0, atol=0)


@pytest.mark.parametrize("dtype", HALVES)
@pytest.mark.parametrize("weight_dtype", ["of x", torch.float32])
@pytest.mark.parametrize(
    ("layout", "shape"),
    [("grid", (5, 14, 14, 24)), ("tokens", (3, 49, 40)), ("grid", (2, 9, 7, 2))],
)
def test_half_precision_is_as_near_as_one_rounding(layout, shape, dtype, weight_dtype):
    """Against float64 on the same rounded inputs, whose gradients are sums over the whole batch."""
    weight_dtype = dtype if weight_dtype == "of x" else weight_dtype
    x, weight = arguments(layout, shape, dtype, requires_grad=True, weight_dtype=weight_dtype)
    exact_x, exact_weight = (t.detach().double().requires_grad_() for t in (x, weight))
    grad = torch.randn_like(x)
    y, exact = spectral_filter(x, weight, layout), by_definition(exact_x, exact_weight, layout)
    y.backward(grad)
    exact.backward(grad.double())
    of_float32 = 4 * torch.finfo(torch.float32).eps * math.log2(exact[0].numel())
    pairs = ((y, exact), (x.grad, exact_x.grad), (weight.grad, exact_weight.grad))
    for (got, expected), of in zip(pairs, (dtype, dtype, weight_dtype), strict=True):
        assert got.dtype == of
        rounding = torch.finfo(of).eps / 2 * expected.abs() + torch.finfo(of).tiny
        assert ((got - expected).abs() <= rounding + of_float32 * expected.abs().max()).all()


@pytest.mark.parametrize("channels", [3, 16, 20])
def test_subnormal_half_precision_is_not_flushed(channels):
    """6e-6 is no normal float16, but a normal float32: the filter that changes nothing keeps it."""
    x = torch.full((1, 4, 4, channels), 6e-6, dtype=torch.float16)
    weight = torch.zeros(4, 3, channels, 2)
    weight[..., 0] = 1.0
    flushes = torch.set_flush_denormal(True)
    try:
        y = spectral_filter(x, weight, "grid")
    finally:
        torch.set_flush_denormal(False)
    assert flushes
    assert torch.equal(y, x)


@pytest.mark.parametrize("by", [filter_by_fft, forward_op])
def test_every_way_takes_weights_of_half_precision(by):
    x, weight = arguments("tokens", (2, 6, 5), torch.bfloat16, weight_dtype=torch.bfloat16)
    torch.testing.assert_close(by(x, weight, "tokens"), spectral_filter(x, weight))
    got = filter_backward_by_fft(x, x, weight, "tokens", True, True)
    torch.testing.assert_close(got, backward_op(x, x, weight, "tokens", True, True))


@pytest.mark.parametrize(
    "view",
    [
        lambda x: x.transpose(0, 1),
        lambda x: x[:, :, ::2],
        lambda x: x.expand(3, *x.shape),
        lambda x: torch.complex(x, x).conj().imag,
        lambda x: x.flip(0)[1:],
    ],
)
def test_strided_input(view):
    x = view(torch.randn(4, 6, 8, dtype=torch.float64))
    weight = torch.randn(2, *weight_shape(x.shape[-2:], "tokens"), dtype=torch.float64)
    weight = weight.transpose(0, 1)[:, 1]
    torch.testing.assert_close(spectral_filter(x, weight), by_definition(x, weight, "tokens"))
    leaf = x.detach().requires_grad_()
    spectral_filter(leaf, weight).sum(0, keepdim=True).expand(2, *x.shape[1:]).sum().backward()
    by_hand = x.detach().requires_grad_()
    by_definition(by_hand, weight, "tokens").sum(0).mul(2).sum().backward()
    torch.testing.assert_close(leaf.grad, by_hand.grad)


@pytest.mark.parametrize(
    ("layout", "shape"),
    [("tokens", (0, 4, 6)), ("tokens", (2, 0, 6)), ("tokens", (2, 4, 0)), ("grid", (0, 4, 6, 3))],
)
@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_nothing_in_nothing_out(layout, shape, device):
    x, weight = (t.to(device).requires_grad_() for t in arguments(layout, shape))
    y = spectral_filter(x, weight, layout)
    assert y.shape == shape
    y.sum().backward()
    assert x.grad.shape == shape
    if device == "cpu":
        assert not weight.grad.any()
        assert not filter_backward_by_fft(x, x, weight, layout, True, True)[1].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16, torch.float16])
def test_elements_at_any_address_are_read(dtype):
    """As of a file that is mapped, or of a buffer received."""

    def moved(tensor):
        values = torch.frombuffer(bytearray(tensor.nbytes + 1), dtype=tensor.dtype, offset=1)
        return values.view(tensor.shape).copy_(tensor.detach())

    x, weight = arguments("tokens", (2, 6, 5), dtype, requires_grad=True)
    grad = torch.randn(2, 6, 5).to(dtype)
    y = spectral_filter(x, weight)
    expected = [y, *torch.autograd.grad(y, (x, weight), grad)]
    inputs = [moved(x).requires_grad_(), moved(weight).requires_grad_()]
    y = spectral_filter(*inputs)
    torch.testing.assert_close([y, *torch.autograd.grad(y, inputs, moved(grad))], expected)
    with torch.no_grad():
        assert torch.equal(spectral_filter(inputs[0], weight), y)
        if dtype != torch.float16:  # which is written to by torch
            with pytest.raises(ValueError, match="out must be aligned"):
                spectral_filter(x, weight, out=moved(x))


def test_meta_device_gives_shape_and_dtype():
    x, weight = (t.to("meta") for t in arguments("grid", (2, 5, 6, 3), torch.bfloat16))
    y = spectral_filter(x, weight, "grid")
    assert (y.device.type, y.shape, y.dtype) == ("meta", x.shape, x.dtype)


def test_only_what_asks_for_a_gradient_gets_one():
    x, weight = arguments("tokens", (2, 4, 6))
    assert not spectral_filter(x, weight).requires_grad
    spectral_filter(x.requires_grad_(), weight).sum().backward()
    assert weight.grad is None
    frozen = x.detach()
    spectral_filter(frozen, weight.requires_grad_()).sum().backward()
    assert frozen.grad is None
    assert weight.grad is not None
    with torch.no_grad():
        assert not spectral_filter(x, weight).requires_grad


def test_inference_mode_and_parameters_take_the_direct_way():
    x, weight = arguments("tokens", (2, 4, 6))
    expected = by_definition(x, weight, "tokens")
    with torch.inference_mode():
        torch.testing.assert_close(spectral_filter(x.clone(), torch.nn.Parameter(weight)), expected)


@pytest.mark.parametrize("by", [spectral_filter, forward_op])
def test_a_weight_learns_from_what_inference_mode_made(by):
    """Features of a frozen network are an example."""
    x, weight = arguments("tokens", (2, 4, 6))
    weight.requires_grad_()
    with torch.inference_mode():
        x = x.clone()
    got, expected = (
        torch.autograd.grad(filter(x, weight, "tokens").square().sum(), weight)
        for filter in (by, by_definition)
    )
    torch.testing.assert_close(got, expected)


def test_what_inference_mode_made_is_filtered_once():
    x, weight = arguments("tokens", (2, 4, 6))
    with torch.inference_mode():
        x = x.clone()
    with Operators() as mode:
        spectral_filter(x, weight.requires_grad_())
    assert mode.seen.count(forward_op.default) == 1


@pytest.mark.parametrize("context", [torch.no_grad, torch.inference_mode])
def test_a_profile_of_inference_names_the_operator(context):
    x, weight = arguments("grid", (2, 14, 14, 8), requires_grad=True)
    with context():
        expected = spectral_filter(x, weight, "grid")
        with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
            y = spectral_filter(x, weight, "grid")
    assert torch.equal(y, expected)
    (event,) = (each for each in profile.key_averages() if each.key == "ffpose::spectral_filter")
    assert event.count == 1


def test_a_dispatch_mode_sees_the_operator():
    with Operators() as mode:
        spectral_filter(*arguments("tokens", (4, 6)))
    assert forward_op.default in mode.seen


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


LARGE = [
    ("grid", (5, 14, 14, 40), torch.float32),
    ("grid", (1, 28, 28, 100), torch.float64),
    ("grid", (33, 10, 9, 8), torch.bfloat16),
    ("tokens", (1, 196, 256), torch.float32),
    ("tokens", (7, 49, 100), torch.float16),
]


@pytest.mark.parametrize(("layout", "shape", "dtype"), LARGE)
def test_threads_and_splits_of_the_batch_do_not_change_a_bit(layout, shape, dtype, threads):
    x, weight = arguments(layout, shape, dtype)
    grad = torch.randn_like(x)
    threads(1)
    expected = spectral_filter(x, weight, layout)
    gradients = backward_op(grad, x, weight, layout, True, True)
    for count in (2, 3):
        threads(count)
        assert torch.equal(spectral_filter(x, weight, layout), expected)
        got = backward_op(grad, x, weight, layout, True, True)
        assert all(map(torch.equal, got, gradients))
    for parts in (x.shape[0], 2):
        y = torch.cat([spectral_filter(part, weight, layout) for part in x.chunk(parts)])
        assert torch.equal(y, expected)


def run_large(_=None):
    layout, shape, dtype = LARGE[0]
    torch.manual_seed(1)
    return spectral_filter(*arguments(layout, shape, dtype), layout)


def test_threads_of_the_user_may_use_the_pool_together(threads):
    threads(2)
    x, weight = arguments("grid", (5, 14, 14, 40), torch.float32)
    expected = spectral_filter(x, weight, "grid")
    with ThreadPoolExecutor(4) as executor:
        for y in executor.map(lambda _: spectral_filter(x, weight, "grid"), range(40)):
            assert torch.equal(y, expected)


class Filtered(torch.utils.data.Dataset):
    def __len__(self):
        return 4

    def __getitem__(self, index):
        return run_large()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_forked_workers_of_a_loader_after_use(threads):
    threads(2)
    expected = run_large()
    loader = torch.utils.data.DataLoader(
        Filtered(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=60
    )
    assert all(torch.equal(y, expected) for y in loader)


# Other operations of torch may hang in such a child, for their threads are gone: NumPy compares.
FORK_AFTER_USE = """
import os, sys
import numpy as np
import torch
from ffpose.ops import spectral_filter
torch.set_num_threads(2)
x, weight = torch.randn(5, 14, 14, 40), torch.randn(14, 8, 40, 2)
expected = spectral_filter(x, weight, "grid").numpy()
child = os.fork()
if child == 0:
    y = spectral_filter(x, weight, "grid").numpy()
    os._exit(0 if np.array_equal(y, expected) else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


# The parent's threads are started by torch, and ffpose is called in the child alone.
FORK_AFTER_TORCH = """
import os, sys
import numpy as np
import torch
from ffpose.ops import spectral_filter
torch.set_num_threads(2)
x, weight = torch.randn(5, 14, 14, 40), torch.randn(14, 8, 40, 2)
expected = torch.fft.rfft2(x, dim=(1, 2)) * torch.view_as_complex(weight)
expected = torch.fft.irfft2(expected, s=(14, 14), dim=(1, 2)).numpy()
torch.randn(1 << 22).exp()
child = os.fork()
if child == 0:
    y = spectral_filter(x, weight, "grid").numpy()
    os._exit(0 if np.allclose(y, expected, atol=1e-4) else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
@pytest.mark.parametrize("code", [FORK_AFTER_USE, FORK_AFTER_TORCH], ids=["ffpose", "torch"])
def test_fork_after_use_of_several_threads(code):
    with subprocess.Popen([sys.executable, "-c", code], start_new_session=True) as process:
        try:
            assert process.wait(timeout=120) == 0
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # also a child that hangs


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="the system has no timers")
def test_an_interrupt_leaves_everything_in_order():
    x, weight = arguments("grid", (5, 14, 14, 40), torch.float32)
    expected = spectral_filter(x, weight, "grid")

    def filter_until_interrupted(delay):
        signal.setitimer(signal.ITIMER_REAL, delay)
        while True:
            spectral_filter(x, weight, "grid")

    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for delay in (0.001, 0.002, 0.005):
            with pytest.raises(KeyboardInterrupt):
                filter_until_interrupted(delay)
            assert torch.equal(spectral_filter(x, weight, "grid"), expected)
    finally:
        signal.signal(signal.SIGALRM, before)


# torch.func and vmap


def test_vmap_over_images_weights_and_both():
    x, weight = arguments("grid", (5, 4, 6, 3))
    weights = torch.randn(5, *weight.shape, dtype=weight.dtype)

    def function(x, weight):
        return spectral_filter(x, weight, "grid")

    together = torch.stack([function(*pair) for pair in zip(x, weights, strict=True)])
    torch.testing.assert_close(torch.vmap(function)(x, weights), together)
    torch.testing.assert_close(torch.vmap(function, (0, None))(x, weight), function(x, weight))
    last = torch.vmap(function, (None, -1), -1)(x[0], weights.movedim(0, -1))
    torch.testing.assert_close(last, torch.stack([function(x[0], w) for w in weights], -1))
    by_operator = torch.vmap(lambda x: forward_op(x, weight, "grid"))(x)
    torch.testing.assert_close(by_operator, function(x, weight))


@pytest.mark.parametrize("in_dims", [(0, 0), (None, 0), (0, None), (None, -1)])
@pytest.mark.parametrize(("layout", "shape"), [("tokens", (2, 4, 6)), ("grid", (2, 4, 6, 3))])
def test_vmap_over_no_samples(layout, shape, in_dims):
    """The shapes of the result, and of every gradient that of what it is of."""

    def of_no_samples(tensor, dim):
        batched = tensor if dim is None else tensor.new_empty(0, *tensor.shape).movedim(0, dim)
        return batched.requires_grad_()

    tensors = tuple(map(of_no_samples, arguments(layout, shape), in_dims))

    def total(x, weight):
        return spectral_filter(x, weight, layout).sum()

    y = torch.vmap(lambda x, weight: spectral_filter(x, weight, layout), in_dims)(*tensors)
    assert y.shape == (0, *shape)
    gradients = torch.autograd.grad(y.sum(), tensors)
    assert [gradient.shape for gradient in gradients] == [tensor.shape for tensor in tensors]
    each = torch.vmap(torch.func.grad(total, (0, 1)), in_dims)(*tensors)
    assert [gradient.shape for gradient in each] == [
        (0, *tensor.shape) for tensor in arguments(layout, shape)
    ]
    x, weight = (tensor.detach() for tensor in tensors)
    y = torch.vmap(lambda x, weight: forward_op(x, weight, layout), in_dims)(x, weight)
    assert y.shape == (0, *shape)


def test_gradient_of_each_sample():
    x, weight = arguments("tokens", (5, 4, 6))

    def loss(weight, x):
        return spectral_filter(x, weight).square().sum()

    each = torch.vmap(torch.func.grad(loss), (None, 0))(weight, x)
    for gradient, sample in zip(each, x, strict=True):
        leaf = weight.clone().requires_grad_()
        by_definition(sample, leaf, "tokens").square().sum().backward()
        torch.testing.assert_close(gradient, leaf.grad)


def test_hessian_forward_over_reverse():
    x, weight = arguments("tokens", (3, 4))

    def loss(filter):
        return lambda x: filter(x, weight, "tokens").pow(3).sum()

    expected = torch.autograd.functional.hessian(loss(by_definition), x)
    torch.testing.assert_close(torch.func.hessian(loss(spectral_filter))(x), expected)


def test_forward_modes_nest():
    """Twice along (a, b) the derivative of a bilinear function is twice its value at (a, b)."""
    (x, weight), (a, b) = (arguments("tokens", (3, 4)) for _ in range(2))

    def twice(function):
        def along(function):
            return lambda *at: torch.func.jvp(function, at, (a, b))[1]

        return along(along(function))(x, weight)

    def gradient(filter):
        return torch.func.grad(lambda *at: filter(*at, "tokens").pow(3).sum(), (0, 1))

    torch.testing.assert_close(twice(spectral_filter), 2 * by_definition(a, b, "tokens"))
    got, expected = twice(gradient(spectral_filter)), twice(gradient(by_definition))
    torch.testing.assert_close(got, expected)


# Graphs


def test_compile_without_graph_break_in_training():
    x, weight = arguments("grid", (2, 4, 6, 3), requires_grad=True)

    def function(x, weight):
        return spectral_filter(x * 2, weight, "grid").sin().sum()

    compiled = torch.compile(function, fullgraph=True, backend="aot_eager", dynamic=True)
    for batch in (2, 5):
        x = torch.randn(batch, 4, 6, 3, dtype=torch.float64, requires_grad=True)
        gradients = torch.autograd.grad(compiled(x, weight), (x, weight))
        torch.testing.assert_close(gradients, torch.autograd.grad(function(x, weight), (x, weight)))


@pytest.mark.slow
# Inductor itself calls parts of torch that torch deprecates.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_compile_with_inductor():
    x, weight = arguments("tokens", (2, 4, 6), torch.float32)
    compiled = torch.compile(lambda x: spectral_filter(x + 1, weight) * 2, fullgraph=True)
    expected = by_definition(x + 1, weight, "tokens").float() * 2
    torch.testing.assert_close(compiled(x), expected)


# Compiled autograd reads `.grad` of a tensor that is no leaf, and torch warns of that.
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")
@pytest.mark.parametrize("needs", [(True, True), (True, False), (False, True)])
def test_backward_of_an_uncompiled_layer_is_compiled_whole(needs):
    inputs = arguments("tokens", (2, 6, 5))
    for each, need in zip(inputs, needs, strict=True):
        each.requires_grad_(need)
    leaves = [each for each in inputs if each.requires_grad]
    expected = torch.autograd.grad(by_definition(*inputs, "tokens").pow(2).sum(), leaves)
    with compiled_autograd._enable(torch.compile(backend="aot_eager", fullgraph=True)):
        spectral_filter(*inputs).pow(2).sum().backward()
    torch.testing.assert_close([each.grad for each in leaves], [*expected])


def test_export_keeps_the_operator():
    class Model(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.weight = torch.nn.Parameter(torch.randn(4, 4, 2))

        def forward(self, x):
            return spectral_filter(x, self.weight)

    model = Model()
    batch = torch.export.Dim("batch", min=1)
    program = torch.export.export(model, (torch.randn(2, 4, 6),), dynamic_shapes=({0: batch},))
    assert any(node.target == forward_op.default for node in program.graph.nodes)
    x = torch.randn(7, 4, 6)
    torch.testing.assert_close(program.module()(x), model(x))


# Refusals


MEMORY = torch.zeros(54)
X = MEMORY[:48].view(2, 4, 6)
WEIGHT = torch.zeros(4, 4, 2)


@pytest.mark.parametrize("function", [spectral_filter, forward_op])
@pytest.mark.parametrize(
    ("x", "weight", "layout", "error", "text"),
    [
        (X, WEIGHT, "rows", ValueError, r"'tokens', 'grid'.*got 'rows'"),
        (X[0, 0], WEIGHT, "tokens", ValueError, r"at least 2 dimensions.*\(6,\)"),
        (X[0], WEIGHT, "grid", ValueError, r"at least 3 dimensions.*\(4, 6\)"),
        (X, WEIGHT[:3], "tokens", ValueError, r"expected shape \(4, 4, 2\).*got \(3, 4, 2\)"),
        (X, WEIGHT[..., :1], "tokens", ValueError, r"expected shape \(4, 4, 2\).*got \(4, 4, 1\)"),
        (X, WEIGHT, "grid", ValueError, r"expected shape \(2, 3, 6, 2\).*got \(4, 4, 2\)"),
        (X, WEIGHT.double(), "tokens", TypeError, r"expected torch.float32.*got torch.float64"),
        (X, WEIGHT.bfloat16(), "tokens", TypeError, r"torch.float32 for.*got torch.bfloat16"),
        (X.bfloat16(), WEIGHT.half(), "tokens", TypeError, r"torch.bfloat16 or torch.float32 for"),
        (X.int(), WEIGHT, "tokens", TypeError, r"expected one of torch.float32.*got torch.int32"),
        (X.cfloat(), WEIGHT, "tokens", TypeError, r"x: .*torch.float64.*got torch.complex64"),
        (X, torch.view_as_complex(WEIGHT), "tokens", TypeError, r"view_as_real.*got torch.compl"),
        (X, WEIGHT.to("meta"), "tokens", ValueError, r"expected device cpu.*got meta"),
    ],
)
def test_wrong_arguments(function, x, weight, layout, error, text):
    with pytest.raises(error, match=text):
        function(x, weight, layout)


@pytest.mark.parametrize("other", [None, 1.0, X.numpy(), [1.0]])
def test_what_is_no_tensor(other):
    with pytest.raises(TypeError, match=rf"x: .* torch\.Tensor, got {type(other).__name__}"):
        spectral_filter(other, WEIGHT)
    with pytest.raises(TypeError, match=r"weight: expected a torch\.Tensor"):
        spectral_filter(X, other)


@pytest.mark.parametrize(
    ("grad", "error", "text"),
    [
        (X[:1], ValueError, r"grad: expected shape \(2, 4, 6\), that of x, got \(1, 4, 6\)"),
        (X.double(), TypeError, r"grad: expected torch.float32, that of x, got torch.float64"),
        (X.to("meta"), ValueError, r"grad: expected device cpu, that of x, got meta"),
    ],
)
def test_wrong_gradients(grad, error, text):
    with pytest.raises(error, match=text):
        backward_op(grad, X, WEIGHT, "tokens", True, True)


@pytest.mark.parametrize("size", [(), (4,), (4, 6, 3)])
def test_weight_shape_of_another_rank(size):
    with pytest.raises(ValueError, match=f"expected 2 sizes, got {len(size)}"):
        weight_shape(size, "tokens")


@pytest.mark.parametrize(
    ("replaced", "error", "text"),
    [
        ({"x": X.numpy()}, TypeError, r"x must be a torch\.Tensor, got .*ndarray"),
        ({"x": X.transpose(1, 2)}, ValueError, r"x must be contiguous, got strides \[24, 1, 6\]"),
        (
            {"x": X.int()},
            TypeError,
            "x must be float32, float64 or bfloat16.* got int32 and float32",
        ),
        ({"x": X.half(), "y": X.half()}, TypeError, "x must be .* got float16 and float32"),
        ({"weight": WEIGHT[:3]}, ValueError, r"weight must have shape \(4, 4, 2\)"),
        ({"y": X.double()}, TypeError, "out must be float32, got float64"),
        ({"y": X[:1] + 1}, ValueError, r"y must have shape \(2, 4, 6\), got \(1, 4, 6\)"),
        ({"y": MEMORY[6:54].view(2, 4, 6)}, ValueError, "out must have memory of its own.* of x"),
        ({"layout": "rows"}, ValueError, 'must be "tokens" or "grid", got "rows"'),
        ({"num_threads": 0}, ValueError, "num_threads must be at least 1, got 0"),
    ],
)
def test_the_door_to_rust_checks_what_it_is_given(replaced, error, text):
    good = {"x": X, "weight": WEIGHT, "y": X + 1, "layout": "tokens", "num_threads": 1}
    with pytest.raises(error, match=text):
        _rust.filter_tensors(**good | replaced)


def test_a_shape_that_memory_cannot_address_is_refused():
    """An empty tensor may have axes whose product has no number."""
    x = torch.empty(2**62, 0, 14, 8)
    with pytest.raises(
        ValueError, match=r"x must have a shape that memory can address, got .*0, 14"
    ):
        spectral_filter(x, torch.empty(0, 8, 8, 2), "grid")


# The header of DLPack's table: two version numbers, and the table of an older version.
EXCHANGE_TABLE = """
import ctypes
import torch
from ffpose.ops import spectral_filter
api = ctypes.pythonapi
api.PyCapsule_GetPointer.restype = ctypes.c_void_p
api.PyCapsule_GetPointer.argtypes = ctypes.py_object, ctypes.c_char_p
api.PyCapsule_New.restype = ctypes.py_object
api.PyCapsule_New.argtypes = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
class Table(ctypes.Structure):
    _fields_ = [("major", ctypes.c_uint32), ("minor", ctypes.c_uint32),
                ("older", ctypes.c_void_p), ("functions", ctypes.c_void_p * 5)]
name = b"dlpack_exchange_api"
real = api.PyCapsule_GetPointer(torch.Tensor.__dlpack_c_exchange_api__, name)
table = {table}
torch.Tensor.__dlpack_c_exchange_api__ = api.PyCapsule_New(ctypes.addressof(table), name, None)
try:
    print(spectral_filter(torch.ones(4, 6), torch.ones(4, 4, 2) * torch.tensor([1.0, 0.0])).sum())
except ImportError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("Table(1, 0, None)", "expected a function from torch .* got a null pointer"),
        ("Table(2, 3, None)", "expected DLPack 1 from torch, got 2.3 and nothing older"),
        ("Table(2, 0, real)", r"tensor\(24\.\d*\)"),
    ],
)
def test_tables_of_other_versions_of_dlpack(table, said):
    command = [sys.executable, "-c", EXCHANGE_TABLE.replace("{table}", table)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert re.fullmatch(said + "\n", done.stdout)
