//! ONNX Runtime's C interface, `onnxruntime_c_api.h`, as far as it is used here.
//!
//! Enumerations are integers: a later ONNX Runtime may have values that no enumeration of today has.

use std::ffi::{c_char, c_int, c_void};
use std::mem::offset_of;

/// The version of the interface that is asked for: that of ONNX Runtime 1.17, and part of every later one.
pub(super) const VERSION: u32 = 17;

/// What a function gives: null is success.
pub(super) type StatusPtr = *mut Status;

pub(super) const INVALID_ARGUMENT: c_int = 2;
pub(super) const RUNTIME_EXCEPTION: c_int = 6;

/// Types that only ONNX Runtime looks into.
macro_rules! opaque {
    ($($name:ident)*) => {
        $(
            #[repr(C)]
            pub struct $name {
                _unknown: [u8; 0],
            }
        )*
    };
}

opaque! {
    Domain KernelContext KernelInfo SessionOptions ShapeContext Status TensorInfo TypeInfo Value
}

/// `OrtApiBase`.
#[repr(C)]
pub struct ApiBase {
    pub(super) get_api: unsafe extern "system" fn(u32) -> *const ApiTable,
    pub(super) get_version: unsafe extern "system" fn() -> *const c_char,
}

/// A function that is not called here.
type Unused = *const c_void;

type CreateStatus = unsafe extern "system" fn(c_int, *const c_char) -> StatusPtr;

/// `OrtApi`. Published functions never change their place.
#[repr(C)]
pub struct ApiTable {
    pub(super) create_status: CreateStatus,
    pub(super) get_error_code: unsafe extern "system" fn(*const Status) -> c_int,
    pub(super) get_error_message: unsafe extern "system" fn(*const Status) -> *const c_char,
    from_3: [Unused; 23],
    pub(super) create_domain:
        unsafe extern "system" fn(*const c_char, *mut *mut Domain) -> StatusPtr,
    pub(super) domain_add: unsafe extern "system" fn(*mut Domain, *const CustomOp) -> StatusPtr,
    pub(super) add_domain: unsafe extern "system" fn(*mut SessionOptions, *mut Domain) -> StatusPtr,
    from_29: [Unused; 22],
    pub(super) tensor_data: unsafe extern "system" fn(*mut Value, *mut *mut c_void) -> StatusPtr,
    from_52: [Unused; 3],
    pub(super) type_as_tensor:
        unsafe extern "system" fn(*const TypeInfo, *mut *const TensorInfo) -> StatusPtr,
    from_56: [Unused; 4],
    pub(super) element_type: unsafe extern "system" fn(*const TensorInfo, *mut c_int) -> StatusPtr,
    pub(super) axes: unsafe extern "system" fn(*const TensorInfo, *mut usize) -> StatusPtr,
    pub(super) sizes: unsafe extern "system" fn(*const TensorInfo, *mut i64, usize) -> StatusPtr,
    pub(super) size_names:
        unsafe extern "system" fn(*const TensorInfo, *mut *const c_char, usize) -> StatusPtr,
    from_64: [Unused; 1],
    pub(super) tensor_info:
        unsafe extern "system" fn(*const Value, *mut *mut TensorInfo) -> StatusPtr,
    from_66: [Unused; 21],
    pub(super) string_attribute: unsafe extern "system" fn(
        *const KernelInfo,
        *const c_char,
        *mut c_char,
        *mut usize,
    ) -> StatusPtr,
    from_88: [Unused; 2],
    pub(super) input:
        unsafe extern "system" fn(*const KernelContext, usize, *mut *const Value) -> StatusPtr,
    pub(super) output: unsafe extern "system" fn(
        *mut KernelContext,
        usize,
        *const i64,
        usize,
        *mut *mut Value,
    ) -> StatusPtr,
    from_92: [Unused; 1],
    pub(super) release_status: unsafe extern "system" fn(StatusPtr),
    from_94: [Unused; 4],
    pub(super) release_type_info: unsafe extern "system" fn(*mut TypeInfo),
    pub(super) release_tensor_info: unsafe extern "system" fn(*mut TensorInfo),
    from_100: [Unused; 134],
    pub(super) input_type:
        unsafe extern "system" fn(*const KernelInfo, usize, *mut *mut TypeInfo) -> StatusPtr,
    from_235: [Unused; 9],
    pub(super) node_name:
        unsafe extern "system" fn(*const KernelInfo, *mut c_char, *mut usize) -> StatusPtr,
    from_245: [Unused; 4],
    pub(super) constant_input: unsafe extern "system" fn(
        *const KernelInfo,
        usize,
        *mut c_int,
        *mut *const Value,
    ) -> StatusPtr,
    from_250: [Unused; 18],
    pub(super) inferred_input:
        unsafe extern "system" fn(*const ShapeContext, usize, *mut *mut TensorInfo) -> StatusPtr,
    from_269: [Unused; 1],
    pub(super) infer_output:
        unsafe extern "system" fn(*const ShapeContext, usize, *const TensorInfo) -> StatusPtr,
    from_271: [Unused; 3],
    pub(super) parallel_for: unsafe extern "system" fn(
        *const KernelContext,
        Body,
        usize,
        usize,
        *mut c_void,
    ) -> StatusPtr,
}

