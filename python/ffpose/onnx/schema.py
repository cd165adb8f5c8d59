"""Operators of other domains than ONNX's, as onnxscript calls them while it records."""

from __future__ import annotations

from functools import cache
from typing import Any

from ffpose.errors import require


@cache
def script_op(
    name: str,
    domain: str,
    version: int,
    inputs: tuple[str, ...],
    types: tuple[tuple[str, tuple[str, ...]], ...],
    attributes: tuple[tuple[str, str], ...],
) -> Any:
    """Return an operator with one output, which has the type of its first input.

    Args:
        name: Of the operator.
        domain: Its domain.
        version: Of the domain.
        inputs: Names of the inputs; each has a type of its own if ``types`` names it.
        types: By input, the element types it may have; inputs that are not named have the first's.
        attributes: Names and types, as ``("scale", "FLOAT")``.
    """
    schemas = require("onnx.defs", "export")
    values = require("onnxscript", "export").values
    schema = schemas.OpSchema
    named = dict(types)
    parameters = [
        schema.FormalParameter(part, part if part in named else inputs[0]) for part in inputs
    ]
    return values.Op(
        values.Opset(domain, version),
        name,
        schema(
            name,
            domain,
            version,
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
