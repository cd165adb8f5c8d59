"""Torch's private names: in one file, and without each of them a slower way to the same numbers."""

import ast
import copy
import importlib
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from torch.autograd import forward_ad
from torch.utils import _pytree

from ffpose._internal import torch_internals
from ffpose.ops import normalize_quaternion, spectral_filter, weight_shape
from ffpose.training.averaging import AveragedModel

PACKAGE = Path(__file__).parents[1] / "python" / "ffpose"
NAMES = [
    (torch._C, "_AutoDispatchBelowAutograd"),
    (torch._C, "_dispatch_keys"),
    (torch._C, "_len_torch_dispatch_stack"),
    (torch._C, "_are_functorch_transforms_active"),
    (torch._C, "_get_tracing_state"),
    (forward_ad, "_current_level"),
    (forward_ad, "_set_fwd_grad_enabled"),
    (_pytree, "_register_namedtuple"),
    (torch.autograd, "_profiler_enabled"),
]
OF_DISPATCH = ("_dispatch_keys", "_len_torch_dispatch_stack", "_current_level")


@pytest.fixture
def without(monkeypatch):
    """Look the names up again in a torch that lacks one, which only ffpose's look-up sees."""

    def remove(module, name):
        with monkeypatch.context() as patch:
            patch.delattr(module, name)
            importlib.reload(torch_internals)

    yield remove
    importlib.reload(torch_internals)


def filtered(layout="grid", shape=(2, 6, 8, 3)):
    """The filter's result, its gradients, and a gradient of a gradient."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(shape, generator=generator, requires_grad=True)
    size = weight_shape(shape[-3 if layout == "grid" else -2 :], layout)
    weight = torch.randn(size, generator=generator, requires_grad=True)
    y = spectral_filter(x, weight, layout)
    for_x, for_weight = torch.autograd.grad(y.square().sum(), (x, weight), create_graph=True)
    (twice,) = torch.autograd.grad(for_weight.square().sum(), x)
    return [y, for_x, for_weight, twice, spectral_filter(x.detach(), weight.detach(), layout)]


def normalized():
    q = torch.randn((5, 4), generator=torch.Generator().manual_seed(1), requires_grad=True)
    y = normalize_quaternion(q)
    return [y, *torch.autograd.grad(y[:, 0].sum(), q)]


def averaged():
    model = torch.nn.Linear(3, 2)
    average = AveragedModel(model, 0.9)
    start = copy.deepcopy(average.model.state_dict())
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(1.0)
    average.update()
    return [average.model.state_dict()[name] - start[name] for name in start]


@pytest.mark.parametrize(("module", "name"), NAMES, ids=[name for _, name in NAMES])
def test_without_a_name_the_numbers_are_the_same(without, module, name):
    expected = [*filtered(), *filtered("tokens", (2, 7, 4)), *normalized(), *averaged()]
    without(module, name)
    got = [*filtered(), *filtered("tokens", (2, 7, 4)), *normalized(), *averaged()]
    for value, wanted in zip(got, expected, strict=True):
        torch.testing.assert_close(value, wanted, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("module", "name"), NAMES, ids=[name for _, name in NAMES])
def test_without_a_name_a_call_goes_the_slower_way(without, module, name):
    x = torch.zeros(3)
    assert torch_internals.is_plain(x)
    without(module, name)
    assert torch_internals.is_plain(x) == (name not in OF_DISPATCH)
    assert torch_internals.transforms_at_work() == (name == "_are_functorch_transforms_active")
    assert not torch_internals.is_recording()
    assert not torch_internals.is_profiled()


def test_without_its_name_a_named_tuple_is_not_registered(without):
    class Kind(NamedTuple):
        value: int

    without(_pytree, "_register_namedtuple")
    torch_internals.register_named_tuple(Kind, "ffpose.never")
    assert Kind not in _pytree.SUPPORTED_SERIALIZED_TYPES


def test_no_other_file_names_what_torch_hides():
    """Names with one leading underscore, reached through a name of torch that the file imports."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.stem == "torch_internals":
            continue
        tree = ast.parse(path.read_text())
        roots = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                roots |= {
                    (a.asname or a.name).split(".")[0] for a in node.names if "torch" in a.name
                }
            elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "torch":
                assert not [a.name for a in node.names if a.name.startswith("_")], path
                assert "._" not in node.module, path
                roots |= {a.asname or a.name for a in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and is_private(node.attr):
                base = node.value
                while isinstance(base, ast.Attribute):
                    base = base.value
                assert not (isinstance(base, ast.Name) and base.id in roots), (
                    f"{path}:{node.lineno}"
                )


def is_private(name):
    return name.startswith("_") and not name.startswith("__")