/// What `parallel_for` calls with each index.
pub(super) type Body = unsafe extern "C" fn(*mut c_void, usize);

/// Asserts the places of functions, counted in the header.
macro_rules! places {
    ($($place:literal $name:ident)*) => {
        $(const _: () = assert!(offset_of!(ApiTable, $name) == $place * size_of::<Unused>());)*
    };
}

places! {
    0 create_status 2 get_error_message 26 create_domain 27 domain_add 28 add_domain 51 tensor_data
    55 type_as_tensor 60 element_type 61 axes 62 sizes 63 size_names 65 tensor_info
    87 string_attribute 90 input 91 output 93 release_status 98 release_type_info
    99 release_tensor_info 234 input_type 244 node_name 249 constant_input 268 inferred_input
    270 infer_output 274 parallel_for
}

/// A question about an operator, or about one of its inputs or outputs.
pub(super) type Ask<T> = unsafe extern "system" fn(*const CustomOp) -> T;
pub(super) type AskAt = unsafe extern "system" fn(*const CustomOp, usize) -> c_int;

/// `OrtCustomOp` of [`VERSION`].
#[repr(C)]
pub struct CustomOp {
    pub(super) version: u32,
    /// Replaced by `create`, which can fail.
    pub(super) create_v1: Unused,
    pub(super) name: Ask<*const c_char>,
    pub(super) provider: Ask<*const c_char>,
    pub(super) input_type: AskAt,
    pub(super) inputs: Ask<usize>,
    pub(super) output_type: AskAt,
    pub(super) outputs: Ask<usize>,
    /// Replaced by `compute`, which can fail.
    pub(super) compute_v1: Unused,
    pub(super) destroy: unsafe extern "system" fn(*mut c_void),
    pub(super) input_characteristic: AskAt,
    pub(super) output_characteristic: AskAt,
    pub(super) input_memory: AskAt,
    pub(super) variadic_input_arity: Ask<c_int>,
    pub(super) variadic_input_homogeneity: Ask<c_int>,
    pub(super) variadic_output_arity: Ask<c_int>,
    pub(super) variadic_output_homogeneity: Ask<c_int>,
    pub(super) create: unsafe extern "system" fn(
        *const CustomOp,
        *const ApiTable,
        *const KernelInfo,
        *mut *mut c_void,
    ) -> StatusPtr,
    pub(super) compute: unsafe extern "system" fn(*mut c_void, *mut KernelContext) -> StatusPtr,
    pub(super) infer: unsafe extern "system" fn(*const CustomOp, *mut ShapeContext) -> StatusPtr,
    pub(super) start_version: Ask<c_int>,
    pub(super) end_version: Ask<c_int>,
}
