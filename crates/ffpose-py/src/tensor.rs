//! torch tensors in place: the one door for pointers that Python hands over.
//!
//! `DLPack`'s table of C functions, `torch.Tensor.__dlpack_c_exchange_api__`, describes a tensor in tens of nanoseconds.
//! Here the description is checked, and becomes views.

use std::ffi::{c_int, c_void};
use std::mem::MaybeUninit;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::OnceLock;

use ffpose_core::{Bf16, Number};
use numpy::ndarray::{ArrayViewD, ArrayViewMutD, Dimension, IxDyn};
use pyo3::exceptions::{PyImportError, PyRuntimeError, PyTypeError, PyValueError};
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyType};

use crate::border::once;
use crate::in_use::Use;

/// `DLTensor`: a tensor as its owner describes it.
#[repr(C)]
struct Description {
    data: *mut u8,
    device_type: i32,
    device_id: i32,
    axes: i32,
    dtype: Dtype,
    shape: *const i64,
    strides: *const i64,
    byte_offset: u64,
}

/// `DLDataType`.
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Dtype {
    code: u8,
    bits: u8,
    lanes: u16,
}

/// `DLPackExchangeAPIHeader`: what a table of any version begins with, and the table of an older version, if there is one.
#[repr(C)]
struct Header {
    major: u32,
    minor: u32,
    older: *const Header,
}

/// `DLPackExchangeAPI`, as far as it is used here.
#[repr(C)]
struct ExchangeApi {
    header: Header,
    managed: [*const c_void; 3],
    /// Null where the class has no such function.
    describe: Option<Describe>,
}

/// Fills the description of an object of the table's class; 0 is success, else a Python exception is set.
type Describe = unsafe extern "C" fn(*mut c_void, *mut Description) -> c_int;

const MAJOR: u32 = 1;
const CPU: i32 = 1;

impl Dtype {
    pub(crate) const F32: Self = Self { code: 2, bits: 32, lanes: 1 };
    pub(crate) const F64: Self = Self { code: 2, bits: 64, lanes: 1 };
    pub(crate) const BF16: Self = Self { code: 4, bits: 16, lanes: 1 };
}

/// What a view may hold.
pub(crate) trait TensorElement: Number {
    const DTYPE: Dtype;
}

impl TensorElement for f32 {
    const DTYPE: Dtype = Dtype::F32;
}

impl TensorElement for f64 {
    const DTYPE: Dtype = Dtype::F64;
}

impl TensorElement for Bf16 {
    const DTYPE: Dtype = Dtype::BF16;
}

/// A contiguous tensor on the CPU, whose object lives for `'a`.
pub(crate) struct Tensor<'a> {
    name: &'static str,
    start: *mut u8,
    dtype: Dtype,
    dim: IxDyn,
    object: &'a Bound<'a, PyAny>,
}

impl<'a> Tensor<'a> {
    /// The tensor that an argument is.
    pub(crate) fn new(name: &'static str, argument: &'a Bound<'a, PyAny>) -> PyResult<Self> {
        let description = describe(name, argument)?;
        let Description { data, device_type, axes, dtype, shape, strides, byte_offset, .. } =
            description;
        if device_type != CPU {
            let text = format!("{name} must be on the CPU, got device {device_type} of DLPack");
            return Err(PyValueError::new_err(text));
        }
        let axes = usize::try_from(axes)?;
        // SAFETY: the object lives, and keeps as many numbers in both places as it has axes.
        let (shape, strides) = unsafe { (numbers(shape, axes), numbers(strides, axes)) };
        if !is_addressable(shape, usize::from(dtype.bits / 8)) {
            let text = format!("{name} must have a shape that memory can address, got {shape:?}");
            return Err(PyValueError::new_err(text));
        }
        if !is_contiguous(shape, strides) {
            let text = format!("{name} must be contiguous, got strides {strides:?}");
            return Err(PyValueError::new_err(text));
        }
        let mut dim = IxDyn::zeros(axes);
        for (to, len) in dim.slice_mut().iter_mut().zip(shape) {
            *to = usize::try_from(*len).map_err(|_| PyValueError::new_err("a negative length"))?;
        }
        let start = data.wrapping_add(usize::try_from(byte_offset)?);
        Ok(Self { name, start, dtype, dim, object: argument })
    }

