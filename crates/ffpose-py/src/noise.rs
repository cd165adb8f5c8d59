//! Fractal noise for NumPy arrays.

use ffpose_scene::noise;
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::array::Array;
use crate::border::enter;

/// Fractal noise (N,) at points (3, N), from the heights (K,) of its octaves; float32.
#[pyfunction]
pub(crate) fn fractal_noise<'py>(
    py: Python<'py>,
    points: &Bound<'py, PyAny>,
    heights: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let points = Array::<f32>::new("points", points)?;
    let heights = Array::<f32>::new("heights", heights)?;
    let uses = [points.used(false), heights.used(false)];
    let (points, heights) = (points.view(), heights.view());
    let sums = enter(py, &uses, || noise::fractal(points, heights))?;
    Ok(PyArray1::from_owned_array(py, sums))
}
