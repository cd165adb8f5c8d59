"""Where glTF 2.0 takes vertices: transforms of nodes, skins and morph targets.

Sections are those of the specification (Khronos Group, "glTF 2.0 Specification", 2021).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Shape = dict[str, NDArray[Any]]
"""Attributes of a primitive's vertices, each (V, K), by name."""


def local_transform(node: dict[str, Any]) -> Floats:
    """Return the matrix (4, 4) of a node: given, or scale, then rotation, then translation."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = np.asarray(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    norm = x * x + y * y + z * z + w * w
    two = 2 / norm if norm > 0 else 0.0
    turn = np.array(
        [
            [1 - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w)],
            [two * (x * y + z * w), 1 - two * (x * x + z * z), two * (y * z - x * w)],
            [two * (x * z - y * w), two * (y * z + x * w), 1 - two * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = turn * np.asarray(node.get("scale", (1, 1, 1)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def morphed(name: str, values: NDArray[Any], deltas: NDArray[Any], weight: float) -> NDArray[Any]:
    """Return an attribute (V, K) with the weighted deltas of a morph target (section 3.7.2.2).

    Colors may have an alpha where their deltas have none, or the reverse, and stay within 0…1.
    """
    if name != "COLOR_0":
        return values + weight * deltas
    opaque = np.pad(values, ((0, 0), (0, 4 - values.shape[1])), constant_values=1)
    return (opaque + weight * np.pad(deltas, ((0, 0), (0, 4 - deltas.shape[1])))).clip(0, 1)


def blended(shape: Shape, joints: Floats) -> Floats:
    """Return where a skin takes each vertex (V, 3, 4): linear blend skinning (section 3.7.3.3).

    ``joints`` (J, 4, 4) are the joint matrices. A vertex whose weights are all zero moves with the
    first joint that it names.
    """
    sets = [name.removeprefix("JOINTS_") for name in shape if name.startswith("JOINTS_")]
    numbers = np.concatenate([shape[f"JOINTS_{name}"] for name in sets], axis=1).astype(np.intp)
    weights = np.concatenate([shape[f"WEIGHTS_{name}"] for name in sets], axis=1).astype(np.float64)
    if not np.isfinite(weights).all():
        raise ValueError("expected finite weights of joints, got NaN or infinity")
    if numbers.min() < 0 or numbers.max() >= len(joints):
        got = f"{numbers.min()}…{numbers.max()}"
        raise ValueError(f"expected joints 0…{len(joints) - 1}, got {got}")
    weights[weights.sum(axis=1) == 0, 0] = 1
    weights /= weights.sum(axis=1, keepdims=True)
    places = np.zeros((len(numbers), 3, 4))
    for its, share in zip(numbers.T, weights.T, strict=True):
        places += share[:, None, None] * joints[its, :3]
    return places


def turned(vectors: Floats, matrices: Floats) -> Floats:
    """Return vectors (V, 3) by a matrix (1, 3, 3), or each by its own (V, 3, 3)."""
    if len(matrices) == 1:
        found: Floats = vectors @ matrices[0].T
    else:
        found = np.einsum("vij,vj->vi", matrices, vectors)
    return found


def cofactors(matrices: Floats) -> Floats:
    """Return cofactors (N, 3, 3), by which normals turn; those of a mirror point inward too."""
    a, b, c = (matrices[:, row] for row in range(3))
    signs = np.where(np.linalg.det(matrices) < 0, -1.0, 1.0)
    return signs[:, None, None] * np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
