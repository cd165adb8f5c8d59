"""Export of torch modules with spectral filters as ONNX graphs, compared with torch.

torch's own exporter turns ``torch.fft`` into DFT nodes, which runtimes compute slowly or refuse.
Here a filter becomes one node of our own domain (``filter="custom"``), or products with real
matrices (``"matmul"``, see `ffpose.onnx.matrices`).
"""

from __future__ import annotations

import contextlib
import copy
import io
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ffpose._internal.files import atomic_write, expect_place
from ffpose._internal.torch_internals import uncompiled
from ffpose.errors import expect, require
from ffpose.onnx.attention import replace_attention
from ffpose.onnx.backends import open_session
from ffpose.onnx.int8 import SCOPES
from ffpose.onnx.matmul import replace_filters
from ffpose.onnx.metadata import Filter, sealed
from ffpose.onnx.nodes import nodes_of
from ffpose.onnx.operators import DOMAIN, SPECTRAL_FILTER, translations

OPSET = 18
"""Opset of the standard operators, supported by ONNX Runtime 1.17, OpenVINO 2024 and later."""

TOLERANCE = 1e-4
"""Largest difference between graph and module that counts as rounding, whatever the module."""

ROUNDINGS = 8
"""Number of times the module's own difference from float64 that counts as rounding too."""

FOLDED = 1 << 26
"""Largest constant that is folded, bytes; above the size of filters' weights."""

FEWEST_HALVED = 1024
"""Fewest numbers of a constant that is stored as float16, as that takes a node more."""

RULES = (
    *("add_0", "sub_0", "mul_by_1", "div_by_1"),
    *("no_op_cast", "no_op_expand", "no_op_transpose"),
    *("cast_cast", "transpose_transpose", "unsqueeze_unsqueeze", "reshape_reshape"),
    *("collapse_slice", "collapse_slice2", "squeeze_reshape_1d", "materialize_reshape_shape"),
    *("min_max", "max_min", "normalize_pad_format_conv", "fuse_pad_into_conv"),
    *("fuse_batchnorm_into_conv", "fuse_batchnorm_into_conv_transpose"),
    *("fuse_batchnorm_into_gemm", "remove_optional_bias_from_conv"),
)
"""Rules of onnxscript that a graph is simplified by: not ``slice_split``, which compares every pair
of slices and takes longer than all others."""

DTYPES = (
    *(torch.float16, torch.float32, torch.float64, torch.bool, torch.uint8),
    *(torch.int8, torch.int16, torch.int32, torch.int64),
)
"""Dtypes of a graph's inputs and outputs: those of NumPy, by which it is compared."""

FilterChoice = Literal["custom", "matmul"]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Exported:
    """An exported graph.

    Attributes:
        path: Its file.
        filter: How filters are computed: ``"custom"``, ``"matmul"``, or ``"none"`` without any.
        bytes: Size of the file.
        differences: Largest difference from the module by output.
    """

    path: Path
    filter: Filter
    bytes: int
    differences: Mapping[str, float] = field(default_factory=dict)


def export(
    module: nn.Module,
    args: Sequence[Tensor],
    path: str | Path,
    filter: FilterChoice = "custom",
    *,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    tolerance: float = TOLERANCE,
) -> Exported:
    """Write a module with spectral filters as an ONNX graph that takes batches of any size.

    The graph is run in ONNX Runtime on ``args``, and on ``args`` twice over as one batch, before
    the file appears; differences are relative to the output's largest number where that exceeds 1.
    An output may differ by ``tolerance``, or by `ROUNDINGS` times what the module differs from
    itself in float64: where a module loses digits, so does its graph.

    Args:
        module: On the CPU, in evaluation mode; ``SpectralFilter``, ``GlobalFilter`` and
            ``SequenceFilter`` of `ffpose.nn` may be in it.
        args: Of its forward: tensors whose first dimension is the batch.
        path: The ONNX file to write; its folder must exist.
        filter: ``"custom"``: filters call the operator of `ffpose.onnx.get_library_path`;
            ``"matmul"``: standard operators alone.
        input_names: Of the graph's inputs, in order; those of forward when None.
        output_names: Of the graph's outputs, in order.
        tolerance: Difference that is taken for rounding, whatever the module.

    Returns:
        What was written, with the differences that were found.

    Raises:
        MissingExtraError: onnx, onnxscript or onnxruntime is not installed.
        TypeError: Arguments that are no sequence of tensors, one string as names, or a dtype of
            inputs or outputs that NumPy has not, such as bfloat16.
        ValueError: An unknown filter, a module in training mode, or a part of it, a module that
            draws random numbers, a filter whose weight or size is not known, an argument without a
            batch, more names than inputs or outputs, or one name twice.
        OSError: The file cannot be written there.
        FileNotFoundError: The folder does not exist, or the operator's library, which the check
            needs, is not installed.
        RuntimeError: The graph differs from the module by more than rounding, or torch cannot
            export the module.
    """
    if not isinstance(args, Sequence):
        raise TypeError(f"args: expected a sequence of tensors, got {type(args).__name__}")
    expect(len(args) > 0, "args", "at least one tensor", args)
    for place, arg in enumerate(args):
        name = f"args[{place}]"
        if not isinstance(arg, Tensor):
            raise TypeError(f"{name}: expected a torch.Tensor, got {type(arg).__name__}")
        _expect_dtype(name, arg)
        expect(arg.dim() > 0, name, "a batch as the first dimension", tuple(arg.shape))
    _expect_names("input_names", input_names, len(args))
    batches = [tuple(args), tuple(torch.cat([arg, arg]) for arg in args)]
    return write_graph(
        uncompiled(module),
        batches,
        path,
        filter,
        lambda _: {},
        relative_differences,
        input_names=input_names,
        output_names=output_names,
        tolerance=tolerance,
    )


