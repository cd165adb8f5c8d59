//! Threads for kernels: the session's own, so that its options decide, and its other work counts.

use std::any::Any;
use std::ffi::c_void;
use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread;

use ffpose_core::Pool;
use ffpose_core::tuning::WORTH_A_THREAD;

use super::api::Api;
use super::sys::KernelContext;

/// As `num_batch`: every index goes to the next thread that is free.
const ONE_BY_ONE: usize = 0;

/// The threads of a run's session.
pub(crate) struct SessionPool<'a> {
    api: Api,
    context: *const KernelContext,
    run: PhantomData<&'a KernelContext>,
}

// SAFETY: of the context only the session's threads are used, which any thread may do.
unsafe impl Sync for SessionPool<'_> {}

/// What the threads of one call share.
struct Call<'a> {
    work: &'a (dyn Fn(usize) + Sync),
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl SessionPool<'_> {
    /// # Safety
    /// `context` is that of a run that lasts as long as the pool.
    pub(super) unsafe fn new(api: Api, context: *const KernelContext) -> Self {
        Self { api, context, run: PhantomData }
    }
}

impl Pool for SessionPool<'_> {
    /// As many as there are processors: ONNX Runtime does not tell. Where a session has fewer, each of them takes the work
    /// of several.
    fn threads(&self) -> usize {
        static PROCESSORS: OnceLock<usize> = OnceLock::new();
        *PROCESSORS.get_or_init(|| thread::available_parallelism().map_or(1, usize::from))
    }

    fn grain(&self) -> usize {
        WORTH_A_THREAD
    }

    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync)) {
        let call = Call { work, panic: Mutex::new(None) };
        let data = (&raw const call).cast_mut().cast();
        let parallel_for = self.api.table().parallel_for;
        // SAFETY: the context lives; `run_one` takes a `Call` for its data, and `call` lives until all have been run.
        let result = unsafe {
            self.api.check(parallel_for(self.context, run_one, workers, ONE_BY_ONE, data))
        };
        if let Some(panic) = call.panic.into_inner().unwrap_or_else(PoisonError::into_inner) {
            resume_unwind(panic);
        }
        result.expect("ONNX Runtime lends its threads");
    }
}

/// Runs one worker. A panic must not cross ONNX Runtime's frames: it is kept for the caller.
///
/// # Safety
/// `data` points to a [`Call`].
unsafe extern "C" fn run_one(data: *mut c_void, worker: usize) {
    // SAFETY: as the caller promises.
    let call = unsafe { &*data.cast::<Call<'_>>() };
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| (call.work)(worker))) {
        call.panic.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(panic);
    }
}
