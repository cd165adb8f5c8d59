"""Any module with spectral filters as a graph, against torch in float64."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

import ffpose.onnx
from ffpose.nn import GlobalFilter, QuaternionActivation, SequenceFilter, SpectralFilter
from ffpose.onnx.library import ELF_NAME, NAMES

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
runtime = pytest.importorskip("onnxruntime")
exporter = pytest.importorskip("ffpose.onnx.exporter")

LIBRARY = Path(ffpose.onnx.__file__).parent
needs_library = pytest.mark.skipif(
    not any((LIBRARY / name).is_file() for name in (ELF_NAME, *NAMES.values())),
    reason="the custom operator's library is not built",
)


class Mixed(nn.Module):
    """A filter of each kind, and the quaternion activation, on tokens (B, 36, 8)."""

    def __init__(self):
        super().__init__()
        self.grid = GlobalFilter(8, h=6, w=4)
        self.sequence = SequenceFilter(36, 8)
        self.tokens = SpectralFilter((36, 8))
        self.norm = nn.LayerNorm(8)
        self.head = nn.Linear(8, 4)
        self.activation = QuaternionActivation()
        for parameter in (self.grid.complex_weight, self.sequence.weight, self.tokens.weight):
            nn.init.normal_(parameter)

    def forward(self, x):
        for layer in (self.grid, self.sequence, self.tokens):
            x = x + self.norm(layer(x))
        return x, self.activation(self.head(x.mean(1)))


@pytest.fixture(scope="module")
def mixed():
    torch.manual_seed(0)
    return Mixed().eval()


@pytest.fixture(scope="module")
def by_matrices(mixed, tmp_path_factory):
    path = tmp_path_factory.mktemp("graphs") / "mixed.onnx"
    return ffpose.onnx.export(
        mixed, (torch.randn(2, 36, 8),), path, "matmul", output_names=["tokens", "quaternion"]
    )


def in_float64(module, x):
    with torch.no_grad():
        return [y.numpy() for y in deepcopy(module).double()(x.double())]


@pytest.mark.parametrize("batch", [1, 2, 5])
def test_matrices_give_what_torch_gives(mixed, by_matrices, batch):
    x = torch.randn(batch, 36, 8)
    session = runtime.InferenceSession(by_matrices.path, providers=["CPUExecutionProvider"])
    got = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    for values, expected in zip(got, in_float64(mixed, x), strict=True):
        np.testing.assert_allclose(values, expected, rtol=0, atol=2e-5)


def test_matrices_are_standard_operators(by_matrices):
    model = onnx.load(by_matrices.path)
    onnx.checker.check_model(model, full_check=True)
    assert {opset.domain: opset.version for opset in model.opset_import} == {"": exporter.OPSET}
    assert by_matrices.filter == "matmul"
    assert by_matrices.bytes == by_matrices.path.stat().st_size
    assert set(by_matrices.differences) == {"tokens", "quaternion"}
    assert max(by_matrices.differences.values()) < 1e-5


def test_the_operator_computes_the_graph_with_constant_weights(mixed):
    """By onnx's reference evaluator, with the operator in NumPy."""

    class SpectralFilterByNumpy(onnx.reference.op_run.OpRun):
        op_domain = "ffpose"

        def _run(self, x, weight, layout=None):
            axes = (-2, -1) if layout == "tokens" else (-3, -2)
            spectrum = np.fft.rfft2(x, axes=axes) * (weight[..., 0] + 1j * weight[..., 1])
            size = [x.shape[axis] for axis in axes]
            return (np.fft.irfft2(spectrum, s=size, axes=axes).astype(x.dtype),)

    SpectralFilterByNumpy.__name__ = "SpectralFilter"
    x = torch.randn(3, 36, 8)
    ir_model = exporter.record(mixed, (torch.randn(2, 36, 8),))
    model = pytest.importorskip("onnx_ir").to_proto(ir_model)
    constants = {tensor.name for tensor in model.graph.initializer}
    nodes = [node for node in model.graph.node if node.domain == "ffpose"]
    assert [node.attribute[0].s for node in nodes] == [b"grid", b"grid", b"tokens"]
    assert {node.input[1] for node in nodes} <= constants
    evaluator = onnx.reference.ReferenceEvaluator(model, new_ops=[SpectralFilterByNumpy])
    got = evaluator.run(None, {model.graph.input[0].name: x.numpy()})
    for values, expected in zip(got, in_float64(mixed, x), strict=True):
        np.testing.assert_allclose(values, expected, rtol=0, atol=2e-5)


