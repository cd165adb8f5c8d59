"""The import arrows of the layout, read from the sources: no module reaches against the flow."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "python" / "ffpose"

# Each room and the rooms of ffpose that it may import. Leaves are open to all.
LEAVES = {"errors", "_internal"}
ALLOWED = {
    "__init__": {"_rust", "arrays", "geometry", "inference"},
    "errors": set(),
    "_internal": {"arrays"},
    "arrays": {"_rust"},
    "geometry": {"arrays"},
    "imaging": {"geometry", "arrays"},
    "ops": {"_rust"},
    "nn": {"ops", "geometry"},
    "config": {"geometry"},
    "models": {"nn", "imaging", "geometry", "config"},
    "datasets": {"geometry", "imaging", "render", "arrays"},
    "training": {
        *("models", "nn", "ops", "datasets", "render", "geometry", "imaging", "config"),
        *("evaluation",),
    },
    "evaluation": {
        *("models", "datasets", "geometry", "arrays", "imaging", "inference", "config", "render"),
        *("onnx", "ops", "training"),
    },
    "inference": {"models", "onnx", "config", "geometry", "imaging", "arrays"},
    "tracking": {
        *("_rust", "geometry", "imaging", "inference", "datasets", "evaluation", "arrays"),
    },
    "onnx": {"ops", "nn", "models", "config", "geometry", "imaging", "arrays"},
    "render": {"geometry", "arrays", "imaging"},
    "bench": {
        *("ops", "arrays", "models", "nn", "config", "onnx", "geometry", "imaging", "inference"),
    },
}
# Rooms within a room, and what they may import of it.
INNER = {
    "render.spacecraft": {"render.spacecraft"},
    "render.shading": {"render.shading", "render.spacecraft"},
    "evaluation.report": {
        *("evaluation.report", "evaluation.evaluate", "evaluation.calibration"),
    },
}
COMPOSE = {"cli", "demo", "learn"}  # these put the others together
LAZY = {
    "matplotlib",
    "timm",
    "onnx",
    "onnxruntime",
    "onnxscript",
    "onnx_ir",
    "openvino",
}  # never at import time


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py").removesuffix(".pyi")


def sources() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def imported(tree: ast.AST) -> set[str]:
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def outside_functions(tree: ast.Module) -> ast.Module:
    """The module without function bodies and `if TYPE_CHECKING` blocks: what runs at import."""

    class Strip(ast.NodeTransformer):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
            return None

        def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
            return None

        def visit_If(self, node: ast.If) -> ast.AST | None:
            if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
                return None
            return self.generic_visit(node)

    return Strip().visit(tree)


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_arrows_go_one_way(path):
    names = imported(ast.parse(path.read_text()))
    rooms = {name.split(".")[1] for name in names if name.startswith("ffpose.")}
    here = room(path)
    if here in COMPOSE:
        assert "cli" not in rooms
        return
    top_level_names = {"DataError", "Pose", "Camera", "__version__"}
    extra = rooms - ALLOWED[here] - LEAVES - {here} - top_level_names
    assert not extra, f"{here} imports {sorted(extra)}"


@pytest.mark.parametrize("inner", INNER)
def test_arrows_go_one_way_within_a_room(inner):
    outer = inner.partition(".")[0]
    paths = sorted((PACKAGE / inner.replace(".", "/")).glob("*.py"))
    assert paths
    for path in paths:
        names = {name.removeprefix("ffpose.") for name in imported(ast.parse(path.read_text()))}
        mine = {".".join(name.split(".")[:2]) for name in names if name.startswith(f"{outer}.")}
        assert mine <= INNER[inner], path


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_heavy_libraries_are_imported_where_they_are_used(path):
    names = imported(outside_functions(ast.parse(path.read_text())))
    assert not {name.split(".")[0] for name in names} & LAZY


def test_only_ops_arrays_and_tracking_touch_the_extension():
    """And the package itself, which lets it speak of the processor before NumPy is imported."""
    users = {
        room(path)
        for path in sources()
        if any(name.startswith("ffpose._rust") for name in imported(ast.parse(path.read_text())))
    }
    assert users == {"__init__", "arrays", "ops", "tracking"}