def write_graph(
    module: nn.Module,
    batches: Sequence[tuple[Tensor, ...]],
    path: str | Path,
    filter: FilterChoice,
    entries: Callable[[Filter], Mapping[str, str]],
    differences: Callable[[Outputs, Outputs], Mapping[str, float]],
    *,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    tolerance: float = TOLERANCE,
    say: Say = lambda _: None,
) -> Exported:
    """Write a graph, run it on every batch against the module, and rename it to ``path``.

    Arguments are as of `export`, but for ``batches``, arguments of forward in several batch sizes,
    the first of which is exported with; ``entries``, the file's metadata for how the graph computes
    its filters; ``differences``, which compares outputs of graph and module by name; and ``say``.
    """
    expect(filter in get_args(FilterChoice), "filter", f"one of {get_args(FilterChoice)}", filter)
    expect_place(Path(path))
    for name, child in module.named_modules(prefix="module"):
        if child.training:
            raise ValueError(f"{name}: expected evaluation mode, got training; call module.eval()")
    _expect_repeatable(module, batches, tolerance)
    say("recording the graph")
    model = record(module, batches[0], input_names, output_names, filter)
    if filter == "matmul":
        say(f"replacing {len(nodes_of(model, DOMAIN, SPECTRAL_FILTER))} filters by matrices")
    data, kind = serialized(model, filter, entries)
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)
        say(f"comparing with torch, batches of {', '.join(str(len(b[0])) for b in batches)}")
        found = _compare(module, batches, temporary, kind, differences)
        if beyond := [name for name, value in found.items() if not value <= tolerance]:
            rounding = _rounding(module, batches, found, differences)
            _expect_rounding({name: (found[name], rounding[name]) for name in beyond}, tolerance)
    return Exported(Path(path), kind, len(data), found)


Outputs = Mapping[str, NDArray[Any]]


def serialized(
    model: Any, filter: FilterChoice, entries: Callable[[Filter], Mapping[str, str]]
) -> tuple[bytes, Filter]:
    """Return the bytes of a recorded graph's file, and how it computes its filters.

    With ``"matmul"`` the filters of the `onnx_ir.Model` are replaced in place.
    """
    ours = any(node.domain == DOMAIN for node in model.graph)
    kind: Filter = filter if ours else "none"
    if filter == "matmul":
        replace_filters(model)
        replace_attention(model)
    halve(model)
    model.metadata_props.clear()
    model.metadata_props.update(entries(kind))
    return sealed(require("onnx_ir", "export").to_proto(model).SerializeToString()), kind


def relative_differences(got: Outputs, expected: Outputs) -> dict[str, float]:
    """Return the largest differences by output, over its largest number where that exceeds 1.

    An infinity or NaN has no difference from itself, and an infinite one from all else.
    """
    return {name: _relative(got[name], values) for name, values in expected.items()}


def _relative(got: NDArray[Any], expected: NDArray[Any]) -> float:
    got, expected = got.astype(np.float64), expected.astype(np.float64)
    equal = (got == expected) | (np.isnan(got) & np.isnan(expected))
    apart = np.subtract(got, expected, out=np.zeros_like(got), where=~equal)
    apart[np.isnan(apart)] = np.inf
    scale = np.max(np.abs(expected), where=np.isfinite(expected), initial=1.0)
    return float(np.max(np.abs(apart), initial=0.0) / scale)


