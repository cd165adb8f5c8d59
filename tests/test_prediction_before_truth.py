"""What is predicted comes before what is true, in every function that compares the two."""

import ast
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import ffpose
from ffpose import arrays
from ffpose.evaluation import attitude, metrics

SOURCES = sorted(Path(ffpose.__file__).parent.rglob("*.py*"))
TRUE_NAMES = {"t_hat": {"t", "q"}, "q_hat": {"t", "q"}, "predicted": {"truth"}, "found": {"truth"}}
T_HAT, T = np.array([[3.0, 0.0, 14.0]]), np.array([[0.0, 0.0, 10.0]])  # 5 m apart; at 14.3 and 10 m
Q = np.array([[1.0, 0.0, 0.0, 0.0]])


def is_source(path):
    return path.suffix in (".py", ".pyi")


def compared(function):
    """Pairs (predicted, true) of a function's parameters."""
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args)]
    return [
        (names.index(hat), names.index(true), f"{function.name}({', '.join(names)})")
        for hat, others in TRUE_NAMES.items()
        for true in others
        if hat in names and true in names
    ]


def test_parameters_of_all_functions_are_in_that_order():
    functions = [
        node
        for path in filter(is_source, SOURCES)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    ]
    pairs = [pair for function in functions for pair in compared(function)]
    assert len(pairs) > 20
    assert not [name for predicted, true, name in pairs if predicted > true]


@pytest.mark.parametrize(
    ("function", "others", "name"),
    [
        (arrays.translation_error, (T,), "t_hat"),
        (arrays.rotation_error, (Q,), "q_hat"),
        (arrays.esa_score, (Q, T, Q), "t_hat"),
        (arrays.speed_plus_score, (Q, T, Q), "t_hat"),
        (attitude.rotation_error_vector, (Q,), "q_hat"),
        (attitude.rotation_parts, (T, Q), "q_hat"),
    ],
)
def test_the_first_argument_is_the_prediction(function, others, name):
    first = np.full_like(T if name == "t_hat" else Q, np.nan)
    with pytest.raises(ValueError, match=rf"^{name}\b.*row 0"):
        function(first, *others)


def test_relative_errors_are_of_the_true_distance():
    """By hand: 5 m of the true 10 m, not of the predicted 14.3 m."""
    assert arrays.esa_score(T_HAT, Q, T, Q) == pytest.approx(0.5)
    assert arrays.speed_plus_score(T_HAT, Q, T, Q) == pytest.approx(0.5)
    errors = metrics.pose_error(*map(torch.from_numpy, (T_HAT, Q, T, Q)))
    assert float(errors.relative_translation) == float(errors.esa_score) == pytest.approx(0.5)


def test_the_rotation_vector_leads_from_the_prediction_to_the_truth():
    truth = Rotation.from_rotvec([[0.1, 0.2, -0.3]]).as_quat(scalar_first=True)
    np.testing.assert_allclose(attitude.rotation_error_vector(Q, truth), [[0.1, 0.2, -0.3]])


def test_the_viewing_ray_is_that_of_the_truth():
    """By hand: after a turn about x, the ray along z leaves by the whole angle."""
    q_hat = Rotation.from_rotvec([[0.5, 0.0, 0.0]]).as_quat(scalar_first=True)
    parts = attitude.rotation_parts(q_hat, T, Q)
    assert parts.out_of_plane_deg[0] == pytest.approx(np.degrees(0.5))
