//! Values of textures for NumPy arrays.

use ffpose_scene::textures::{Faces, Points, Texture, sample};
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::border::{Side, Wrapping, array, enter};
use crate::in_use::Use;

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
    let texels = array::<u16>("texels", texels)?;
    let corners = array::<f32>("corners", corners)?;
    let means = array::<u16>("means", means)?;
    let face = array::<i32>("face", face)?;
    let weights = array::<f32>("weights", weights)?;
    let levels = array::<f32>("levels", levels)?;
    let shares = array::<f32>("shares", shares)?;
    let uses = [
        Use::of_array("texels", &texels, false),
        Use::of_array("corners", &corners, false),
        Use::of_array("means", &means, false),
        Use::of_array("face", &face, false),
        Use::of_array("weights", &weights, false),
        Use::of_array("levels", &levels, false),
        Use::of_array("shares", &shares, false),
    ];
    let (sides, wrap) = (sides.map(|side| side.0), wrap.map(|wrap| wrap.0));
    let texture = Texture { texels: texels.as_array(), sides, wrap };
    let faces = Faces { corners: corners.as_array(), means: means.as_array() };
    let points = Points {
        face: face.as_array(),
        weights: weights.as_array(),
        levels: levels.as_array(),
        shares: shares.as_array(),
    };
    let values = enter(py, &uses, || sample(&texture, &faces, &points))?;
    Ok(PyArray2::from_owned_array(py, values))
}
