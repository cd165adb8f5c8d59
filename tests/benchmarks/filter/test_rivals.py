import numpy as np
import pytest
import torch
from scipy import fft

from benchmarks.filter.cases import CHANNELS_FIRST, HALF, MATRICES, SCIPY, TORCH, Case, sweep
from benchmarks.filter.rivals import DIMS, Inputs, contenders, in_our_layout
from benchmarks.filter.worker import measure
from ffpose.bench.filter import OURS

CASES = [
    ("grid", (4, 6, 3)),
    ("grid", (5, 7, 2)),
    ("tokens", (6, 8)),
    ("tokens", (3, 5)),
    ("sequence", (6, 3)),
    ("sequence", (7, 2)),
]


@pytest.mark.parametrize(("kind", "size"), CASES)
def test_each_contender_is_the_filter_of_its_definition(kind, size):
    case = Case(kind, size, 2, contenders=(OURS, TORCH, CHANNELS_FIRST, SCIPY, MATRICES))
    inputs = Inputs.of(case)
    weight = inputs.weight.double().numpy()
    axes = DIMS[kind]
    spectrum = fft.rfftn(inputs.x.double().numpy(), axes=axes) * (
        weight[..., 0] + 1j * weight[..., 1]
    )
    expected = fft.irfftn(spectrum, s=[inputs.x.shape[d] for d in axes], axes=axes)
    for name, contender in contenders(case).items():
        (result,) = in_our_layout(name, case, (torch.as_tensor(contender.call()),))
        np.testing.assert_allclose(result, expected, atol=2e-5, err_msg=name)


@pytest.mark.parametrize(("kind", "size"), CASES)
def test_gradients_are_compared_before_they_are_timed(kind, size):
    names = (OURS, TORCH, CHANNELS_FIRST, MATRICES)
    case = Case(kind, size, 2, "forward+backward", contenders=names)
    threads = torch.get_num_threads()
    measured = measure(case, seconds=0.001)
    assert measured.largest_difference < 1e-5
    assert set(measured.timings) == set(case.contenders)
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("size", [(4, 6, 3), (6, 3)])
def test_torch_is_measured_on_contiguous_planes_too(monkeypatch, size):
    """In its better case: torch.fft transforms the last axes of contiguous grids and sequences."""
    kind = "grid" if len(size) == 3 else "sequence"
    case = sweep(((kind, size),), (2,), 1)[0]
    seen = []

    def look(x, weight, dim):
        seen.append((tuple(dim), tuple(x.shape), x.is_contiguous()))
        return x

    monkeypatch.setattr("benchmarks.filter.rivals.torch_filter", look)
    contenders(case)[CHANNELS_FIRST].call()
    *plane, channels = size
    assert seen == [(tuple(range(-len(plane), 0)), (2, channels, *plane), True)]


def test_the_weight_changes_before_every_call_of_a_backward():
    (contender,) = contenders(Case("tokens", (4, 6), 1, "forward+backward", 1, (OURS,))).values()
    first, _ = contender.call()
    contender.prepare()
    second, _ = contender.call()
    torch.testing.assert_close(second, -first)


def test_half_precision_takes_part_beside_single():
    case = Case("grid", (4, 6, 3), 2, "forward+backward", contenders=(OURS, HALF))
    for_x, for_weight = contenders(case)[HALF].call()
    assert (for_x.dtype, for_weight.dtype) == (torch.bfloat16, torch.float32)


def test_a_rival_that_computes_something_else_is_not_timed(monkeypatch):
    monkeypatch.setattr("benchmarks.filter.rivals.torch_filter", lambda x, weight, dim: x)
    with pytest.raises(RuntimeError, match=r"tokens 4×6, batch 1, forward: torch.fft differs"):
        measure(Case("tokens", (4, 6), 1), seconds=0.001)