class Constants(nn.Module):
    """Constants that float16 holds, and others: beyond its range, its precision, and few."""

    def __init__(self):
        super().__init__()
        numbers = torch.randn(4, 32, 64).half().float()
        held, large, fine, few = numbers[0], 1e5 * numbers[1], numbers[2] + 1e-6, numbers[3, 0]
        for name, value in {"held": held, "large": large, "fine": fine, "few": few}.items():
            self.register_buffer(name, value)

    def forward(self, x):
        return (x * self.held + self.large) * self.fine + self.few


def test_constants_that_float16_holds_are_stored_so(tmp_path):
    """The graph computes in float32 with the very numbers, and halves what it can."""
    torch.manual_seed(0)
    module, x = Constants().eval(), torch.randn(2, 32, 64)
    exported = ffpose.onnx.export(module, (x,), tmp_path / "a.onnx")
    constants = onnx.load(exported.path).graph.initializer
    kinds = {tensor.name: tensor.data_type for tensor in constants}
    half, single = onnx.TensorProto.FLOAT16, onnx.TensorProto.FLOAT
    assert kinds == {"held/float16": half, "large": single, "fine": single, "few": single}
    session = runtime.InferenceSession(exported.path, providers=["CPUExecutionProvider"])
    (got,) = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    np.testing.assert_array_equal(got, module(x).numpy())


@needs_library
def test_the_library_gives_what_torch_gives(mixed, tmp_path):
    exported = ffpose.onnx.export(mixed, (torch.randn(2, 36, 8),), tmp_path / "mixed.onnx")
    assert exported.filter == "custom"
    options = runtime.SessionOptions()
    options.register_custom_ops_library(ffpose.onnx.get_library_path())
    session = runtime.InferenceSession(exported.path, options, providers=["CPUExecutionProvider"])
    x = torch.randn(5, 36, 8)
    got = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    for values, expected in zip(got, in_float64(mixed, x), strict=True):
        np.testing.assert_allclose(values, expected, rtol=0, atol=2e-5)


