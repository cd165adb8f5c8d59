//! The one place that decides on threads.
//!
//! The core owns no threads: a [`Pool`] lends them. [`StdThreads`] is for callers without one.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use crate::tuning::WORTH_A_NEW_THREAD;

/// Threads that a caller lends.
pub trait Pool: Sync {
    /// Threads that may work at a time, the caller's own among them; at least 1.
    fn threads(&self) -> usize;

    /// Elements of work below which another of these threads costs more than it brings.
    fn grain(&self) -> usize;

    /// Calls `work` once with each of `0..workers`, on several threads if there are, and returns when all are done.
    ///
    /// A panic in `work` reaches the caller, after the others are done. Threads that cannot be had leave their share to the
    /// caller's own.
    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync));
}

/// At most this many threads of the operating system, which live as long as one call: nothing is left behind that a
/// forked process could wait for in vain.
#[derive(Clone, Copy, Debug)]
pub struct StdThreads(pub usize);

impl Pool for StdThreads {
    fn threads(&self) -> usize {
        self.0
    }

    fn grain(&self) -> usize {
        WORTH_A_NEW_THREAD
    }

    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync)) {
        thread::scope(|scope| {
            let start = |worker| thread::Builder::new().spawn_scoped(scope, move || work(worker));
            let started = (1..workers).take_while(|&worker| start(worker).is_ok()).count();
            work(0);
            (1 + started..workers).for_each(work);
        });
    }
}

/// The work of a [`Pool`] on threads of another program, whose frames no panic may cross: it is kept for the caller.
pub struct Guarded<'a> {
    work: &'a (dyn Fn(usize) + Sync),
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl<'a> Guarded<'a> {
    /// Guards the work that a pool was given.
    #[must_use]
    pub fn new(work: &'a (dyn Fn(usize) + Sync)) -> Self {
        Self { work, panic: Mutex::new(None) }
    }

    /// Calls the work with `worker`.
    pub fn call(&self, worker: usize) {
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| (self.work)(worker))) {
            lock(&self.panic).get_or_insert(panic);
        }
    }

    /// Goes on with the first panic, after all workers are done.
    ///
    /// # Panics
    /// If the work did.
    pub fn finish(self) {
        if let Some(panic) = self.panic.into_inner().unwrap_or_else(PoisonError::into_inner) {
            resume_unwind(panic);
        }
    }
}

/// How many threads of `pool` to use for `elements` of work.
pub(crate) fn worth(pool: &dyn Pool, elements: usize) -> usize {
    pool.threads().min(elements / pool.grain()).max(1)
}

/// How many threads of `pool` to use together for one piece of `elements`: they wait for each other between its passes,
/// which pays from 196x256 tokens on: two of torch's threads took 43 microseconds, one 50.
pub(crate) fn worth_together(pool: &dyn Pool, elements: usize) -> usize {
    worth(pool, elements / 3 * 2)
}

/// Runs `work` on every job. Each of `workers` begins with an equal share of neighboring jobs, the same in every call: what it
/// wrote there is still in its cache. Then it takes what is left of the others' shares.
///
/// Jobs write to places of their own, so the result does not depend on who does which.
pub(crate) fn run<J: Send, W: Send>(
    pool: &dyn Pool,
    mut workers: impl ExactSizeIterator<Item = W>,
    jobs: impl Iterator<Item = J>,
    work: impl Fn(J, &mut W) + Sync,
) {
    if workers.len() == 1 {
        let mut worker = workers.next().expect("one");
        return jobs.for_each(|job| work(job, &mut worker));
    }
    let jobs: Vec<_> = jobs.collect();
    let workers: Vec<_> = workers.take(jobs.len().max(1)).map(Mutex::new).collect();
    let (count, len, mut jobs) = (workers.len(), jobs.len(), jobs.into_iter());
    let shares: Vec<_> = (0..count)
        .map(|i| len * (i + 1) / count - len * i / count)
        .map(|share| Mutex::new(jobs.by_ref().take(share).collect::<VecDeque<_>>()))
        .collect();
    let next = |index: usize| {
        let own = lock(&shares[index]).pop_front();
        own.or_else(|| (1..count).find_map(|i| lock(&shares[(index + i) % count]).pop_back()))
    };
    pool.run(count, &|index| {
        let mut worker = lock(&workers[index]);
        while let Some(job) = next(index) {
            work(job, &mut worker);
        }
    });
}

/// Locks `mutex`, also after a panic in another thread.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Threads that may share the work on one piece, and scratch for each; often one alone.
pub(crate) struct Team<'a, T> {
    pool: &'a dyn Pool,
    /// Scratch of all members, `pitch` apart and `len` long.
    memory: &'a mut [T],
    pitch: usize,
    len: usize,
}

impl<'a, T> Team<'a, T> {
    /// As many members as `memory` has scratches, which are `len` of each `pitch` numbers.
    pub(crate) fn new(pool: &'a dyn Pool, memory: &'a mut [T], pitch: usize, len: usize) -> Self {
        Self { pool, memory, pitch, len }
    }

    /// The scratch of a member, for work that is not shared.
    pub(crate) fn scratch(&mut self) -> &mut [T] {
        &mut self.memory[..self.len]
    }

    /// How many there are.
    pub(crate) fn members(&self) -> usize {
        self.memory.len() / self.pitch
    }

    /// Numbers that all share, `len` from the scratch of each member, and the team with what is left to them.
    pub(crate) fn share(&mut self, len: usize) -> (&mut [T], Team<'_, T>) {
        let (shared, memory) = self.memory.split_at_mut(len * self.members());
        let (pitch, len) = (self.pitch - len, self.len - len);
        (shared, Team { pool: self.pool, memory, pitch, len })
    }

    /// Runs `work` on every job, each with the scratch of the member who does it; see [`run`].
    pub(crate) fn run<J: Send>(
        &mut self,
        jobs: impl Iterator<Item = J>,
        work: impl Fn(J, &mut [T]) + Sync,
    ) where
        T: Send,
    {
        let members = self.memory.chunks_mut(self.pitch);
        run(self.pool, members, jobs, |job, scratch| work(job, &mut scratch[..self.len]));
    }
}
