"""Where glTF 2.0 takes vertices: transforms of nodes, skins and morph targets.

Sections are those of the specification (Khronos Group, "glTF 2.0 Specification", 2021).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffpose.geometry.rotations import rotation_matrix

Floats = NDArray[np.float64]
Shape = dict[str, NDArray[Any]]
"""Attributes of a primitive's vertices, each (V, K), by name."""

REST = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
"""What places a node, and where it changes nothing."""


def local_transform(node: dict[str, Any]) -> Floats:
    """Return the matrix (4, 4) of a node: given, or scale, then rotation, then translation."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix: Floats = transforms({name: [node[name]] for name in REST if name in node}, 1)[0]
    return matrix


def transforms(given: Mapping[str, ArrayLike], count: int) -> Floats:
    """Return matrices (N, 4, 4) of what is ``given`` (N, K) of `REST`."""
    move, rotation, scale = (
        np.asarray(given.get(name, [rest]), dtype=np.float64) for name, rest in REST.items()
    )
    norm = np.linalg.norm(rotation, axis=1, keepdims=True)
    unit = np.where(norm == 0, REST["rotation"], rotation / np.where(norm == 0, 1, norm))
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] = rotation_matrix(np.roll(unit, 1, axis=1)) * scale[:, None]
    matrices[:, :3, 3] = move
    return matrices


def morphed(name: str, values: NDArray[Any], deltas: NDArray[Any], weight: float) -> NDArray[Any]:
    """Return an attribute (V, K) with the weighted deltas of a morph target (section 3.7.2.2).

    Colors may have an alpha where their deltas have none, or the reverse.
    """
    if name != "COLOR_0":
        return values + weight * deltas
    opaque = np.pad(values, ((0, 0), (0, 4 - values.shape[1])), constant_values=1)
    return np.asarray(opaque + weight * np.pad(deltas, ((0, 0), (0, 4 - deltas.shape[1]))))


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
    """Return vectors (V, 3) by N matrices (N, 1, 3, 3), or each by its own (N, V, 3, 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))


def cofactors(matrices: Floats) -> Floats:
    """Return cofactors (..., 3, 3), by which normals turn; those of a mirror point inward too."""
    a, b, c = (matrices[..., row, :] for row in range(3))
    signs = np.where(np.linalg.det(matrices) < 0, -1.0, 1.0)[..., None, None]
    return signs * np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