def test_a_graph_that_differs_is_not_written(tmp_path, monkeypatch):
    other, record = nn.Linear(8, 4).eval(), exporter.record
    monkeypatch.setattr(exporter, "record", lambda _, *args: record(other, *args))
    with pytest.raises(
        RuntimeError, match=r"at most 0\.0001, or by 8 .*, got .* from float64: .*; no file was"
    ):
        ffpose.onnx.export(nn.Linear(8, 4).eval(), (torch.randn(2, 8),), tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


class Amplified(nn.Module):
    """A filter whose rounding error grows ten thousand times."""

    def __init__(self):
        super().__init__()
        self.filter = GlobalFilter(8, h=6, w=4)
        nn.init.normal_(self.filter.complex_weight)

    def forward(self, x):
        return torch.sin(1e4 * self.filter(x))


@pytest.mark.slow
def test_a_graph_that_loses_the_digits_its_module_loses_is_written(tmp_path):
    torch.manual_seed(0)
    module, x = Amplified().eval(), torch.randn(2, 36, 8)
    (found,) = ffpose.onnx.export(module, (x,), tmp_path / "a.onnx", "matmul").differences.values()
    assert found > exporter.TOLERANCE
    exact = deepcopy(module).double()(x.double())
    assert (module(x) - exact).abs().max() > exporter.TOLERANCE


class InFloat32(Amplified):
    def forward(self, x):
        return super().forward(x.float())


def test_a_module_that_float64_cannot_run_has_the_tolerance_alone(tmp_path):
    torch.manual_seed(0)
    with pytest.raises(RuntimeError, match=r"from float64: 0\)"):
        ffpose.onnx.export(
            InFloat32().eval(), (torch.randn(2, 36, 8),), tmp_path / "a.onnx", "matmul"
        )


def test_a_module_without_filters_needs_no_library(tmp_path, monkeypatch):
    monkeypatch.setattr("ffpose.onnx.library.ELF_NAME", "nowhere.so")
    exported = ffpose.onnx.export(nn.Tanh().eval(), (torch.randn(2, 8),), tmp_path / "a.onnx")
    assert exported.filter == "none"


class Repeated(nn.Module):
    def forward(self, x):
        once = x + 1
        return once, x + 1, once, x


class Tempered(nn.Module):
    """Returns a parameter beside its output."""

    def __init__(self):
        super().__init__()
        self.temperature = nn.Parameter(torch.ones(()))

    def forward(self, x):
        return x / self.temperature, self.temperature


def test_an_output_that_requires_a_gradient_is_a_number(tmp_path):
    path = tmp_path / "tempered.onnx"
    exporter.export(Tempered().eval(), (torch.randn(2, 3),), path)
    assert len(runtime.InferenceSession(path).get_outputs()) == 2


def test_outputs_that_are_one_value_keep_their_names(tmp_path):
    names = ["first", "again", "the same", "input"]
    x = torch.randn(2, 3)
    path = tmp_path / "repeated.onnx"
    exporter.export(Repeated().eval(), (x,), path, output_names=names)
    session = runtime.InferenceSession(path)
    assert [output.name for output in session.get_outputs()] == names
    for got, expected in zip(session.run(None, {"x": x.numpy()}), [x + 1] * 3 + [x], strict=True):
        np.testing.assert_array_equal(got, expected.numpy())
    assert len(exporter.export(Repeated().eval(), (x,), path).differences) == 4
    with pytest.raises(ValueError, match="expected at most 4, got a, b, c, d, e"):
        exporter.export(Repeated().eval(), (x,), path, output_names=list("abcde"))


X = torch.zeros(2, 8)


@pytest.mark.parametrize(
    ("args", "names", "error", "text"),
    [
        (X, {}, TypeError, "args: expected a sequence of tensors, got Tensor"),
        (X.numpy(), {}, TypeError, "args: expected a sequence of tensors, got ndarray"),
        (None, {}, TypeError, "args: expected a sequence of tensors, got NoneType"),
        ((), {}, ValueError, r"args: expected at least one tensor, got \(\)"),
        ((X, (4, 2)), {}, TypeError, r"args\[1\]: expected a torch.Tensor, got tuple"),
        ((X.numpy(),), {}, TypeError, r"args\[0\]: expected a torch.Tensor, got ndarray"),
        ((torch.tensor(2.0),), {}, ValueError, r"args\[0\]: expected a batch .*, got \(\)"),
        ((X,), {"input_names": "x"}, TypeError, "input_names: .* got the one string 'x'"),
        ((X,), {"input_names": ["x", "y"]}, ValueError, "input_names: .* most 1, got x, y"),
        ((X,), {"output_names": "logits"}, TypeError, "output_names: .* the one string 'logits'"),
        ((X,), {"output_names": ["y", "y"]}, ValueError, "output_names: .* each, got x, y, y"),
        ((X,), {"output_names": ["x"]}, ValueError, "output_names: .* each, got x, x"),
    ],
)
def test_wrong_arguments_are_named(args, names, error, text, tmp_path):
    with pytest.raises(error, match=text):
        ffpose.onnx.export(Repeated().eval(), args, tmp_path / "a.onnx", **names)


def test_a_wrong_place_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(exporter, "record", None)
    with pytest.raises(FileNotFoundError, match=r"existing folder for .*nowhere/a\.onnx"):
        ffpose.onnx.export(nn.Tanh().eval(), (X,), tmp_path / "nowhere" / "a.onnx")
    with pytest.raises(OSError, match="expected a file to write"):
        ffpose.onnx.export(nn.Tanh().eval(), (X,), tmp_path)


def test_a_compiled_module_is_exported(tmp_path):
    module = nn.Linear(8, 3).eval()
    exported = ffpose.onnx.export(torch.compile(module), (X + 1,), tmp_path / "a.onnx")
    session = runtime.InferenceSession(exported.path, providers=["CPUExecutionProvider"])
    x = torch.randn(5, 8)
    (got,) = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    expected = module.double()(x.double()).detach().numpy()
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)


def test_what_cannot_be_exported_is_refused(tmp_path):
    x = torch.randn(2, 8)
    with pytest.raises(ValueError, match="evaluation mode, got training"):
        ffpose.onnx.export(nn.Tanh(), (x,), tmp_path / "a.onnx")
    with pytest.raises(ValueError, match=r"filter: expected one of .*, got 'fft'"):
        ffpose.onnx.export(nn.Tanh().eval(), (x,), tmp_path / "a.onnx", "fft")