def record(
    module: nn.Module,
    args: tuple[Tensor, ...],
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    filter: FilterChoice = "custom",
) -> Any:
    """Return the `onnx_ir.Model` of a module, its batch of any size; arguments as `export`.

    With ``"matmul"`` it is written in standard operators but for its filters, which
    `replace_filters` can replace.
    """
    shapes = tuple({0: torch.export.Dim.DYNAMIC} for _ in args)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), torch.no_grad():
        warnings.simplefilter("ignore")  # of torch's exporter, about itself
        program = torch.onnx.export(
            module,
            args,
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=input_names,
            dynamic_shapes=shapes,
            custom_translation_table=translations(standard=filter == "matmul"),
            optimize=False,
        )
        assert program is not None
        simplify(program.model)
    compact(program.model)
    name_outputs(program.model, output_names or ())
    return program.model


def simplify(model: Any) -> None:
    """Compute constants of an `onnx_ir.Model`, and leave out what does nothing, in place."""
    optimizer = require("onnxscript.optimizer", "export")
    rewriter = require("onnxscript.rewriter", "export")
    rules = require("onnxscript.rewriter.rules.common", "export")
    passes = require("onnx_ir.passes.common", "export")
    passes.InlinePass()(model)
    optimizer.fold_constants(
        model, onnx_shape_inference=True, input_size_limit=FOLDED, output_size_limit=FOLDED
    )
    rewriter.rewrite(model, [getattr(rules, f"{name}_rule") for name in RULES])
    passes.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
    passes.DeduplicateInitializersPass()(model)
    passes.LiftSubgraphInitializersToMainGraphPass()(model)
    passes.CommonSubexpressionEliminationPass()(model)


def compact(model: Any) -> None:
    """Leave out of an `onnx_ir.Model` what takes room alone, in place.

    Constants are kept once, and of the recorded notes those of modules, which `ffpose.onnx.int8`
    reads; stack traces are longer than the nodes.
    """
    ir, passes = require("onnx_ir", "export"), require("onnx_ir.passes.common", "export")
    passes.IdentityEliminationPass()(model)
    for value in model.graph.initializers.values():  # equal ones are found by their bytes
        array = value.const_value.numpy()
        if not array.flags.c_contiguous:
            value.const_value = ir.tensor(np.ascontiguousarray(array), name=value.name)
    passes.DeduplicateHashedInitializersPass()(model)
    for node in model.graph:
        for key in [key for key in node.metadata_props if key != SCOPES]:
            del node.metadata_props[key]
        for output in node.outputs:
            output.metadata_props.clear()


def name_outputs(model: Any, names: Sequence[str]) -> None:
    """Give outputs of an `onnx_ir.Model` names, those that are one value or an input too."""
    passes = require("onnx_ir.passes.common", "export")
    inputs = [value.name for value in model.graph.inputs]
    _expect_names("output_names", names, len(model.graph.outputs), taken=inputs)
    passes.OutputFixPass()(model)  # an output that is an input takes its name
    for value, name in (
        *zip(model.graph.inputs, inputs, strict=True),
        *zip(model.graph.outputs, names, strict=False),
    ):
        value.name = name
    passes.NameFixPass()(model)


def _expect_names(
    name: str, names: Sequence[str] | None, most: int, taken: Sequence[str] = ()
) -> None:
    if isinstance(names, str):
        raise TypeError(f"{name}: expected a sequence of names, got the one string {names!r}")
    names = names or ()
    if len(names) > most:
        raise ValueError(f"{name}: expected at most {most}, got {', '.join(names)}")
    if len({*taken, *names}) < len(taken) + len(names):
        got = ", ".join((*taken, *names))
        raise ValueError(f"{name}: expected names of one value each, got {got}")


