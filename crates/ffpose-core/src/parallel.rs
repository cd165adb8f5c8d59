//! The one place that decides on threads.
//!
//! Threads live as long as one call: no pool, so nothing that a forked process could wait for in vain.

use std::thread;

/// Elements of work below which another thread is taken to cost more than it brings: an estimate, not a measurement.
const WORTH_A_THREAD: usize = 1 << 17;

/// How many threads to use for `elements` of work when the caller allows `most`.
pub(crate) fn worth(most: usize, elements: usize) -> usize {
    most.min(elements / WORTH_A_THREAD).max(1)
}

/// Runs `work` on every job: one thread for each scratch, the caller's own among them, and contiguous runs of jobs.
///
/// Jobs write to places of their own, so the result does not depend on the number of threads.
pub(crate) fn run<J: Send, S: Send>(
    mut jobs: Vec<J>,
    mut scratches: Vec<S>,
    work: impl Fn(J, &mut S) + Sync,
) {
    let each = jobs.len().div_ceil(scratches.len().max(1));
    let run_one = |jobs: Vec<J>, mut scratch: S| {
        for job in jobs {
            work(job, &mut scratch);
        }
    };
    thread::scope(|scope| {
        while jobs.len() > each
            && let Some(scratch) = scratches.pop()
        {
            let last = jobs.split_off(jobs.len() - each);
            scope.spawn(move || run_one(last, scratch));
        }
        if let Some(scratch) = scratches.pop() {
            run_one(jobs, scratch);
        }
    });
}
