//! The Earth of rendered scenes for NumPy arrays.

use ffpose_scene::earth::{Earth, Seen, shade};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::array::Array;
use crate::border::{Numbers, Octaves, enter};

/// Radiance (3, N) of the Earth along rays (3, N), and the part (N,) of what lies behind that still shows; float32.
#[pyfunction]
#[allow(clippy::too_many_arguments, clippy::type_complexity)] // Python gives the fields of `Earth` one by one
pub(crate) fn shade_earth<'py>(
    py: Python<'py>,
    rays: &Bound<'py, PyAny>,
    nadir: Numbers<[f32; 3]>,
    altitude: Numbers<f32>,
    sun: Numbers<[f32; 3]>,
    ground: Numbers<[[f32; 3]; 3]>,
    detail: Octaves,
    pixel_angle: Numbers<f32>,
) -> PyResult<(Bound<'py, PyArray2<f32>>, Bound<'py, PyArray1<f32>>)> {
    let rays = Array::<f32>::new("rays", rays)?;
    let earth = Earth {
        nadir: nadir.0,
        altitude: altitude.0,
        sun: sun.0,
        ground: ground.0,
        detail: detail.0,
        pixel_angle: pixel_angle.0,
    };
    let uses = [rays.used(false)];
    let rays = rays.view();
    let Seen { radiance, behind } = enter(py, &uses, || shade(&earth, rays))?;
    Ok((PyArray2::from_owned_array(py, radiance), PyArray1::from_owned_array(py, behind)))
}
