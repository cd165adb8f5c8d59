//! ONNX Runtime's functions, failures on their way to a status, and the door that no panic passes.

use std::any::Any;
use std::ffi::{CStr, CString, c_int};
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use ffpose_core::Error;

use super::sys::{ApiTable, INVALID_ARGUMENT, RUNTIME_EXCEPTION, StatusPtr};

/// The functions of one ONNX Runtime, which live as long as it is loaded.
#[derive(Clone, Copy)]
pub(crate) struct Api(&'static ApiTable);

/// What went wrong: an `OrtStatus` in the making.
#[derive(Debug, PartialEq)]
pub(crate) struct Failure {
    code: c_int,
    message: String,
}

impl Failure {
    pub(crate) fn invalid(message: String) -> Self {
        Self { code: INVALID_ARGUMENT, message }
    }

    /// Adds to the message where it happened.
    pub(crate) fn at(self, place: impl Display) -> Self {
        Self { message: format!("{place}: {}", self.message), ..self }
    }

    fn of_panic(panic: Box<dyn Any + Send>) -> Self {
        let text = panic.downcast_ref::<&str>().copied();
        let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        let text = text.unwrap_or("no message");
        let message = format!("ffpose failed inside; please report this call: {text}");
        std::mem::forget(panic); // to drop it might panic again
        Self { code: RUNTIME_EXCEPTION, message }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let code = match error {
            Error::Memory { .. } => RUNTIME_EXCEPTION,
            _ => INVALID_ARGUMENT,
        };
        Self { code, message: error.to_string() }
    }
}

/// Runs `compute`, and makes a failure or a panic a status.
pub(super) fn guard(api: Api, compute: impl FnOnce() -> Result<(), Failure>) -> StatusPtr {
    let result = catch_unwind(AssertUnwindSafe(compute));
    match result.unwrap_or_else(|panic| Err(Failure::of_panic(panic))) {
        Ok(()) => ptr::null_mut(),
        Err(failure) => api.status(&failure),
    }
}

impl Api {
    /// # Safety
    /// `table` points to the functions of an ONNX Runtime, of [`VERSION`](super::sys::VERSION) or later; they live as long as
    /// this library.
    pub(super) unsafe fn new(table: *const ApiTable) -> Self {
        // SAFETY: as the caller promises.
        Self(unsafe { &*table })
    }

    pub(super) fn table(self) -> &'static ApiTable {
        self.0
    }

    fn status(self, failure: &Failure) -> StatusPtr {
        let text = CString::new(failure.message.replace('\0', "?")).unwrap_or_default();
        // SAFETY: the text is a C string; ONNX Runtime copies it.
        unsafe { (self.0.create_status)(failure.code, text.as_ptr()) }
    }

    /// A status as a result; it is released.
    ///
    /// # Safety
    /// `status` is null, or a status of this ONNX Runtime that nobody else releases.
    pub(super) unsafe fn check(self, status: StatusPtr) -> Result<(), Failure> {
        if status.is_null() {
            return Ok(());
        }
        // SAFETY: a status has a code and a C string, which is copied before the status is released, once.
        unsafe {
            let code = (self.0.get_error_code)(status);
            let message = CStr::from_ptr((self.0.get_error_message)(status));
            let message = message.to_string_lossy().into_owned();
            (self.0.release_status)(status);
            Err(Failure { code, message })
        }
    }
}