    pub(crate) fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Number of elements.
    pub(crate) fn len(&self) -> usize {
        self.dim.size()
    }

    /// The elements, to read.
    pub(crate) fn view<T: TensorElement>(&self) -> PyResult<ArrayViewD<'a, T>> {
        let start = self.elements::<T>()?;
        // SAFETY: a contiguous tensor of this dtype and shape lies there, aligned; its object lives for `'a`.
        Ok(unsafe { ArrayViewD::from_shape_ptr(self.dim.clone(), start.as_ptr()) })
    }

    /// That the tensor shares no memory with `others`.
    pub(crate) fn check_apart(&self, others: &[&Tensor<'_>]) -> PyResult<()> {
        let Some(other) = others.iter().find(|other| self.meets(other)) else {
            return Ok(());
        };
        let (name, other) = (self.name, other.name);
        let text = format!("{name} must have memory of its own, got that of {other}");
        Err(PyValueError::new_err(text))
    }

    /// The elements, to write, of a tensor that shares no memory with `others`.
    pub(crate) fn view_mut<T: TensorElement>(
        self,
        others: &[&Tensor<'_>],
    ) -> PyResult<ArrayViewMutD<'a, T>> {
        self.check_apart(others)?;
        let start = self.elements::<T>()?;
        // SAFETY: as in `view`; no other view of this call reaches there.
        Ok(unsafe { ArrayViewMutD::from_shape_ptr(self.dim, start.as_ptr()) })
    }

    /// Where the elements begin.
    fn elements<T: TensorElement>(&self) -> PyResult<NonNull<T>> {
        if self.dtype != T::DTYPE {
            let (name, got) = (self.name, self.dtype);
            let text = format!("{name} must be {}, got {got}", T::DTYPE);
            return Err(PyTypeError::new_err(text));
        }
        let start = self.start.cast::<T>();
        match NonNull::new(start) {
            _ if self.len() == 0 => Ok(NonNull::dangling()),
            Some(start) if start.is_aligned() => Ok(start),
            _ => {
                let text = format!("{} must be aligned, got address {start:p}", self.name);
                Err(PyValueError::new_err(text))
            }
        }
    }

    /// Whether both are one array: the same elements at the same place.
    pub(crate) fn is(&self, other: &Tensor<'_>) -> bool {
        self.start == other.start && self.dim == other.dim && self.dtype == other.dtype
    }

    /// Its memory, as a call uses it.
    pub(crate) fn used(&self, writes: bool) -> Use<'a> {
        Use { name: self.name, bytes: self.bytes(), writes, tensor: Some(self.object) }
    }

    fn meets(&self, other: &Tensor<'_>) -> bool {
        let (own, other) = (self.bytes(), other.bytes());
        own.start < other.end && other.start < own.end
    }

    fn bytes(&self) -> Range<usize> {
        let start = self.start.addr();
        start..start.saturating_add(self.len() * usize::from(self.dtype.bits / 8))
    }
}

/// That a tensor still has the memory that a call has used: torch lets any thread resize or replace it.
pub(crate) fn check_place(used: &Use<'_>) -> PyResult<()> {
    let Some(tensor) = used.tensor else { return Ok(()) };
    let Description { data, byte_offset, .. } = describe(used.name, tensor)?;
    let now = data.wrapping_add(usize::try_from(byte_offset)?);
    if now.addr() == used.bytes.start {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(format!(
        "{} must keep its memory during a call, got other memory from another thread: nothing is known of the result",
        used.name
    )))
}

impl std::fmt::Display for Dtype {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kinds = ["int", "uint", "float", "handle", "bfloat", "complex", "bool"];
        let kind = kinds.get(usize::from(self.code)).unwrap_or(&"other");
        write!(f, "{kind}{}", self.bits)
    }
}

