"""The filter into a tensor or array of the caller's, the input itself included."""

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

import ffpose
from ffpose.ops import spectral_filter, weight_shape

out_op = torch.ops.ffpose.spectral_filter.out

CASES = [
    ("tokens", (3, 14, 16)),
    ("tokens", (1, 196, 64)),
    ("tokens", (18, 50, 2)),
    ("tokens", (19, 1, 96)),
    ("tokens", (5, 7, 9)),
    ("grid", (2, 14, 14, 40)),
    ("grid", (1, 28, 28, 33)),
    ("grid", (33, 1, 12, 7)),
    ("grid", (3, 1, 49, 17)),
    ("grid", (0, 4, 6, 3)),
]
DTYPES = [torch.float32, torch.float64, torch.bfloat16, torch.float16]


def arguments(layout, shape, dtype=torch.float32, device="cpu"):
    torch.manual_seed(0)
    rank = 2 if layout == "tokens" else 3
    weight_dtype = torch.float32 if dtype in DTYPES[2:] else dtype
    x = torch.randn(shape).to(device, dtype)
    return x, torch.randn(weight_shape(shape[-rank:], layout)).to(device, weight_dtype)


def test_what_is_no_tensor_is_named():
    x, weight = arguments("tokens", (3, 14, 16))
    for arguments_, out, name in (
        ((x.numpy(), weight), x, "x: .*ndarray"),
        ((x, None), x, "weight: .*NoneType"),
        ((x, weight), x.numpy(), "out: .*ndarray"),
    ):
        with pytest.raises(TypeError, match=f"{name}"):
            spectral_filter(*arguments_, out=out)


def test_sparse_tensors_are_refused():
    x, weight = arguments("tokens", (3, 14, 16))
    with pytest.raises(TypeError, match=r"x: expected a strided tensor, got torch\.sparse_coo"):
        spectral_filter(x.to_sparse(), weight)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("layout", "shape"), CASES)
def test_the_same_bits_wherever_they_go(layout, shape, dtype):
    x, weight = arguments(layout, shape, dtype)
    expected = spectral_filter(x, weight, layout)
    out = torch.full_like(x, torch.nan)
    assert spectral_filter(x, weight, layout, out=out) is out
    assert torch.equal(out, expected)
    assert spectral_filter(x, weight, layout, out=x) is x
    assert torch.equal(x, expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("layout", "shape"), CASES)
def test_the_same_bits_in_numpy(layout, shape, dtype):
    x, weight = (a.numpy().astype(dtype) for a in arguments(layout, shape))
    expected = ffpose.spectral_filter(x, weight, layout)
    out = np.full_like(x, np.nan)
    assert ffpose.spectral_filter(x, weight, layout, out=out) is out
    np.testing.assert_array_equal(out, expected)
    again = x[...]  # another array object on the same memory
    assert ffpose.spectral_filter(x, weight, layout, 2, out=again) is again
    np.testing.assert_array_equal(x, expected)


def test_other_devices_write_there_too():
    x, weight = arguments("grid", (2, 4, 6, 3), device="meta")
    assert spectral_filter(x, weight, "grid", out=x) is x


def test_a_strided_input_is_read_before_it_is_written_over():
    x, weight = arguments("tokens", (6, 6))
    expected = spectral_filter(x.T.contiguous(), weight)
    assert torch.equal(spectral_filter(x.T, weight, out=x), expected)


@pytest.mark.parametrize("mode", [torch.enable_grad, torch.no_grad, torch.inference_mode])
def test_autograd_sees_that_a_tensor_was_written_over(mode):
    x, weight = arguments("tokens", (4, 6))
    factor = torch.ones_like(x, requires_grad=True)
    product = factor * x  # autograd keeps x
    before = x._version
    with mode():
        spectral_filter(x, weight, out=x)
    assert x._version == before + 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        product.sum().backward()


def test_tensors_of_inference_mode_are_written_too():
    with torch.inference_mode():
        x, weight = arguments("tokens", (4, 6))
        expected = spectral_filter(x, weight)
        assert torch.equal(spectral_filter(x, weight, out=x), expected)


