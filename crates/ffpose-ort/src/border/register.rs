//! The library's one symbol.

use std::ffi::{CStr, c_char};
use std::ptr::{self, NonNull};
use std::sync::{Mutex, PoisonError};

use super::api::{Api, Failure, guard};
use super::operator::Operator;
use super::pool::processors;
use super::sys::{ApiBase, ApiTable, Domain, INVALID_ARGUMENT, SessionOptions, StatusPtr, VERSION};

const DOMAIN: &CStr = c"ffpose";

/// The domain that was made for an ONNX Runtime, told by the address of its functions: a process may have several.
struct Made {
    functions: usize,
    domain: NonNull<Domain>,
}

// SAFETY: a domain is not written to after it is made, and its ONNX Runtime reads it on any thread.
unsafe impl Send for Made {}

static MADE: Mutex<Vec<Made>> = Mutex::new(Vec::new());

/// Adds the operators to a session's options; ONNX Runtime calls it for `register_custom_ops_library`.
///
/// # Safety
/// `options` and `base` are ONNX Runtime's.
#[unsafe(no_mangle)]
#[allow(non_snake_case)] // ONNX Runtime looks for this name
pub unsafe extern "system" fn RegisterCustomOps(
    options: *mut SessionOptions,
    base: *const ApiBase,
) -> StatusPtr {
    // SAFETY: the base lives, and its function gives the table of a version, or null.
    let table = unsafe { ((*base).get_api)(VERSION) };
    if table.is_null() {
        // SAFETY: as the caller promises.
        return unsafe { too_old(base) };
    }
    // SAFETY: the table is of that version; ONNX Runtime stays loaded for as long as it holds this library.
    let api = unsafe { Api::new(table) };
    guard(api, || {
        initialize();
        let domain = domain(api)?;
        // SAFETY: the options live, and the domain is never freed.
        unsafe { api.check((api.table().add_domain)(options, domain.as_ptr())) }
    })
}

/// Asks the machine what will be needed of it, before there is a session: a fork beside a thread that asks would leave the child
/// waiting for it for ever.
fn initialize() {
    ffpose_core::initialize();
    processors();
}

/// The status for an ONNX Runtime that lacks [`VERSION`]; the first function of every version makes it.
///
/// # Safety
/// `base` is ONNX Runtime's.
unsafe fn too_old(base: *const ApiBase) -> StatusPtr {
    // SAFETY: the base lives, its version is a C string, and each older version's table begins with this function.
    unsafe {
        let older = |version| NonNull::new(((*base).get_api)(version).cast_mut());
        let Some(table) = (1..VERSION).rev().find_map(older) else { return ptr::null_mut() };
        let found = CStr::from_ptr(((*base).get_version)()).to_bytes();
        let expected = format!("ffpose: expected ONNX Runtime 1.{VERSION} or newer, got ");
        let message = [expected.as_bytes(), found, b"\0"].concat();
        let create_status = ptr::addr_of!((*table.as_ptr()).create_status).read();
        create_status(INVALID_ARGUMENT, message.as_ptr().cast::<c_char>())
    }
}

/// The domain with the operators, made at the first use of an ONNX Runtime.
fn domain(api: Api) -> Result<NonNull<Domain>, Failure> {
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    let functions = ptr::from_ref::<ApiTable>(api.table()).addr();
    if let Some(made) = made.iter().find(|made| made.functions == functions) {
        return Ok(made.domain);
    }
    let mut domain = ptr::null_mut();
    // SAFETY: the name is a C string, and there is room for a pointer.
    unsafe { api.check((api.table().create_domain)(DOMAIN.as_ptr(), &raw mut domain))? };
    let operators: &'static [Operator] = Box::leak(Box::new(crate::operators(api)));
    for operator in operators {
        // SAFETY: the domain lives, and so does the operator, for ever.
        unsafe { api.check((api.table().domain_add)(domain, operator.table()))? };
    }
    let domain = NonNull::new(domain);
    let domain = domain.ok_or_else(|| Failure::invalid("expected a domain, got none".into()))?;
    made.push(Made { functions, domain });
    Ok(domain)
}
