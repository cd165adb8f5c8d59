//! Tensors of ONNX Runtime as arrays, in place.

use std::ffi::{c_int, c_void};
use std::fmt::{self, Display, Formatter};
use std::ptr::{self, NonNull};

use ffpose_core::{Bf16, F16, Number};
use ndarray::{ArrayViewD, ArrayViewMutD, Dimension, IxDyn};

use super::api::{Api, Failure};
use super::sys::{TensorInfo, Value};

/// The type of a tensor's elements: `ONNXTensorElementDataType`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ElementType(pub(super) c_int);

/// What an array may hold.
pub(crate) trait Element: Number {
    const TYPE: ElementType;
}

impl Element for f32 {
    const TYPE: ElementType = ElementType(1);
}

impl Element for f64 {
    const TYPE: ElementType = ElementType(11);
}

impl Element for F16 {
    const TYPE: ElementType = ElementType(10);
}

impl Element for Bf16 {
    const TYPE: ElementType = ElementType(16);
}

impl Display for ElementType {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match *self {
            f32::TYPE => f.write_str("float32"),
            f64::TYPE => f.write_str("float64"),
            F16::TYPE => f.write_str("float16"),
            Bf16::TYPE => f.write_str("bfloat16"),
            Self(other) => write!(f, "ONNX's type {other}"),
        }
    }
}

/// A tensor's place in memory and what lies there.
pub(super) struct Tensor {
    start: *mut c_void,
    element: ElementType,
    dim: IxDyn,
}

impl Tensor {
    /// # Safety
    /// `value` is a tensor of ONNX Runtime.
    pub(super) unsafe fn new(api: Api, value: *mut Value) -> Result<Self, Failure> {
        let (mut info, mut start) = (ptr::null_mut(), ptr::null_mut());
        // SAFETY: the value is a tensor, both places are written on success, and the description, which is ours then, is
        // released once.
        unsafe {
            api.check((api.table().tensor_info)(value, &raw mut info))?;
            let read = element_and_sizes(api, info);
            (api.table().release_tensor_info)(info);
            let (element, sizes) = read?;
            api.check((api.table().tensor_data)(value, &raw mut start))?;
            let sizes = sizes.iter().map(|&size| usize::try_from(size));
            let dim: Result<Vec<_>, _> = sizes.collect();
            let dim =
                dim.map_err(|_| Failure::invalid("expected sizes, got one below 0".into()))?;
            Ok(Self { start, element, dim: IxDyn(&dim) })
        }
    }

    pub(super) fn shape(&self) -> &[usize] {
        self.dim.slice()
    }

    /// The elements, to read.
    ///
    /// # Safety
    /// The tensor lives for `'a`, and nobody writes to it.
    pub(super) unsafe fn view<'a, T: Element>(&self) -> Result<ArrayViewD<'a, T>, Failure> {
        let start = self.elements::<T>()?;
        // SAFETY: contiguous elements of this type and shape lie there, aligned, for as long as the caller promises.
        Ok(unsafe { ArrayViewD::from_shape_ptr(self.dim.clone(), start.as_ptr()) })
    }

    /// The elements, to write.
    ///
    /// # Safety
    /// The tensor lives for `'a`, and nobody else reads or writes it.
    pub(super) unsafe fn view_mut<'a, T: Element>(&self) -> Result<ArrayViewMutD<'a, T>, Failure> {
        let start = self.elements::<T>()?;
        // SAFETY: as in `view`.
        Ok(unsafe { ArrayViewMutD::from_shape_ptr(self.dim.clone(), start.as_ptr()) })
    }

    /// Where the elements begin; a tensor without any may lie nowhere.
    fn elements<T: Element>(&self) -> Result<NonNull<T>, Failure> {
        if self.element != T::TYPE {
            let text = format!("expected a tensor of {}, got one of {}", T::TYPE, self.element);
            return Err(Failure::invalid(text));
        }
        match NonNull::new(self.start.cast::<T>()) {
            _ if self.dim.size() == 0 => Ok(NonNull::dangling()),
            Some(start) if start.is_aligned() => Ok(start),
            start => {
                let text = format!("expected an aligned tensor, got one at {start:?}");
                Err(Failure::invalid(text))
            }
        }
    }
}

/// What a description says of a tensor; a size that it does not know is below 0.
///
/// # Safety
/// `info` is a description of ONNX Runtime.
pub(super) unsafe fn element_and_sizes(
    api: Api,
    info: *const TensorInfo,
) -> Result<(ElementType, Vec<i64>), Failure> {
    let (mut element, mut axes) = (0, 0);
    // SAFETY: the description lives, and there is room for as many sizes as it has.
    unsafe {
        api.check((api.table().element_type)(info, &raw mut element))?;
        api.check((api.table().axes)(info, &raw mut axes))?;
        let mut sizes = vec![0; axes];
        api.check((api.table().sizes)(info, sizes.as_mut_ptr(), axes))?;
        Ok((ElementType(element), sizes))
    }
}
