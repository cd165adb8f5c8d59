//! Memory that filters work in, lent by the caller.

use bytemuck::allocation::try_zeroed_vec;
use bytemuck::cast_slice_mut;

use crate::parallel::{Pool, Team};
use crate::{Error, Real};

/// Bytes of a cache line, and of the widest vector: where slices begin.
const LINE: usize = 64;

/// Memory that a filter works in. It grows to what a call needs and serves filters of any shape and element type.
#[derive(Debug, Default)]
pub struct Scratch {
    memory: Vec<f64>,
}

/// What a call asks for: lengths are counts of numbers.
#[derive(Clone, Copy)]
pub(crate) struct Needs {
    /// Workers, who take jobs each for himself.
    pub(crate) workers: usize,
    /// Members of each worker's team.
    pub(crate) members: usize,
    pub(crate) packed: usize,
    /// For each member.
    pub(crate) kernel: usize,
    /// For all workers together.
    pub(crate) shared: usize,
}

/// What one worker works in, with any content.
pub(crate) struct Worker<'a, T> {
    /// For the packed weight of a tile.
    pub(crate) packed: &'a mut [T],
    /// For the kernel, and who may help it.
    pub(crate) team: Team<'a, T>,
}

/// The workers of a call.
pub(crate) struct Workers<'a, T> {
    pool: &'a dyn Pool,
    needs: Needs,
    memory: &'a mut [T],
}

impl<T> Workers<'_, T> {
    /// Every worker.
    pub(crate) fn each(&mut self) -> impl ExactSizeIterator<Item = Worker<'_, T>> {
        let (pool, Needs { packed, kernel, .. }) = (self.pool, self.needs);
        let [packed_lines, kernel_lines] = self.needs.lines::<T>();
        self.memory.chunks_exact_mut(self.needs.each::<T>()).map(move |memory| {
            let (packed_part, kernel_part) = memory.split_at_mut(packed_lines);
            Worker {
                packed: &mut packed_part[..packed],
                team: Team::new(pool, kernel_part, kernel_lines, kernel),
            }
        })
    }
}

impl Needs {
    /// Whole lines for each slice; a member has at least one.
    fn lines<T>(&self) -> [usize; 2] {
        let line = LINE / size_of::<T>();
        [self.packed, self.kernel.max(1)]
            .map(|len| len.checked_next_multiple_of(line).unwrap_or(usize::MAX))
    }

    /// Numbers for one worker.
    fn each<T>(&self) -> usize {
        let [packed, kernel] = self.lines::<T>();
        kernel.saturating_mul(self.members).saturating_add(packed)
    }
}

impl Scratch {
    /// Gives memory back if it is more than `bytes`; for callers that keep a scratch between calls.
    pub fn keep_at_most(&mut self, bytes: usize) {
        if self.memory.len() * size_of::<f64>() > bytes {
            self.memory = Vec::new();
        }
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
        let bytes = len.saturating_mul(size_of::<T>()).saturating_add(LINE);
        let needed = bytes.div_ceil(size_of::<f64>());
        if self.memory.len() < needed {
            self.memory = Vec::new(); // given back before more is asked for
            self.memory = try_zeroed_vec(needed).map_err(|()| Error::Memory { bytes })?;
        }
        let skip = self.memory.as_ptr().align_offset(LINE);
        let memory: &mut [T] = cast_slice_mut(&mut self.memory[skip..]);
        Ok(memory[..len].split_at_mut(first))
    }
}

/// Asks whether `bytes` are there before many small things are made of them, which cannot fail one by one.
pub(crate) fn check_room(bytes: usize) -> Result<(), Error> {
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| Error::Memory { bytes })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StdThreads;

    #[test]
    fn memory_that_there_is_not_is_an_error() {
        let mut scratch = Scratch::default();
        for (workers, kernel) in
            [(usize::MAX, 1000), (usize::MAX >> 12, 1000), (1 << 40, 1000), (1, usize::MAX)]
        {
            let needs = Needs { workers, members: 8, packed: 9, kernel, shared: 7 };
            let result = scratch.lend::<f32>(&StdThreads(1), needs);
            assert!(matches!(result.map(|_| ()), Err(Error::Memory { .. })));
        }
        let needs = Needs { workers: 1, members: 8, packed: 9, kernel: 1000, shared: 7 };
        assert!(scratch.lend::<f32>(&StdThreads(1), needs).is_ok());
    }
}
