//! An operator as ONNX Runtime sees it: a table of functions.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use super::api::{Api, Failure, guard};
use super::context::Context;
use super::info::{Info, infer_like_input};
use super::pool::SessionThreads;
use super::sys::{ApiTable, CustomOp, KernelContext, KernelInfo, ShapeContext, StatusPtr, VERSION};
use super::tensor::ElementType;

/// What computes a node: one output, of the type of the first input.
pub(crate) trait Kernel: Send + Sync + Sized {
    const NAME: &'static CStr;
    const INPUTS: &'static [ElementType];
    /// Whether the output has the shape of the first input; nothing is inferred of another.
    const LIKE_FIRST: bool;

    /// Makes the kernel of a node, once a session.
    fn create(info: &Info<'_>) -> Result<Self, Failure>;

    /// Computes the node; runs of one session may be at it at the same time.
    fn compute(&self, context: Context<'_>) -> Result<(), Failure>;
}

/// An operator, and what its functions need besides.
#[repr(C)]
pub(crate) struct Operator {
    /// First, so that a pointer to it points to the whole.
    table: CustomOp,
    api: Api,
}

/// A kernel, the functions that make its statuses, and what is known of its session.
struct Instance<K> {
    api: Api,
    kernel: K,
    threads: SessionThreads,
}

impl Operator {
    pub(crate) fn new<K: Kernel>(api: Api) -> Self {
        let table = CustomOp {
            version: VERSION,
            create_v1: ptr::null(),
            name: name::<K>,
            provider: the_cpu,
            input_type: input_type::<K>,
            inputs: inputs::<K>,
            output_type: output_type::<K>,
            outputs: one,
            compute_v1: ptr::null(),
            destroy: destroy::<K>,
            input_characteristic: required,
            output_characteristic: required,
            input_memory: default_memory,
            variadic_input_arity: one,
            variadic_input_homogeneity: one,
            variadic_output_arity: one,
            variadic_output_homogeneity: one,
            create: create::<K>,
            compute: compute::<K>,
            infer: infer::<K>,
            start_version: one,
            end_version: any_later,
        };
        Self { table, api }
    }

    /// The table, whose address is that of the whole.
    pub(super) fn table(&'static self) -> *const CustomOp {
        ptr::from_ref(self).cast()
    }
}

unsafe extern "system" fn name<K: Kernel>(_: *const CustomOp) -> *const c_char {
    K::NAME.as_ptr()
}

unsafe extern "system" fn the_cpu(_: *const CustomOp) -> *const c_char {
    ptr::null()
}

/// An index beyond the inputs gets the undefined type.
unsafe extern "system" fn input_type<K: Kernel>(_: *const CustomOp, index: usize) -> c_int {
    K::INPUTS.get(index).map_or(0, |element| element.0)
}

unsafe extern "system" fn output_type<K: Kernel>(_: *const CustomOp, _: usize) -> c_int {
    K::INPUTS[0].0
}

unsafe extern "system" fn inputs<K: Kernel>(_: *const CustomOp) -> usize {
    K::INPUTS.len()
}

unsafe extern "system" fn one<T: From<bool>>(_: *const CustomOp) -> T {
    T::from(true)
}

unsafe extern "system" fn any_later(_: *const CustomOp) -> c_int {
    c_int::MAX
}

/// `INPUT_OUTPUT_REQUIRED`
unsafe extern "system" fn required(_: *const CustomOp, _: usize) -> c_int {
    0
}

/// `OrtMemTypeDefault`
unsafe extern "system" fn default_memory(_: *const CustomOp, _: usize) -> c_int {
    0
}

/// # Safety
/// ONNX Runtime calls it with its functions, a node and room for a pointer.
unsafe extern "system" fn create<K: Kernel>(
    _: *const CustomOp,
    api: *const ApiTable,
    info: *const KernelInfo,
    created: *mut *mut c_void,
) -> StatusPtr {
    // SAFETY: the functions are those of the ONNX Runtime that this operator is registered with.
    let api = unsafe { Api::new(api) };
    // SAFETY: the node's description lives for this call.
    let info = unsafe { Info::new(api, info) };
    let mut instance = ptr::null_mut();
    let status = guard(api, || {
        let kernel = K::create(&info).map_err(|failure| match info.node_name() {
            Ok(node) => failure.at(format_args!("{} '{node}'", K::NAME.to_string_lossy())),
            Err(_) => failure,
        })?;
        let made = Instance { api, kernel, threads: SessionThreads::default() };
        instance = Box::into_raw(Box::new(made)).cast();
        Ok(())
    });
    // SAFETY: there is room for a pointer; null for a kernel that was not made.
    unsafe { *created = instance };
    status
}

/// # Safety
/// ONNX Runtime calls it once with what `create` made, or with null.
unsafe extern "system" fn destroy<K: Kernel>(instance: *mut c_void) {
    if !instance.is_null() {
        // SAFETY: the box was made in `create`, and nobody uses it any more.
        let instance = unsafe { Box::from_raw(instance.cast::<Instance<K>>()) };
        let dropped = catch_unwind(AssertUnwindSafe(|| drop(instance)));
        std::mem::forget(dropped); // to drop a panic might panic again
    }
}

/// # Safety
/// ONNX Runtime calls it with what `create` made, and the context of a run.
unsafe extern "system" fn compute<K: Kernel>(
    instance: *mut c_void,
    context: *mut KernelContext,
) -> StatusPtr {
    // SAFETY: made in `create`, and shared: no thread writes to it.
    let Instance { api, kernel, threads } = unsafe { &*instance.cast::<Instance<K>>() };
    // SAFETY: the context lives for this call.
    guard(*api, || kernel.compute(unsafe { Context::new(*api, context, threads) }))
}

/// # Safety
/// ONNX Runtime calls it with an operator that was registered, and the context of an inference of shapes.
unsafe extern "system" fn infer<K: Kernel>(
    operator: *const CustomOp,
    context: *mut ShapeContext,
) -> StatusPtr {
    if !K::LIKE_FIRST {
        return ptr::null_mut();
    }
    // SAFETY: what was registered is the table of an `Operator`, at its beginning.
    let api = unsafe { (*operator.cast::<Operator>()).api };
    // SAFETY: the context lives for this call.
    guard(api, || unsafe { infer_like_input(api, context) })
}
