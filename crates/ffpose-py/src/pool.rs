//! Threads for tensors: torch's own, found at run time, so that `torch.set_num_threads` and torch's other work count.

use std::ffi::c_void;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use ffpose_core::tuning::WORTH_A_THREAD;
use ffpose_core::{Guarded, Pool, StdThreads};

/// `torch_parallel_for(begin, end, grain, body, context)` of torch's stable C interface; 0 is success.
type ParallelFor = unsafe extern "C" fn(i64, i64, i64, Body, *mut c_void) -> i32;
type Body = unsafe extern "C" fn(i64, i64, *mut c_void);

/// At most so many of torch's threads; where there are none to be found, of the operating system's.
pub(crate) struct TorchPool {
    parallel_for: Option<ParallelFor>,
    others: StdThreads,
}

impl TorchPool {
    pub(crate) fn new(threads: usize) -> Self {
        let parallel_for = if threads > 1 { parallel_for() } else { None };
        Self { parallel_for, others: StdThreads(threads) }
    }
}

impl Pool for TorchPool {
    fn threads(&self) -> usize {
        self.others.threads()
    }

    fn grain(&self) -> usize {
        if self.parallel_for.is_some() { WORTH_A_THREAD } else { self.others.grain() }
    }

    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync)) {
        match self.parallel_for {
            Some(parallel_for) => run(parallel_for, workers, work),
            None => self.others.run(workers, work),
        }
    }
}

fn run(parallel_for: ParallelFor, workers: usize, work: &(dyn Fn(usize) + Sync)) {
    let work = Guarded::new(work);
    let context = (&raw const work).cast_mut().cast();
    let count = i64::try_from(workers).expect("fewer workers than elements");
    // SAFETY: `run_range` takes a `Guarded` for its context, and `work` lives until torch has returned from it.
    let status = unsafe { parallel_for(0, count, 1, run_range, context) };
    work.finish();
    assert!(status == 0, "torch_parallel_for failed with status {status}");
}

/// Runs workers `begin..end`.
///
/// # Safety
/// `context` points to a [`Guarded`].
unsafe extern "C" fn run_range(begin: i64, end: i64, context: *mut c_void) {
    // SAFETY: as the caller promises.
    let work = unsafe { &*context.cast::<Guarded<'_>>() };
    for worker in begin..end {
        work.call(usize::try_from(worker).expect("counted from zero"));
    }
}

/// torch's function, unless this process is a fork: it has none of the threads that torch's pool, once used before the fork,
/// would wait for.
fn parallel_for() -> Option<ParallelFor> {
    static FOUND: OnceLock<Option<ParallelFor>> = OnceLock::new();
    if forks() > 0 { None } else { *FOUND.get_or_init(find_parallel_for) }
}

static FORKS: AtomicUsize = AtomicUsize::new(0);

/// How many forks this process is away from the one that loaded this library.
pub(crate) fn forks() -> usize {
    FORKS.load(Ordering::Relaxed)
}

/// Lets forked children know that they are.
#[cfg(unix)]
pub(crate) fn watch_forks() {
    extern "C" fn note() {
        FORKS.fetch_add(1, Ordering::Relaxed);
    }
    // SAFETY: a change of an atomic is all that a child may do at this point; the C library forgets `note` if it unloads
    // this library.
    let status = unsafe { libc::pthread_atfork(None, None, Some(note)) };
    assert!(status == 0, "pthread_atfork failed with status {status}");
}

#[cfg(not(unix))]
pub(crate) fn watch_forks() {} // there are none

/// Looks for the function in the library that the process has loaded.
///
/// Python loads torch's libraries for themselves, so that the symbols of the whole process do not have it.
#[cfg(target_os = "linux")]
fn find_parallel_for() -> Option<ParallelFor> {
    // SAFETY: both names are C strings; NOLOAD opens nothing that runs code, and a library without a handle is not
    // asked. torch declares the function with the type that its address is given here.
    unsafe {
        let library = libc::dlopen(c"libtorch_cpu.so".as_ptr(), libc::RTLD_NOW | libc::RTLD_NOLOAD);
        if library.is_null() {
            return None;
        }
        let function = libc::dlsym(library, c"torch_parallel_for".as_ptr());
        std::mem::transmute::<*mut c_void, Option<ParallelFor>>(function)
    }
}

#[cfg(not(target_os = "linux"))]
fn find_parallel_for() -> Option<ParallelFor> {
    None
}