/// What torch says of an argument.
fn describe(name: &str, argument: &Bound<'_, PyAny>) -> PyResult<Description> {
    let py = argument.py();
    let (class, describe) = torch(py)?;
    // SAFETY: both objects live, and the second is a type.
    if unsafe { ffi::PyObject_TypeCheck(argument.as_ptr(), class.as_ptr().cast()) } == 0 {
        let text = format!("{name} must be a torch.Tensor, got {}", argument.get_type());
        return Err(PyTypeError::new_err(text));
    }
    let mut description = MaybeUninit::uninit();
    // SAFETY: the function is that of the argument's class; Python's lock is held.
    if unsafe { describe(argument.as_ptr().cast(), description.as_mut_ptr()) } == 0 {
        // SAFETY: success means that the description is written.
        Ok(unsafe { description.assume_init() })
    } else {
        Err(PyErr::fetch(py))
    }
}

/// The class of tensors, and what describes them.
fn torch(py: Python<'_>) -> PyResult<&(Py<PyType>, Describe)> {
    static TORCH: OnceLock<(Py<PyType>, Describe)> = OnceLock::new();
    once(&TORCH, || {
        let class = py.import("torch")?.getattr("Tensor")?.cast_into::<PyType>()?;
        let capsule = class.getattr("__dlpack_c_exchange_api__")?.cast_into::<PyCapsule>()?;
        let newest = capsule.pointer_checked(Some(c"dlpack_exchange_api"))?.cast::<Header>();
        // SAFETY: a capsule of this name points to tables, of which each leads to an older one and none is ever freed.
        let describe = unsafe { describe_of(newest.as_ptr()) };
        Ok((class.unbind(), describe.map_err(PyImportError::new_err)?))
    })
}

/// The function of the table of version [`MAJOR`], which is `newest` or older; else what is wrong.
///
/// # Safety
/// `newest` points to a table, which leads to older ones or to null.
unsafe fn describe_of(newest: *const Header) -> Result<Describe, String> {
    let mut table = newest;
    // SAFETY: a table begins with its header, as the caller promises for all that are reached.
    while unsafe { (*table).major } != MAJOR {
        // SAFETY: as above.
        let older = unsafe { (*table).older };
        if older.is_null() {
            // SAFETY: as above.
            let Header { major, minor, .. } = unsafe { newest.read() };
            return Err(format!(
                "expected DLPack {MAJOR} from torch, got {major}.{minor} and nothing older"
            ));
        }
        table = older;
    }
    // SAFETY: a table of this version is an `ExchangeApi`.
    let describe = unsafe { (*table.cast::<ExchangeApi>()).describe };
    describe.ok_or_else(|| {
        "expected a function from torch that describes tensors to DLPack, got a null pointer".into()
    })
}

/// As a slice what may be null where there is nothing.
///
/// # Safety
/// `len` numbers are at `start` for `'a`.
unsafe fn numbers<'a>(start: *const i64, len: usize) -> &'a [i64] {
    if len == 0 {
        return &[];
    }
    // SAFETY: as the caller promises.
    unsafe { std::slice::from_raw_parts(start, len) }
}

/// Whether an array of this shape, of elements of `bytes` each, could be in memory; axes of length zero do not count, as
/// `ndarray` multiplies the others.
fn is_addressable(shape: &[i64], bytes: usize) -> bool {
    let mut axes = shape.iter().filter(|len| **len != 0).map(|len| usize::try_from(*len).ok());
    let len = axes.try_fold(bytes.max(1), |len, axis| len.checked_mul(axis?));
    len.is_some_and(|len| isize::try_from(len).is_ok())
}

/// Whether elements follow each other in C order; an axis of length one may have any stride.
fn is_contiguous(shape: &[i64], strides: &[i64]) -> bool {
    let mut expected = 1;
    shape.contains(&0)
        || shape.iter().zip(strides).rev().all(|(&len, &stride)| {
            let fits = len == 1 || stride == expected;
            expected *= len;
            fits
        })
}
