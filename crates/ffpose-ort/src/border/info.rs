//! What the graph says of a node, before anything is run.

use std::ffi::{CStr, c_char};
use std::fmt::{self, Display, Formatter};
use std::marker::PhantomData;
use std::ptr;

use super::api::{Api, Failure};
use super::sys::{KernelInfo, ShapeContext, StatusPtr};
use super::tensor::{Tensor, element_and_sizes};

/// A node whose kernel is being made.
pub(crate) struct Info<'a> {
    api: Api,
    raw: *const KernelInfo,
    creation: PhantomData<&'a KernelInfo>,
}

/// The shape of an input, as far as the graph knows it.
#[derive(Debug, PartialEq)]
pub(crate) struct Sizes(pub(crate) Vec<Option<usize>>);

impl Display for Sizes {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let size = |size: &Option<usize>| size.map_or_else(|| "?".into(), |n| n.to_string());
        write!(f, "({})", self.0.iter().map(size).collect::<Vec<_>>().join(", "))
    }
}

impl Info<'_> {
    /// # Safety
    /// `raw` describes a node for as long as this lives.
    pub(super) unsafe fn new(api: Api, raw: *const KernelInfo) -> Self {
        Self { api, raw, creation: PhantomData }
    }

    pub(crate) fn node_name(&self) -> Result<String, Failure> {
        let get = self.api.table().node_name;
        // SAFETY: the node's description lives; `text` gives room as this function wants it.
        self.text(|text, size| unsafe { get(self.raw, text, size) })
    }

    /// An attribute that is a string.
    pub(crate) fn string(&self, name: &CStr) -> Result<String, Failure> {
        let get = self.api.table().string_attribute;
        // SAFETY: as above, and the name is a C string.
        self.text(|text, size| unsafe { get(self.raw, name.as_ptr(), text, size) })
    }

    /// Whether an input is the same in every run.
    pub(crate) fn is_constant(&self, index: usize) -> Result<bool, Failure> {
        Ok(self.constant(index)?.is_some())
    }

    /// The shape of an input; None where not even the number of its axes is known.
    pub(crate) fn sizes(&self, index: usize) -> Result<Option<Sizes>, Failure> {
        match self.constant(index)? {
            Some(tensor) => Ok(Some(Sizes(tensor.shape().iter().copied().map(Some).collect()))),
            None => self.stated_sizes(index),
        }
    }

    /// An input that is constant: an initializer that no caller replaces.
    fn constant(&self, index: usize) -> Result<Option<Tensor>, Failure> {
        let (get, mut is_constant, mut value) = (self.api.table().constant_input, 0, ptr::null());
        // SAFETY: the node's description lives, there is room for a number and a pointer, and a constant is a tensor.
        unsafe {
            self.api.check(get(self.raw, index, &raw mut is_constant, &raw mut value))?;
            (is_constant != 0).then(|| Tensor::new(self.api, value.cast_mut())).transpose()
        }
    }

    /// As [`sizes`](Self::sizes), of an input that is not constant. No axes at all are told like an unknown number of them.
    fn stated_sizes(&self, index: usize) -> Result<Option<Sizes>, Failure> {
        let (table, mut kind, mut tensor) = (self.api.table(), ptr::null_mut(), ptr::null());
        // SAFETY: the node's description lives; that of the input is ours, is read while it lives, and is released once.
        let (_, sizes) = unsafe {
            self.api.check((table.input_type)(self.raw, index, &raw mut kind))?;
            let read = self.api.check((table.type_as_tensor)(kind, &raw mut tensor));
            let read = read.and_then(|()| element_and_sizes(self.api, tensor));
            (table.release_type_info)(kind);
            read?
        };
        let sizes: Vec<_> = sizes.iter().map(|&size| usize::try_from(size).ok()).collect();
        Ok((!sizes.is_empty()).then_some(Sizes(sizes)))
    }

    /// A text that `get` tells the length of, the closing zero included, if it gets null for room.
    fn text(&self, get: impl Fn(*mut c_char, *mut usize) -> StatusPtr) -> Result<String, Failure> {
        let mut size = 0;
        // SAFETY: the statuses are new and nobody else's.
        unsafe { self.api.check(get(ptr::null_mut(), &raw mut size))? };
        let mut text = vec![0_u8; size];
        // SAFETY: as above.
        unsafe { self.api.check(get(text.as_mut_ptr().cast(), &raw mut size))? };
        text.truncate(size.saturating_sub(1));
        Ok(String::from_utf8_lossy(&text).into_owned())
    }
}

/// Gives the output type and shape of the first input, names of sizes included.
///
/// Nothing is said where a number of axes, or a size and its name, is unknown: ONNX Runtime would take it for none or -1.
/// Nothing is checked either, as it ignores the status; that is for the kernel's making.
///
/// # Safety
/// `context` is that of an inference of shapes.
pub(super) unsafe fn infer_like_input(
    api: Api,
    context: *const ShapeContext,
) -> Result<(), Failure> {
    let (table, mut info) = (api.table(), ptr::null_mut());
    // SAFETY: the context lives, and so does the description, which is its; there is room for as many names as sizes, and
    // these are C strings or null.
    unsafe {
        api.check((table.inferred_input)(context, 0, &raw mut info))?;
        let (_, sizes) = element_and_sizes(api, info)?;
        let mut names = vec![ptr::null(); sizes.len()];
        api.check((table.size_names)(info, names.as_mut_ptr(), names.len()))?;
        let is_named = |name: *const c_char| !name.is_null() && *name != 0;
        let is_known = |(size, name): (&i64, &*const c_char)| *size >= 0 || is_named(*name);
        if sizes.is_empty() || !sizes.iter().zip(&names).all(is_known) {
            return Ok(());
        }
        api.check((table.infer_output)(context, 0, info))
    }
}
