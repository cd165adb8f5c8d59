//! Memory that filters work in, lent by the caller.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};

use bytemuck::allocation::try_zeroed_vec;
use bytemuck::cast_slice_mut;

use crate::parallel::{Pool, Team};
use crate::simd::{LINE_BYTES, aligned};
use crate::{Error, Real};

/// Memory that a filter works in. It grows to what a call needs and serves filters of any shape and element type.
#[derive(Debug, Default)]
pub struct Scratch {
    memory: Vec<f64>,
    is_poisoned: bool,
}

/// What a call asks for: lengths are counts of numbers.
#[derive(Clone, Copy)]
pub(crate) struct Needs {
    /// Workers, who take jobs each for himself.
    pub(crate) workers: usize,
    /// Members of each worker's team.
    pub(crate) members: usize,
    /// For each member.
    pub(crate) kernel: usize,
    /// For all workers together.
    pub(crate) shared: usize,
}

/// The workers of a call, each a team of its own.
pub(crate) struct Workers<'a, T> {
    pool: &'a dyn Pool,
    needs: Needs,
    memory: &'a mut [T],
}

impl<T> Workers<'_, T> {
    /// Every worker.
    pub(crate) fn each(&mut self) -> impl ExactSizeIterator<Item = Team<'_, T>> {
        let (pool, len, pitch) = (self.pool, self.needs.kernel, self.needs.pitch::<T>());
        let each = self.needs.each::<T>();
        self.memory.chunks_exact_mut(each).map(move |memory| Team::new(pool, memory, pitch, len))
    }

    /// All of them as one team.
    pub(crate) fn together(&mut self) -> Team<'_, T> {
        Team::new(self.pool, self.memory, self.needs.pitch::<T>(), self.needs.kernel)
    }
}

impl Needs {
    /// Numbers from the scratch of a member to that of the next: whole lines, at least one.
    fn pitch<T>(&self) -> usize {
        let line = LINE_BYTES / size_of::<T>();
        self.kernel.max(1).checked_next_multiple_of(line).unwrap_or(usize::MAX)
    }

    /// Numbers for one worker.
    fn each<T>(&self) -> usize {
        self.pitch::<T>().saturating_mul(self.members)
    }
}

impl Scratch {
    /// One that holds NaN, in every element type, at the start of each call: a kernel that reads what it has not written shows.
    #[must_use]
    pub fn poisoned() -> Self {
        Self { memory: Vec::new(), is_poisoned: true }
    }

    /// Workers on `pool`, and what they share, with any content.
    ///
    /// # Errors
    /// [`Error::Memory`] if there is not so much.
    pub(crate) fn lend<'a, T: Real>(
        &'a mut self,
        pool: &'a dyn Pool,
        needs: Needs,
    ) -> Result<(Workers<'a, T>, &'a mut [T]), Error> {
        let len = needs.each::<T>().saturating_mul(needs.workers);
        let (memory, shared) = self.aligned(len, needs.shared)?;
        Ok((Workers { pool, needs, memory }, shared))
    }

    /// Two slices of these lengths, one behind the other, from the beginning of a line on.
    fn aligned<T: Real>(
        &mut self,
        first: usize,
        second: usize,
    ) -> Result<(&mut [T], &mut [T]), Error> {
        let len = first.saturating_add(second);
        let bytes = len.saturating_mul(size_of::<T>()).saturating_add(LINE_BYTES);
        let needed = bytes.div_ceil(size_of::<f64>());
        if self.memory.len() < needed {
            self.memory = Vec::new(); // given back before more is asked for
            self.memory = try_zeroed_vec(needed).map_err(|()| Error::Memory { bytes })?;
        }
        if self.is_poisoned {
            self.memory.fill(f64::from_bits(u64::MAX)); // NaN in halves and quarters too
        }
        let memory: &mut [T] = cast_slice_mut(aligned(&mut self.memory));
        Ok(memory[..len].split_at_mut(first))
    }

    fn bytes(&self) -> usize {
        self.memory.len() * size_of::<f64>()
    }
}