def halve(model: Any) -> None:
    """Store as float16 those constants of an `onnx_ir.Model` that lose nothing by it, in place.

    Nearly all shipped weights are such numbers. A node makes float32 of each, which runtimes
    compute as they load the graph, not as they run it.
    """
    ir, graph = require("onnx_ir", "export"), model.graph
    for name, value in list(graph.initializers.items()):
        whole = value.const_value.numpy()
        few = whole.size < FEWEST_HALVED
        if whole.dtype != np.float32 or few or value.is_graph_output():
            continue
        with np.errstate(over="ignore"):
            half = whole.astype(np.float16)
        if not np.array_equal(half, whole):
            continue
        node = ir.node("Cast", [ir.Value(name=f"{name}/float16")], {"to": ir.DataType.FLOAT})
        stored, (cast,) = node.inputs[0], node.outputs
        stored.const_value = ir.tensor(half, name=stored.name)
        stored.shape, stored.dtype = value.shape, ir.DataType.FLOAT16
        cast.shape, cast.dtype = value.shape, value.dtype
        ir.convenience.replace_all_uses_with(value, cast)
        del graph.initializers[name]
        cast.name = name
        graph.register_initializer(stored)
        graph.insert_before(graph[0], node)


def tensors_of(result: Any) -> list[Tensor]:
    """Return the tensors of a module's result, however tuples, lists and dicts nest them.

    None is left out, as torch's exporter does.
    """
    if isinstance(result, Tensor):
        return [result]
    if result is None:
        return []
    members = result.values() if isinstance(result, Mapping) else result
    return [tensor for member in members for tensor in tensors_of(member)]


def _compare(
    module: nn.Module,
    batches: Sequence[tuple[Tensor, ...]],
    path: Path,
    kind: Filter,
    differences: Callable[[Outputs, Outputs], Mapping[str, float]],
) -> dict[str, float]:
    """Return the largest difference of each output over all batches."""
    session = open_session(path, kind)
    runs = ((args, session.run(*(arg.detach().numpy() for arg in args))) for args in batches)
    return _largest_of(
        differences(got, dict(zip(got, _outputs(module, args), strict=True))) for args, got in runs
    )


def _expect_repeatable(
    module: nn.Module, batches: Sequence[tuple[Tensor, ...]], tolerance: float
) -> None:
    """Refuse a module that gives something else when it is run again, as one that draws numbers."""
    runs = ([_outputs(module, args) for _ in range(2)] for args in batches)
    apart = [_relative(*pair) for both in runs for pair in zip(*both, strict=True)]
    largest = float(np.max(apart, initial=0.0))
    if not largest <= tolerance:
        raise ValueError(
            "module: expected one that gives the same result twice, got a difference of"
            f" {largest:.3g}; dropout by a function needs training=self.training"
        )


def _rounding(
    module: nn.Module,
    batches: Sequence[tuple[Tensor, ...]],
    names: Collection[str],
    differences: Callable[[Outputs, Outputs], Mapping[str, float]],
) -> dict[str, float]:
    """Return the largest difference of each output from float64's; 0 where that cannot be run."""
    exact = copy.deepcopy(module).double()
    found = []
    try:
        for args in batches:
            doubled = [arg.double() if arg.is_floating_point() else arg for arg in args]
            both = _outputs(module, args), _outputs(exact, doubled)
            found.append(differences(*(dict(zip(names, each, strict=True)) for each in both)))
    except (RuntimeError, TypeError):  # of a type written into the module
        return dict.fromkeys(names, 0.0)
    return _largest_of(found)


def _outputs(module: nn.Module, args: Iterable[Tensor]) -> list[NDArray[Any]]:
    with torch.no_grad():
        leaves = tensors_of(module(*args))
    for place, leaf in enumerate(leaves):
        _expect_dtype(f"output {place}", leaf)
    return [leaf.detach().numpy() for leaf in leaves]


def _expect_dtype(name: str, tensor: Tensor) -> None:
    if tensor.dtype not in DTYPES:
        known = "float16, float32 or float64, whole numbers or bool"
        raise TypeError(f"{name}: expected {known}, got {tensor.dtype}")


def _largest_of(differences: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the largest value of each name; NaN where there is one."""
    largest: dict[str, float] = {}
    for values in differences:
        for name, value in values.items():
            largest[name] = float(np.maximum(value, largest.get(name, 0.0)))
    return largest


def _expect_rounding(found: Mapping[str, tuple[float, float]], tolerance: float) -> None:
    """Refuse differences beyond `ROUNDINGS` of the module's own; ``found`` holds pairs of these."""
    got = [
        f"{name} {value:.3g} (the module from float64: {rounding:.3g})"
        for name, (value, rounding) in found.items()
        if not value <= ROUNDINGS * rounding < np.inf
    ]
    if got:
        raise RuntimeError(
            f"export: expected graph and module to differ by at most {tolerance:g}, or by"
            f" {ROUNDINGS} times what the module differs from float64, got {', '.join(got)};"
            " no file was written"
        )
