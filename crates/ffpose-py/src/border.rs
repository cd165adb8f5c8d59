//! The one door between Python and ffpose-core.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;

use ffpose_core::Error;
use ffpose_scene::textures::{MOST_SIDE, Wrap};
use pyo3::exceptions::{PyMemoryError, PyOverflowError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::in_use::{self, Use};
use crate::tensor::check_place;

/// Elements from which on other Python threads may run meanwhile: about 20 microseconds of work.
const WORTH_THE_GIL: usize = 1 << 14;

/// Computes without the GIL; an error of the core becomes a `ValueError`. So is memory of `uses` that a call of another thread
/// writes to meanwhile, or reads where this one writes.
///
/// The core does not panic on checked arguments. If it did, users would meet `PanicException`, which `except Exception`
/// does not catch; this door would turn it into a `RuntimeError`.
pub(crate) fn enter<R: Send>(
    py: Python<'_>,
    uses: &[Use<'_>],
    compute: impl FnOnce() -> Result<R, Error> + Send,
) -> PyResult<R> {
    enter_sized(py, uses, usize::MAX, compute)
}

/// As [`enter`], but keeps the GIL while it computes on few `elements`: that takes less than giving it away, to a
/// thread that may then hold it for milliseconds. Tensors whose memory has changed meanwhile are a `RuntimeError`.
pub(crate) fn enter_sized<R: Send>(
    py: Python<'_>,
    uses: &[Use<'_>],
    elements: usize,
    compute: impl FnOnce() -> Result<R, Error> + Send,
) -> PyResult<R> {
    let guarded = || catch_unwind(AssertUnwindSafe(compute));
    let result = if elements < WORTH_THE_GIL {
        in_use::check(uses)?;
        guarded()
    } else {
        let held = in_use::hold(uses)?;
        let result = py.detach(guarded);
        drop(held);
        uses.iter().try_for_each(check_place)?;
        result
    };
    match result {
        Ok(result) => result.map_err(raised),
        Err(_) => Err(PyRuntimeError::new_err("ffpose failed inside; please report this call")),
    }
}

fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Memory { .. } => PyMemoryError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}

/// What `cell` keeps, made at first.
///
/// Nobody waits for a thread that makes it, which may give Python's lock away meanwhile: a forked child does not have that thread,
/// and would wait for ever, as it does for pyo3's `PyOnceLock`. Two threads may make it; one value stays.
pub(crate) fn once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> PyResult<T>) -> PyResult<&T> {
    if let Some(value) = cell.get() {
        return Ok(value);
    }
    let value = make()?;
    Ok(cell.get_or_init(|| value))
}

/// A function of NumPy's.
pub(crate) fn of_numpy(py: Python<'_>, name: &str) -> PyResult<Py<PyAny>> {
    Ok(py.import("numpy")?.getattr(name)?.unbind())
}

/// Real numbers, one or in sequences. NumPy's complex numbers are refused: Python would drop their imaginary part.
pub(crate) struct Numbers<T>(pub(crate) T);

impl<'a, 'py, T: FromPyObject<'a, 'py>> FromPyObject<'a, 'py> for Numbers<T> {
    type Error = PyErr;

    fn extract(argument: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        static IS_COMPLEX: OnceLock<Py<PyAny>> = OnceLock::new();
        let py = argument.py();
        let is_complex = once(&IS_COMPLEX, || of_numpy(py, "iscomplexobj"))?.bind(py);
        // what NumPy makes no array of gets its error below
        if is_complex.call1((argument,)).and_then(|answer| answer.is_truthy()).unwrap_or(false) {
            let got = argument.as_any();
            return Err(PyTypeError::new_err(format!("expected real numbers, got {got}")));
        }
        argument.extract().map(Self).map_err(Into::into)
    }
}

/// The number of threads that a caller allows.
pub(crate) struct Threads(pub(crate) usize);

impl<'py> FromPyObject<'_, 'py> for Threads {
    type Error = PyErr;

    fn extract(argument: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        integer(argument, "num_threads must be at least 1", |number| {
            usize::try_from(number).ok().filter(|threads| *threads > 0).map(Self)
        })
    }
}

/// How many octaves of detail a caller asks for.
pub(crate) struct Octaves(pub(crate) u8);

impl<'py> FromPyObject<'_, 'py> for Octaves {
    type Error = PyErr;

    fn extract(argument: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        integer(argument, "detail must be in 0…16", |number| {
            u8::try_from(number).ok().filter(|octaves| *octaves <= 16).map(Self)
        })
    }
}

/// A side of a texture.
pub(crate) struct Side(pub(crate) u32);

impl<'py> FromPyObject<'_, 'py> for Side {
    type Error = PyErr;

    fn extract(argument: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        integer(argument, "sides must be powers of two up to 16384", |number| {
            let side = u32::try_from(number).ok();
            side.filter(|side| side.is_power_of_two() && *side <= MOST_SIDE).map(Self)
        })
    }
}

/// What lies beyond a texture's border, by its number.
pub(crate) struct Wrapping(pub(crate) Wrap);

impl<'py> FromPyObject<'_, 'py> for Wrapping {
    type Error = PyErr;

    fn extract(argument: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        integer(argument, "wrap must be 0 (repeat), 1 (mirror) or 2 (clamp)", |number| {
            let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
            usize::try_from(number).ok().and_then(|number| wraps.get(number).copied()).map(Self)
        })
    }
}

/// An integer that `accept` takes; any other is a `ValueError` that begins with `expected`.
fn integer<T>(
    argument: Borrowed<'_, '_, PyAny>,
    expected: &str,
    accept: impl FnOnce(isize) -> Option<T>,
) -> PyResult<T> {
    let number = match argument.extract::<isize>() {
        Err(error) if !error.is_instance_of::<PyOverflowError>(argument.py()) => return Err(error),
        number => number.ok(),
    };
    number.and_then(accept).ok_or_else(|| {
        let got = argument.as_any();
        PyValueError::new_err(format!("{expected}, got {got}"))
    })
}
