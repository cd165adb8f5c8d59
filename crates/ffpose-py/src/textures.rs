//! Values of textures for NumPy arrays.

use ffpose_scene::textures::{Faces, Points, Texture, sample};
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::array::Array;
use crate::border::{Side, Wrapping, enter};

/// Values (4, N) of a texture at points on faces; float32.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // Python gives the fields of `Texture`, `Faces` and `Points` one by one
pub(crate) fn sample_texture<'py>(
    py: Python<'py>,
    texels: &Bound<'py, PyAny>,
    sides: [Side; 2],
    wrap: [Wrapping; 2],
    corners: &Bound<'py, PyAny>,
    means: &Bound<'py, PyAny>,
    face: &Bound<'py, PyAny>,
    weights: &Bound<'py, PyAny>,
    levels: &Bound<'py, PyAny>,
    shares: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let texels = Array::<u16>::new("texels", texels)?;
    let corners = Array::<f32>::new("corners", corners)?;
    let means = Array::<u16>::new("means", means)?;
    let face = Array::<i32>::new("face", face)?;
    let weights = Array::<f32>::new("weights", weights)?;
    let levels = Array::<f32>::new("levels", levels)?;
    let shares = Array::<f32>::new("shares", shares)?;
    let uses = [
        texels.used(false),
        corners.used(false),
        means.used(false),
        face.used(false),
        weights.used(false),
        levels.used(false),
        shares.used(false),
    ];
    let (sides, wrap) = (sides.map(|side| side.0), wrap.map(|wrap| wrap.0));
    let texture = Texture { texels: texels.view(), sides, wrap };
    let faces = Faces { corners: corners.view(), means: means.view() };
    let points = Points {
        face: face.view(),
        weights: weights.view(),
        levels: levels.view(),
        shares: shares.view(),
    };
    let values = enter(py, &uses, || sample(&texture, &faces, &points))?;
    Ok(PyArray2::from_owned_array(py, values))
}
