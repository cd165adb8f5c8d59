//! Threads for kernels: the session's own, so that its options decide, and its other work counts.
//!
//! ONNX Runtime does not tell how many a session has. So a kernel counts, in its first runs, those that come to work that waits
//! for as many as there are processors.

use std::ffi::c_void;
use std::marker::PhantomData;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ffpose_core::tuning::WORTH_A_THREAD;
use ffpose_core::{Guarded, Pool};

use super::api::Api;
use super::sys::KernelContext;

/// As `num_batch`: every index goes to the next thread that is free.
const ONE_BY_ONE: usize = 0;

/// How long those who have come wait for others: threads that spin between the nodes of a run come within a few microseconds,
/// sleeping ones within 50.
const PATIENCE: Duration = Duration::from_micros(200);

/// Runs after which threads are counted no more. All but the first may find more of them than those before, on a machine that has
/// other work.
const COUNTED_RUNS: usize = 64;

/// What a kernel knows of its session's threads.
pub(crate) struct SessionThreads {
    processors: usize,
    patience: Duration,
    /// Most that have come, or 0 before they are counted.
    counted: AtomicUsize,
    runs: AtomicUsize,
}

/// Threads that wait for each other.
#[derive(Default)]
struct Meeting {
    came: AtomicUsize,
    is_over: AtomicBool,
}

/// The threads of a run's session.
pub(crate) struct SessionPool<'a> {
    api: Api,
    context: *const KernelContext,
    threads: usize,
    run: PhantomData<&'a KernelContext>,
}

// SAFETY: of the context only the session's threads are used, which any thread may do.
unsafe impl Sync for SessionPool<'_> {}

/// Processors that this process may use. Read as the library is loaded, since a thread that did so might be lost in a fork.
pub(super) fn processors() -> usize {
    static PROCESSORS: LazyLock<usize> =
        LazyLock::new(|| thread::available_parallelism().map_or(1, usize::from));
    *PROCESSORS
}

impl SessionThreads {
    pub(super) fn new(processors: usize, patience: Duration) -> Self {
        let (counted, runs) = (AtomicUsize::new(0), AtomicUsize::new(0));
        Self { processors, patience, counted, runs }
    }

    /// Those of `pool`, as far as they are known, at most as many as there are processors; counts them in the first run, the
    /// second, the fourth and so on.
    fn of(&self, pool: &SessionPool<'_>) -> usize {
        let counted = self.counted.load(Ordering::Relaxed);
        if counted == self.processors || self.processors == 1 {
            return self.processors;
        }
        let run = self.runs.fetch_add(1, Ordering::Relaxed) + 1;
        if counted > 0 && (run > COUNTED_RUNS || !run.is_power_of_two()) {
            return counted;
        }
        let came = pool.meet(self.processors, self.patience);
        came.max(self.counted.fetch_max(came, Ordering::Relaxed))
    }
}

impl Default for SessionThreads {
    fn default() -> Self {
        Self::new(processors(), PATIENCE)
    }
}

impl Meeting {
    /// Comes, unless it is over, and waits for `all` until then or `end`.
    fn attend(&self, all: usize, end: Instant) {
        if self.is_over.load(Ordering::Relaxed) {
            return;
        }
        self.came.fetch_add(1, Ordering::Relaxed);
        while self.came.load(Ordering::Relaxed) < all && !self.is_over.load(Ordering::Relaxed) {
            if Instant::now() >= end {
                self.is_over.store(true, Ordering::Relaxed);
            }
            thread::yield_now();
        }
    }
}

impl SessionPool<'_> {
    /// # Safety
    /// `context` is that of a run that lasts as long as the pool.
    pub(super) unsafe fn new(
        api: Api,
        context: *const KernelContext,
        threads: &SessionThreads,
    ) -> Self {
        let all = Self { api, context, threads: threads.processors, run: PhantomData };
        Self { threads: threads.of(&all), ..all }
    }

    /// How many threads take part at the same time, if up to `all` are waited for.
    fn meet(&self, all: usize, patience: Duration) -> usize {
        let (meeting, end) = (Meeting::default(), Instant::now() + patience);
        self.run(all, &|_| meeting.attend(all, end));
        meeting.came.into_inner()
    }
}

impl Pool for SessionPool<'_> {
    fn threads(&self) -> usize {
        self.threads
    }

    fn grain(&self) -> usize {
        WORTH_A_THREAD
    }

    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync)) {
        let work = Guarded::new(work);
        let data = (&raw const work).cast_mut().cast();
        let parallel_for = self.api.table().parallel_for;
        // SAFETY: the context lives; `run_one` takes a `Guarded` for its data, and `work` lives until all have been run.
        let result = unsafe {
            self.api.check(parallel_for(self.context, run_one, workers, ONE_BY_ONE, data))
        };
        work.finish();
        result.expect("ONNX Runtime lends its threads");
    }
}

/// Runs one worker.
///
/// # Safety
/// `data` points to a [`Guarded`].
unsafe extern "C" fn run_one(data: *mut c_void, worker: usize) {
    // SAFETY: as the caller promises.
    unsafe { &*data.cast::<Guarded<'_>>() }.call(worker);
}