/// Scratches that are kept between calls, of any thread, with a bound on all of them together.
///
/// As many are kept as calls ran at the same time. Memory that is faulted anew in each call would cost more than the
/// filter.
#[derive(Debug)]
pub struct Scratches {
    kept: Mutex<VecDeque<Scratch>>,
    most_bytes: usize,
}

impl Scratches {
    /// None yet, and at most so many bytes later.
    #[must_use]
    pub const fn new(most_bytes: usize) -> Self {
        Self { kept: Mutex::new(VecDeque::new()), most_bytes }
    }

    /// Runs `compute` with the scratch that was used last, or a new one where all are in use.
    pub fn lend<R>(&self, compute: impl FnOnce(&mut Scratch) -> R) -> R {
        let last = self.kept().and_then(|mut kept| kept.pop_back());
        let mut scratch = last.unwrap_or_default();
        let result = compute(&mut scratch);
        self.keep(scratch);
        result
    }

    /// Bytes of those that are not in use.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.kept().map_or(0, |kept| kept.iter().map(Scratch::bytes).sum())
    }

    /// Keeps `scratch`, in place of the ones that were not used for longest if need be.
    fn keep(&self, scratch: Scratch) {
        let mut given_up = Vec::new(); // after the lock
        let Some(mut kept) = self.kept() else { return };
        kept.push_back(scratch);
        let mut bytes: usize = kept.iter().map(Scratch::bytes).sum();
        while bytes > self.most_bytes {
            let Some(oldest) = kept.pop_front() else { break };
            bytes -= oldest.bytes();
            given_up.push(oldest);
        }
        drop(kept);
    }

    /// Those that are kept, unless another thread is about to take one: after a fork that thread might not exist, so that
    /// nobody waits for it.
    fn kept(&self) -> Option<MutexGuard<'_, VecDeque<Scratch>>> {
        self.kept.try_lock().ok()
    }
}

/// Asks whether `bytes` are there before many small things are made of them, which cannot fail one by one.
pub(crate) fn check_room(bytes: usize) -> Result<(), Error> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| Error::Memory { bytes })
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;

    use super::*;
    use crate::StdThreads;

    #[test]
    fn memory_that_there_is_not_is_an_error() {
        let mut scratch = Scratch::default();
        for (workers, kernel) in
            [(usize::MAX, 1000), (usize::MAX >> 12, 1000), (1 << 40, 1000), (1, usize::MAX)]
        {
            let needs = Needs { workers, members: 8, kernel, shared: 7 };
            let scratch = black_box(&mut scratch); // or the compiler leaves out memory that nobody uses
            let result = scratch.lend::<f32>(&StdThreads(1), needs);
            assert!(matches!(result.map(|_| ()), Err(Error::Memory { .. })));
        }
        let needs = Needs { workers: 1, members: 8, kernel: 1000, shared: 7 };
        assert!(scratch.lend::<f32>(&StdThreads(1), needs).is_ok());
    }

    /// Uses so many scratches at the same time, of so many bytes each.
    fn use_together(scratches: &Scratches, count: usize, bytes: usize) {
        if count > 0 {
            scratches.lend(|scratch| {
                scratch.aligned::<f64>(bytes / size_of::<f64>(), 0).unwrap();
                use_together(scratches, count - 1, bytes);
            });
        }
    }

    #[test]
    fn what_is_kept_is_bounded_and_used_again() {
        const MIB: usize = 1 << 20;
        let scratches = Scratches::new(8 * MIB);
        use_together(&scratches, 20, MIB);
        assert!((6 * MIB..=8 * MIB).contains(&scratches.bytes()), "{}", scratches.bytes());
        let address = || scratches.lend(|s| s.aligned::<f32>(MIB, 0).unwrap().0.as_ptr());
        assert_eq!(address(), address());
        use_together(&scratches, 1, 9 * MIB);
        assert!(scratches.bytes() <= 8 * MIB);
    }

    /// The lock of a thread that a forked process does not have is never opened.
    #[test]
    fn a_locked_store_is_not_waited_for() {
        let scratches = Scratches::new(1 << 20);
        let locked = scratches.kept.lock();
        use_together(&scratches, 1, 1 << 10);
        drop(locked);
        assert_eq!(scratches.bytes(), 0);
    }
}