def test_no_gradient_is_lost_in_silence():
    x, weight = arguments("tokens", (4, 6))
    with pytest.raises(RuntimeError, match=r"out: expected arguments without gradient.*no_grad"):
        spectral_filter(x, weight.requires_grad_(), out=x)
    with torch.no_grad():
        spectral_filter(x, weight, out=x)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")
@pytest.mark.parametrize("name", ["x", "weight", "out"])
def test_no_tangent_is_lost_in_silence(name):
    x, weight = arguments("tokens", (4, 6))
    given = {"x": x, "weight": weight, "out": torch.zeros_like(x)}

    def write(tensor):
        return spectral_filter(**{**given, name: tensor})

    tensor = given[name]
    with pytest.raises(RuntimeError, match=r"out: expected arguments without tangent.*without out"):
        torch.func.jvp(write, (tensor,), (tensor,))
    with torch.no_grad(), forward_ad.dual_level():  # torch.no_grad does not end forward mode
        dual = forward_ad.make_dual(tensor, tensor)
        with pytest.raises(RuntimeError, match="out: expected arguments without tangent"):
            write(dual)
        spectral_filter(**given)


def test_opcheck():
    x, weight = arguments("grid", (2, 4, 6, 3))
    torch.library.opcheck(out_op, (x, weight, "grid"), {"out": torch.empty_like(x)})


@pytest.mark.parametrize(
    ("out", "error", "text"),
    [
        (
            lambda x: x[:1],
            ValueError,
            r"out: expected shape \(4, 6, 8\), that of x, got \(1, 6, 8\)",
        ),
        (lambda x: x.double(), TypeError, "out: expected torch.float32, that of x"),
        (lambda x: torch.empty(4, 8, 6).mT, ValueError, "out: expected a contiguous tensor, got"),
        (lambda x: x.to("meta"), ValueError, "out: expected device cpu, that of x, got meta"),
    ],
)
def test_wrong_tensors(out, error, text):
    x, weight = arguments("tokens", (4, 6, 8))
    with pytest.raises(error, match=text):
        spectral_filter(x, weight, out=out(x))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("other", ["x", "weight"])
def test_memory_that_overlaps_in_part(other, dtype):
    memory = torch.randn(2000, dtype=dtype)
    x, weight = memory[:192].view(4, 6, 8), memory[300:360].view(6, 5, 2)
    start = 8 if other == "x" else 200
    with pytest.raises(ValueError, match=f"out must have memory of its own, got that of {other}"):
        spectral_filter(x, weight, out=memory[start : start + 192].view(4, 6, 8))


@pytest.mark.parametrize("other", ["x", "weight"])
def test_memory_of_arrays_that_overlaps_in_part(other):
    memory = torch.randn(2000)
    x, weight = memory[:192].view(4, 6, 8), memory[300:360].view(6, 5, 2)
    start = 8 if other == "x" else 200
    arrays = [a.numpy() for a in (x, weight, memory[start : start + 192].view(4, 6, 8))]
    with pytest.raises(ValueError, match=f"out must have memory of its own, got that of {other}"):
        ffpose.spectral_filter(arrays[0], arrays[1], out=arrays[2])


@pytest.mark.parametrize(
    ("out", "error", "text"),
    [
        (lambda x: x.tolist(), TypeError, "out must be a numpy.ndarray, got <class 'list'>"),
        (lambda x: x[:1], ValueError, r"out must have the shape of x \(4, 6, 8\), got \(1, 6, 8\)"),
        (lambda x: x.astype(np.float64), TypeError, "out must be float32, got float64"),
        (lambda x: np.empty((4, 8, 6), x.dtype).swapaxes(1, 2), ValueError, "out must be C-contig"),
        (
            lambda x: np.frombuffer(x.tobytes(), x.dtype).reshape(x.shape),
            ValueError,
            "out must be writeable, got a read-only array",
        ),
    ],
)
def test_wrong_arrays(out, error, text):
    x, weight = (a.numpy() for a in arguments("tokens", (4, 6, 8)))
    with pytest.raises(error, match=text):
        ffpose.spectral_filter(x, weight, out=out(x))
