"""New nodes of a graph: standard operators in the place of one, and operators of other domains."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffpose.errors import require

DOMAIN_VERSION = 1
"""Version of every domain but that of the standard operators."""


class Nodes:
    """New nodes of an `onnx_ir.Graph`, in their order, until `replace` puts them in.

    Args:
        graph: The graph.
        node: The node whose place they take; their values have the type of its first input,
            unless ``kind`` is given another.
    """

    def __init__(self, graph: Any, node: Any) -> None:
        self.ir = require("onnx_ir", "export")
        self.graph, self.node, self.kind = graph, node, node.inputs[0].dtype
        self.nodes: list[Any] = []

    def op(self, kind: str, *inputs: Any, **attributes: Any) -> Any:
        """Add a node, and return its output."""
        node = self.ir.node(kind, inputs, attributes)
        node.outputs[0].name = f"{self.node.outputs[0].name}/{len(self.nodes)}"
        node.outputs[0].dtype = self.kind
        self.nodes.append(node)
        return node.outputs[0]

    def reshape(self, value: Any, shape: Sequence[int]) -> Any:
        """Add a Reshape; 0 keeps a dimension, -1 takes what is left."""
        return self.op("Reshape", value, self.integers(shape))

    def integers(self, values: Sequence[int]) -> Any:
        """Return a constant of int64."""
        return self.constant(np.array(values, np.int64), "_".join(["integers", *map(str, values)]))

    def constant(self, values: NDArray[Any], name: str) -> Any:
        """Return the initializer of this name, made where there is none yet."""
        if name not in self.graph.initializers:
            tensor = self.ir.tensor(values, name=name)
            value = self.ir.Value(
                name=name,
                shape=tensor.shape,
                type=self.ir.TensorType(tensor.dtype),
                const_value=tensor,
            )
            self.graph.register_initializer(value)
        return self.graph.initializers[name]

    def replace(self, output: Any) -> None:
        """Put the nodes in the old one's place; ``output`` is used in place of its output."""
        self.ir.convenience.replace_nodes_and_values(
            self.graph, self.node, [self.node], self.nodes, self.node.outputs, [output]
        )


def nodes_of(model: Any, domain: str, kind: str) -> list[Any]:
    """Return the nodes of an operator in an `onnx_ir.Model`."""
    return [node for node in model.graph if (node.domain, node.op_type) == (domain, kind)]


@cache
def script_op(
    name: str,
    domain: str,
    inputs: tuple[str, ...],
    types: tuple[tuple[str, tuple[str, ...]], ...],
    attributes: tuple[tuple[str, str], ...] = (),
) -> Any:
    """Return a domain's operator for onnxscript, whose output has the type of its first input.

    ``types`` has, by input, the element types that it may have; inputs that are not named have the
    first's. Attributes are names and types, as ``("scale", "FLOAT")``.
    """
    schema = require("onnx.defs", "export").OpSchema
    values = require("onnxscript", "export").values
    named = dict(types)
    parameters = [
        schema.FormalParameter(part, part if part in named else inputs[0]) for part in inputs
    ]
    return values.Op(
        values.Opset(domain, DOMAIN_VERSION),
        name,
        schema(
            name,
            domain,
            DOMAIN_VERSION,
            inputs=parameters,
            outputs=[schema.FormalParameter("y", inputs[0])],
            type_constraints=[
                (part, [f"tensor({kind})" for kind in kinds], part) for part, kinds in types
            ],
            attributes=[
                schema.Attribute(key, getattr(schema.AttrType, kind), key, required=True)
                for key, kind in attributes
            ],
        ),
    )
