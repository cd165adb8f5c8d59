"""The quaternion activation on tensors: numbers, derivatives, graphs, and what it refuses."""

import pytest
import torch

from ffpose.ops import normalize_quaternion
from ffpose.ops.quaternion import _elsewhere, _gradient

forward_op = torch.ops.ffpose.normalize_quaternion

# torch's own forward-mode derivatives call what torch deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")


def by_definition(q):
    return q / q.square().sum(-1, keepdim=True).sqrt()


@pytest.fixture
def q():
    torch.manual_seed(0)
    return torch.randn(3, 2, 4, dtype=torch.float64)


def test_numbers_by_hand():
    q = torch.tensor([[2.0, 0, 0, 0], [0, -3, 0, 4], [1, 1, 1, -1]])
    expected = torch.tensor([[1.0, 0, 0, 0], [0, -0.6, 0, 0.8], [0.5, 0.5, 0.5, -0.5]])
    torch.testing.assert_close(normalize_quaternion(q), expected)


def test_elements_at_any_address(q):
    values = torch.frombuffer(bytearray(q.nbytes + 1), dtype=q.dtype, offset=1).view(q.shape)
    values.copy_(q).requires_grad_()
    assert values.data_ptr() % values.element_size()
    torch.testing.assert_close(normalize_quaternion(values), by_definition(q))
    (grad,) = torch.autograd.grad(normalize_quaternion(values)[..., 0].sum(), values)
    again = q.requires_grad_()
    torch.testing.assert_close(grad, torch.autograd.grad(by_definition(q)[..., 0].sum(), again)[0])


def test_derivatives_of_first_and_second_order(q):
    q.requires_grad_()
    checks = {"check_batched_grad": True}
    assert torch.autograd.gradcheck(normalize_quaternion, q, check_forward_ad=True, **checks)
    assert torch.autograd.gradgradcheck(normalize_quaternion, q, check_fwd_over_rev=True, **checks)


def test_third_order(q):
    def third(function):
        derivative = torch.func.jacrev(torch.func.hessian(lambda q: function(q).pow(3).sum()))
        return derivative(q[0, 0])

    torch.testing.assert_close(third(normalize_quaternion), third(by_definition))


def test_forward_modes_nest(q):
    direction = torch.randn_like(q)

    def twice(function):
        def along(function):
            return lambda q: torch.func.jvp(function, (q,), (direction,))[1]

        return along(along(function))(q)

    def gradient(function):
        return torch.func.grad(lambda q: function(q).pow(3).sum())

    torch.testing.assert_close(twice(normalize_quaternion), twice(by_definition))
    got, expected = twice(gradient(normalize_quaternion)), twice(gradient(by_definition))
    torch.testing.assert_close(got, expected)


# opcheck reads `.grad` of a tensor that is no leaf, and torch warns of that.
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")
@pytest.mark.parametrize("requires_grad", [True, False])
def test_opcheck(q, requires_grad):
    torch.library.opcheck(forward_op, (q.requires_grad_(requires_grad),))


def test_other_devices_compute_the_same(q):
    grad = torch.randn_like(q)
    torch.testing.assert_close(_elsewhere(q), normalize_quaternion(q))
    with torch.no_grad():
        by_rust = _gradient(grad, q)
    torch.testing.assert_close(_gradient(grad, q), by_rust)


@pytest.mark.parametrize("function", [normalize_quaternion, _elsewhere])
@pytest.mark.parametrize("scale", [1e-38, 1e38])
def test_no_square_over_or_underflows(function, scale):
    q = torch.tensor([3.0, 0.0, -2.0, 1.0]) * scale
    torch.testing.assert_close(function(q).norm(), torch.tensor(1.0))


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("function", [normalize_quaternion, _elsewhere])
def test_half_precision_is_rounded_once(q, function, dtype):
    q = q.to(dtype)
    torch.testing.assert_close(function(q), function(q.float()).to(dtype), rtol=0, atol=0)


@pytest.mark.parametrize("function", [normalize_quaternion, _elsewhere])
def test_zero_is_refused_by_row(q, function):
    q[1, 1] = 0
    with pytest.raises(ValueError, match=r"\b3\b"):
        function(q)


def test_nan_goes_through(q):
    q[1, 1, 0] = torch.nan
    nan_rows = normalize_quaternion(q).isnan().all(-1)
    assert nan_rows.nonzero().tolist() == [[1, 1]]


def test_strided_and_empty(q):
    view = q.transpose(0, 1)[:, ::2]
    torch.testing.assert_close(normalize_quaternion(view), by_definition(view))
    assert normalize_quaternion(q[:0]).shape == (0, 2, 4)
    assert normalize_quaternion(q.to("meta")).shape == q.shape


def test_vmap(q):
    torch.testing.assert_close(torch.vmap(normalize_quaternion)(q), by_definition(q))
    gradient = torch.func.grad(lambda q: normalize_quaternion(q).pow(3).sum())
    by_hand = torch.func.grad(lambda q: by_definition(q).pow(3).sum())
    torch.testing.assert_close(torch.vmap(gradient, 1)(q), torch.vmap(by_hand, 1)(q))


def test_compile_without_graph_break_in_training(q):
    q.requires_grad_()
    compiled = torch.compile(
        lambda q: normalize_quaternion(q).pow(3).sum(), fullgraph=True, backend="aot_eager"
    )
    (gradient,) = torch.autograd.grad(compiled(q), q)
    torch.testing.assert_close(gradient, torch.autograd.grad(by_definition(q).pow(3).sum(), q)[0])


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_gradients_of_half_precision_are_rounded_once(q, dtype):
    q, grad = q.to(dtype).requires_grad_(), torch.randn_like(q).to(dtype)
    wide = q.detach().float().requires_grad_()
    (expected,) = torch.autograd.grad(normalize_quaternion(wide), wide, grad.float())
    for recorded in (False, True):
        y = normalize_quaternion(q)
        (got,) = torch.autograd.grad(y, q, grad, create_graph=recorded)
        torch.testing.assert_close(got, expected.to(dtype), rtol=0, atol=0)


@pytest.mark.parametrize("function", [normalize_quaternion, forward_op])
@pytest.mark.parametrize(
    ("q", "error", "text"),
    [
        (torch.ones(3), ValueError, r"expected shape \(..., 4\), got \(3,\)"),
        (torch.ones(()), ValueError, r"expected shape \(..., 4\), got \(\)"),
        (torch.ones(4, dtype=torch.int64), TypeError, r"got torch.int64"),
        (torch.ones(4, dtype=torch.complex64), TypeError, r"got torch.complex64"),
    ],
)
def test_wrong_arguments(function, q, error, text):
    with pytest.raises(error, match=text):
        function(q)


def test_what_is_no_tensor():
    with pytest.raises(TypeError, match=r"expected a torch\.Tensor, got list"):
        normalize_quaternion([1.0, 0, 0, 0])
