//! What a kernel works with in one run.

use std::marker::PhantomData;
use std::ptr;

use ndarray::{ArrayViewD, ArrayViewMutD};

use super::api::{Api, Failure};
use super::pool::{SessionPool, SessionThreads};
use super::sys::KernelContext;
use super::tensor::{Element, Tensor};

/// Inputs and outputs of a run, and the session's threads.
pub(crate) struct Context<'a> {
    api: Api,
    raw: *mut KernelContext,
    threads: &'a SessionThreads,
    run: PhantomData<&'a mut KernelContext>,
}

impl<'a> Context<'a> {
    /// # Safety
    /// `raw` is the context of a run that lasts for `'a`.
    pub(super) unsafe fn new(
        api: Api,
        raw: *mut KernelContext,
        threads: &'a SessionThreads,
    ) -> Self {
        Self { api, raw, threads, run: PhantomData }
    }

    /// An input, in place.
    pub(crate) fn input<T: Element>(&self, index: usize) -> Result<ArrayViewD<'a, T>, Failure> {
        let mut value = ptr::null();
        // SAFETY: the context lives; an input that is there is a tensor, which nobody writes to before the run is over.
        unsafe {
            self.api.check((self.api.table().input)(self.raw, index, &raw mut value))?;
            if value.is_null() {
                return Err(Failure::invalid(format!("expected input {index}, got none")));
            }
            Tensor::new(self.api, value.cast_mut())?.view()
        }
    }

    /// The output, in place: of this shape, with any content.
    ///
    /// It takes the context so that there is one view of the output alone; what else is needed is asked for before.
    pub(crate) fn into_output<T: Element>(
        self,
        shape: &[usize],
    ) -> Result<(ArrayViewMutD<'a, T>, SessionPool<'a>), Failure> {
        let sizes: Result<Vec<_>, _> = shape.iter().map(|&size| i64::try_from(size)).collect();
        let sizes =
            sizes.map_err(|_| Failure::invalid(format!("no tensor has shape {shape:?}")))?;
        let mut value = ptr::null_mut();
        // SAFETY: the context lives; the output is a new tensor that is ours to write until the run is over, and the
        // context is given up, so that this is its only view.
        unsafe {
            let output = self.api.table().output;
            let status = output(self.raw, 0, sizes.as_ptr(), sizes.len(), &raw mut value);
            self.api.check(status)?;
            let y = Tensor::new(self.api, value)?.view_mut()?;
            Ok((y, SessionPool::new(self.api, self.raw, self.threads)))
        }
    }
}
