//! Fractal noise for NumPy arrays.

use ffpose_scene::noise;
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::border::{array, enter};
use crate::in_use::Use;

/// Fractal noise (N,) at points (3, N), from the heights (K,) of its octaves; float32.
#[pyfunction]
pub(crate) fn fractal_noise<'py>(
    py: Python<'py>,
    points: &Bound<'py, PyAny>,
    heights: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let points = array::<f32>("points", points)?;
    let heights = array::<f32>("heights", heights)?;
    let uses = [Use::of_array("points", &points, false), Use::of_array("heights", &heights, false)];
    let (points, heights) = (points.as_array(), heights.as_array());
    let sums = enter(py, &uses, || noise::fractal(points, heights))?;
    Ok(PyArray1::from_owned_array(py, sums))
}
