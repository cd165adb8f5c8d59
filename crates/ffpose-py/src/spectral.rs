//! The spectral filter for NumPy arrays.

use std::cell::RefCell;

use ffpose_core::{Gradients, Isa, Scratch, Shape, SpectralFilter};
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn};
use pyo3::prelude::*;

use crate::border::{Threads, array, empty_like, enter, with_dtype};

/// A gradient or None.
type Gradient<'py> = Option<Bound<'py, PyAny>>;

/// Bytes of scratch that a thread keeps for its next call; page faults would cost more than the filter.
const SCRATCH_KEPT: usize = 32 << 20;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// irfft2(rfft2(x) * weight): an array like x.
#[pyfunction]
#[pyo3(
    signature = (x, weight, layout, num_threads = Threads(1)),
    text_signature = "(x, weight, layout, num_threads=1)"
)]
pub(crate) fn spectral_filter<'py>(
    py: Python<'py>,
    x: &Bound<'py, PyAny>,
    weight: &Bound<'py, PyAny>,
    layout: &str,
    num_threads: Threads,
) -> PyResult<Bound<'py, PyAny>> {
    with_dtype!(x, T => {
        let (like, x, weight) = (x, array::<T>("x", x)?, array::<T>("weight", weight)?);
        let y = empty_like::<T>(like)?;
        let mut out = y.try_readwrite()?;
        let (x, weight, out) = (x.as_array(), weight.as_array(), out.as_array_mut());
        enter(py, || {
            let shape = Shape::of_images(layout.parse()?, x.shape())?;
            let filter = SpectralFilter::planned(shape)?;
            with_scratch(|scratch| filter.forward(x, weight, out, num_threads.0, scratch))
        })?;
        Ok(y.into_any())
    })
}

/// The gradients of `spectral_filter` with respect to x and to weight, each None unless it is needed.
#[pyfunction]
#[pyo3(
    signature = (grad, x, weight, layout, need_x, need_weight, num_threads = Threads(1)),
    text_signature = "(grad, x, weight, layout, need_x, need_weight, num_threads=1)"
)]
#[allow(clippy::too_many_arguments)] // Python passes them one by one
pub(crate) fn spectral_filter_backward<'py>(
    py: Python<'py>,
    grad: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
    weight: &Bound<'py, PyAny>,
    layout: &str,
    need_x: bool,
    need_weight: bool,
    num_threads: Threads,
) -> PyResult<(Gradient<'py>, Gradient<'py>)> {
    with_dtype!(x, T => {
        let grad_x = need_x.then(|| empty_like::<T>(x)).transpose()?;
        let grad_weight = need_weight.then(|| empty_like::<T>(weight)).transpose()?;
        let (grad, x, weight) = (array::<T>("grad", grad)?, array("x", x)?, array("weight", weight)?);
        let (mut out_x, mut out_weight) = (writable(grad_x.as_ref())?, writable(grad_weight.as_ref())?);
        let (grad, x, weight) = (grad.as_array(), x.as_array(), weight.as_array());
        let gradients = Gradients {
            x: out_x.as_mut().map(|g| g.as_array_mut()),
            weight: out_weight.as_mut().map(|g| g.as_array_mut()),
        };
        enter(py, || {
            let shape = Shape::of_images(layout.parse()?, x.shape())?;
            let filter = SpectralFilter::planned(shape)?;
            with_scratch(|scratch| filter.backward(grad, x, weight, gradients, num_threads.0, scratch))
        })?;
        drop((out_x, out_weight));
        Ok((grad_x.map(Bound::into_any), grad_weight.map(Bound::into_any)))
    })
}

/// Runs `compute` with this thread's scratch.
fn with_scratch<R>(compute: impl FnOnce(&mut Scratch) -> R) -> R {
    SCRATCH.with_borrow_mut(|scratch| {
        let result = compute(scratch);
        scratch.keep_at_most(SCRATCH_KEPT);
        result
    })
}

/// A new array as one to write.
fn writable<'py, T: Element>(
    array: Option<&Bound<'py, PyArrayDyn<T>>>,
) -> PyResult<Option<PyReadwriteArrayDyn<'py, T>>> {
    Ok(array.map(PyArrayMethods::try_readwrite).transpose()?)
}

/// The instruction set that the filters use: "scalar", "avx2", "avx512" or "neon".
#[pyfunction]
pub(crate) fn isa(py: Python<'_>) -> PyResult<&'static str> {
    enter(py, || Ok(Isa::current()?.name()))
}