class Varied(nn.Module):
    """A filter, and something after it."""

    def __init__(self, then):
        super().__init__()
        self.filter, self.drop, self.then = GlobalFilter(8, h=6, w=4), nn.Dropout(), then

    def forward(self, x):
        return self.then(self.drop(self.filter(x)))


@pytest.mark.parametrize("then", [nn.functional.dropout, lambda y: y + torch.randn_like(y)])
def test_a_module_that_draws_numbers_is_refused(then, tmp_path):
    with pytest.raises(ValueError, match="module: expected one that gives the same result twice"):
        ffpose.onnx.export(Varied(then).eval(), (torch.randn(2, 36, 8),), tmp_path / "a.onnx")


def test_what_is_not_finite_differs_from_all_but_itself():
    inf, nan = np.inf, np.nan
    cases = [
        ([-inf, inf, nan, 4.0], [-inf, inf, nan, 5.0], 0.2),
        ([0.25, -inf], [0.5, -inf], 0.25),
        ([inf, 0.0], [-inf, 0.0], inf),
        ([nan, 0.0], [1.0, 0.0], inf),
        ([1.0, 0.0], [nan, 0.0], inf),
        ([1e30], [inf], inf),
        ([], [], 0.0),
    ]
    for got, expected, difference in cases:
        pair = ({"y": np.array(values, np.float32)} for values in (got, expected))
        assert exporter.relative_differences(*pair)["y"] == pytest.approx(difference)


def test_masked_logits_are_exported_and_infinite_differences_are_no_rounding(tmp_path):
    x = torch.randn(2, 36, 8)
    masked = Varied(lambda y: torch.where(torch.arange(8) < 3, -torch.inf, y)).eval()
    (found,) = ffpose.onnx.export(masked, (x,), tmp_path / "a.onnx", "matmul").differences.values()
    assert found < 1e-5
    with pytest.raises(RuntimeError, match="got y inf"):
        exporter._expect_rounding({"y": (np.inf, np.inf)}, exporter.TOLERANCE)


def test_outputs_of_bool_and_whole_numbers_are_compared_and_none_is_left_out(tmp_path):
    x = torch.randn(2, 36, 8)
    module = Varied(lambda y: {"logits": y, "loss": None, "seen": (y > 0, y.argmax(-1), None)})
    exported = ffpose.onnx.export(module.eval(), (x,), tmp_path / "a.onnx", "matmul")
    found, seen, place = exported.differences.values()
    assert found < 1e-5
    assert (seen, place) == (0.0, 0.0)


def test_a_dtype_that_numpy_has_not_is_named(tmp_path):
    x = torch.randn(2, 36, 8)
    for then, args, name, dtype in (
        (torch.tanh, (x.bfloat16(),), r"args\[0\]", torch.bfloat16),
        (lambda y: (y, y.bfloat16()), (x,), "output 1", torch.bfloat16),
        (torch.fft.rfft, (x,), "output 0", torch.complex64),
    ):
        with pytest.raises(TypeError, match=f"^{name}: expected float16, float32 .* got {dtype}$"):
            ffpose.onnx.export(Varied(then).eval(), args, tmp_path / "a.onnx")


@pytest.mark.parametrize("shape", [(2, 36, 8), (2, 3, 36, 8)])
def test_matrices_take_half_precision_with_a_float32_weight(shape, tmp_path):
    module, x = SpectralFilter((36, 8), std=1.0).eval(), torch.randn(shape).half()
    exported = ffpose.onnx.export(module, (x,), tmp_path / "a.onnx", "matmul")
    session = runtime.InferenceSession(exported.path, providers=["CPUExecutionProvider"])
    (got,) = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    expected = module.double()(x.double()).detach().numpy()
    assert got.dtype == np.float16
    np.testing.assert_allclose(got, expected, rtol=2**-11, atol=1e-5)


def test_a_part_in_training_mode_is_named(tmp_path):
    module = Varied(torch.tanh).eval()
    module.drop.train()
    with pytest.raises(ValueError, match=r"^module\.drop: expected evaluation mode, got training"):
        ffpose.onnx.export(module, (torch.randn(2, 36, 8),), tmp_path / "a.onnx")


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setattr("ffpose.onnx.library.ELF_NAME", "nowhere.so")
    monkeypatch.setattr("ffpose.onnx.library.NAMES", {})
    with pytest.raises(FileNotFoundError, match=r"operator at .*nowhere\.so.*--filter matmul"):
        ffpose.onnx.get_library_path()
