//! NumPy arrays in place.
//!
//! The numpy crate's own views are for safe Rust: flags of the whole process tell which arrays they borrow, and a forked child
//! keeps those of its parent's other threads, for ever. Here `in_use` tells calls apart, and forgets calls before a fork.

use std::ops::Range;
use std::ptr::NonNull;
use std::sync::OnceLock;

use numpy::ndarray::{ArrayViewD, ArrayViewMutD, Dimension, IxDyn};
use numpy::npyffi::{_PyArray_GET_ITEM_DATA, NPY_ARRAY_WRITEABLE};
use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::border::{of_numpy, once};
use crate::in_use::Use;

/// Axes that `ndarray` views of NumPy arrays may have.
const MOST_AXES: usize = 32;

/// The element type of a call: that of its first array.
pub(crate) enum Dtype {
    F32,
    F64,
}

/// `$body` with `$T` standing for the element type of `$array`.
macro_rules! with_dtype {
    ($array:ident, $T:ident => $body:expr) => {
        match $crate::array::dtype(stringify!($array), $array)? {
            $crate::array::Dtype::F32 => {
                type $T = f32;
                $body
            }
            $crate::array::Dtype::F64 => {
                type $T = f64;
                $body
            }
        }
    };
}
pub(crate) use with_dtype;

/// The element type of an array.
pub(crate) fn dtype(name: &str, array: &Bound<'_, PyAny>) -> PyResult<Dtype> {
    let (py, dtype) = (array.py(), untyped(name, array)?.dtype());
    if dtype.is_equiv_to(&f32::get_dtype(py)) {
        Ok(Dtype::F32)
    } else if dtype.is_equiv_to(&f64::get_dtype(py)) {
        Ok(Dtype::F64)
    } else {
        Err(PyTypeError::new_err(format!("{name} must be float32 or float64, got {dtype}")))
    }
}

/// An array of elements `T`, C-contiguous and aligned, whose object lives for `'a`.
pub(crate) struct Array<'a, T> {
    name: &'a str,
    start: NonNull<T>,
    dim: IxDyn,
    object: &'a Bound<'a, PyUntypedArray>,
}

impl<'a, T: Element> Array<'a, T> {
    /// The array that an argument is.
    pub(crate) fn new(name: &'a str, argument: &'a Bound<'a, PyAny>) -> PyResult<Self> {
        let object = untyped(name, argument)?;
        let array = argument.cast::<PyArrayDyn<T>>().map_err(|_| {
            let expected = T::get_dtype(argument.py());
            PyTypeError::new_err(format!("{name} must be {expected}, got {}", object.dtype()))
        })?;
        if object.ndim() > MOST_AXES {
            let got = object.ndim();
            return Err(PyValueError::new_err(format!(
                "{name} must have at most {MOST_AXES} axes, got {got}"
            )));
        }
        let start = match NonNull::new(array.data()) {
            _ if object.len() == 0 => Some(NonNull::dangling()),
            start => start.filter(|start| start.is_aligned() && object.is_c_contiguous()),
        };
        let Some(start) = start else {
            let got = object.strides();
            return Err(PyValueError::new_err(format!(
                "{name} must be C-contiguous and aligned, got strides {got:?} at address {:#x}",
                array.data().addr()
            )));
        };
        Ok(Self { name, start, dim: IxDyn(object.shape()), object })
    }

    /// The elements, to read.
    pub(crate) fn view(&self) -> ArrayViewD<'a, T> {
        // SAFETY: so many elements of this type lie there, in this order, aligned; the array lives for `'a`, and no call of
        // this library writes to them meanwhile, as `in_use` sees to. Python's other threads can, while a call runs without
        // Python's lock, with NumPy's functions or with `resize(refcheck=False)`: a data race of theirs, against which NumPy,
        // as torch, has nothing but the word of its users.
        unsafe { ArrayViewD::from_shape_ptr(self.dim.clone(), self.start.as_ptr()) }
    }

    /// The elements, to write, of an array that shares no memory with `others`. NumPy's owners do not tell: two arrays may
    /// have been made of the same memory.
    pub(crate) fn view_mut(self, others: &[&Array<'_, T>]) -> PyResult<ArrayViewMutD<'a, T>> {
        let name = self.name;
        if let Some(Array { name: other, .. }) = others.iter().find(|other| self.meets(other)) {
            let text = format!("{name} must have memory of its own, got that of {other}");
            return Err(PyValueError::new_err(text));
        }
        if !self.is_writeable() {
            let text = format!("{name} must be writeable, got a read-only array");
            return Err(PyValueError::new_err(text));
        }
        // SAFETY: as in `view`; no other view of this call reaches there.
        Ok(unsafe { ArrayViewMutD::from_shape_ptr(self.dim, self.start.as_ptr()) })
    }

    /// Its memory, as a call uses it.
    pub(crate) fn used(&self, writes: bool) -> Use<'a> {
        Use { name: self.name, bytes: self.bytes(), writes, tensor: None }
    }

    fn is_writeable(&self) -> bool {
        // SAFETY: the object is an array of NumPy's, and Python's lock is held wherever there is a `Bound`.
        let flags = unsafe { (*_PyArray_GET_ITEM_DATA(self.object.as_array_ptr())).flags };
        flags & NPY_ARRAY_WRITEABLE != 0
    }

    fn meets(&self, other: &Self) -> bool {
        let (own, other) = (self.bytes(), other.bytes());
        own.start < other.end && other.start < own.end
    }

    fn bytes(&self) -> Range<usize> {
        let start = self.start.addr().get();
        start..start.saturating_add(self.dim.size() * size_of::<T>())
    }
}

/// A new array of the shape and element type of `like`, with any content.
pub(crate) fn empty_like<'py>(like: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    static EMPTY_LIKE: OnceLock<Py<PyAny>> = OnceLock::new();
    let py = like.py();
    let empty_like = once(&EMPTY_LIKE, || of_numpy(py, "empty_like"))?.bind(py);
    let (dtype, order, subclass) = (py.None(), "C", false);
    empty_like.call1((like, dtype, order, subclass))
}

/// Has the numpy crate look up what it keeps in `PyOnceLock`s, before this process can be forked meanwhile.
pub(crate) fn initialize(py: Python<'_>) -> PyResult<()> {
    py.import("numpy")?; // whose error, where it cannot be imported, would be a panic below
    drop(PyArray1::<f64>::from_vec(py, Vec::new()));
    Ok(())
}

fn untyped<'a, 'py>(
    name: &str,
    array: &'a Bound<'py, PyAny>,
) -> PyResult<&'a Bound<'py, PyUntypedArray>> {
    array.cast().map_err(|_| {
        let got = array.get_type();
        PyTypeError::new_err(format!("{name} must be a numpy.ndarray, got {got}"))
    })
}
