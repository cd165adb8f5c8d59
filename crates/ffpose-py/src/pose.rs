//! Quaternions and pose errors for NumPy arrays.

use ffpose_core::pose_error::{self, PosePairs};
use ffpose_core::quaternion;
use numpy::PyArray;
use pyo3::prelude::*;

use crate::array::{Array, with_dtype};
use crate::border::enter;

/// `compute` on the views of arrays of one element type.
macro_rules! on_arrays {
    ([$first:ident $(, $other:ident)*], $T:ident => $compute:expr) => {
        with_dtype!($first, $T => {
            let py = $first.py();
            let $first = Array::<$T>::new(stringify!($first), $first)?;
            $(let $other = Array::<$T>::new(stringify!($other), $other)?;)*
            let uses = [
                $first.used(false),
                $($other.used(false),)*
            ];
            let $first = $first.view();
            $(let $other = $other.view();)*
            let result = enter(py, &uses, || $compute)?;
            Ok(PyArray::from_owned_array(py, result).into_any())
        })
    };
}

/// q / |q| for rows (..., 4) in order w, x, y, z.
#[pyfunction]
pub(crate) fn normalize_quaternion<'py>(q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([q], T => quaternion::normalize(q))
}

/// The gradient of `normalize_quaternion` with respect to q (..., 4).
#[pyfunction]
pub(crate) fn normalize_quaternion_backward<'py>(
    grad: &Bound<'py, PyAny>,
    q: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([q, grad], T => quaternion::normalize_backward(grad, q))
}

/// The one of q and -q whose first component other than zero is positive, for rows (..., 4).
#[pyfunction]
pub(crate) fn canonical_quaternion<'py>(q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([q], T => quaternion::canonical(q))
}

/// Roll, pitch and yaw (..., 3) in degrees of q (..., 4).
#[pyfunction]
pub(crate) fn quaternion_to_euler<'py>(q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([q], T => quaternion::to_euler(q))
}

/// Unit quaternions (..., 4) of roll, pitch and yaw (..., 3) in degrees.
#[pyfunction]
pub(crate) fn euler_to_quaternion<'py>(rpy: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([rpy], T => quaternion::from_euler(rpy))
}

/// Distances (N,) of translations `t_hat` and `t` (N, 3).
#[pyfunction]
pub(crate) fn translation_error<'py>(
    t_hat: &Bound<'py, PyAny>,
    t: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([t_hat, t], T => pose_error::translation_error(t_hat, t))
}

/// Angles (N,) in degrees between orientations `q_hat` and `q` (N, 4).
#[pyfunction]
pub(crate) fn rotation_error<'py>(
    q_hat: &Bound<'py, PyAny>,
    q: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([q_hat, q], T => pose_error::rotation_error(q_hat, q))
}

/// Scores (N,) of ESA's pose estimation challenge of 2019.
#[pyfunction]
pub(crate) fn esa_score<'py>(
    t_hat: &Bound<'py, PyAny>,
    q_hat: &Bound<'py, PyAny>,
    t: &Bound<'py, PyAny>,
    q: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([t_hat, q_hat, t, q], T => {
        pose_error::esa_score(&PosePairs { t_hat, q_hat, t, q })
    })
}

/// Scores (N,) of the SPEED+ challenge of 2021.
#[pyfunction]
pub(crate) fn speed_plus_score<'py>(
    t_hat: &Bound<'py, PyAny>,
    q_hat: &Bound<'py, PyAny>,
    t: &Bound<'py, PyAny>,
    q: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    on_arrays!([t_hat, q_hat, t, q], T => {
        pose_error::speed_plus_score(&PosePairs { t_hat, q_hat, t, q })
    })
}
