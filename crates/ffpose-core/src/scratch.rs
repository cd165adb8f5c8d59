//! Memory that filters work in, lent by the caller.

use bytemuck::cast_slice_mut;

use crate::Real;

/// Bytes of a cache line, and of the widest vector: where slices begin.
const LINE: usize = 64;

/// Memory that a filter works in. It grows to what a call needs and serves filters of any shape and element type.
#[derive(Debug, Default)]
pub struct Scratch {
    workers: Vec<f64>,
    sums: Vec<f64>,
}

/// What one worker works in.
pub(crate) struct Worker<'a, T> {
    /// For the packed weight of a tile.
    pub(crate) packed: &'a mut [T],
    /// For the kernel.
    pub(crate) scratch: &'a mut [T],
}

impl Scratch {
    /// Gives memory back if it is more than `bytes`; for callers that keep a scratch between calls.
    pub fn keep_at_most(&mut self, bytes: usize) {
        if (self.workers.len() + self.sums.len()) * size_of::<f64>() > bytes {
            *self = Self::default();
        }
    }

    /// `workers` workers, with any content, and `sums` zeros.
    pub(crate) fn lend<T: Real>(
        &mut self,
        workers: usize,
        packed_len: usize,
        scratch_len: usize,
        sums: usize,
    ) -> (Vec<Worker<'_, T>>, &mut [T]) {
        let line = LINE / size_of::<T>();
        let start = packed_len.next_multiple_of(line);
        let each = start + scratch_len.next_multiple_of(line);
        let memory = aligned(&mut self.workers, workers * each);
        let workers = memory.chunks_exact_mut(each).map(|worker| {
            let (packed, scratch) = worker.split_at_mut(start);
            Worker { packed: &mut packed[..packed_len], scratch: &mut scratch[..scratch_len] }
        });
        let sums = aligned(&mut self.sums, sums);
        sums.fill(T::default());
        (workers.collect(), sums)
    }
}

/// `len` numbers from the beginning of a line on.
fn aligned<T: Real>(memory: &mut Vec<f64>, len: usize) -> &mut [T] {
    let needed = (len * size_of::<T>() + LINE).div_ceil(size_of::<f64>());
    if memory.len() < needed {
        *memory = vec![0.0; needed];
    }
    let skip = memory.as_ptr().align_offset(LINE);
    &mut cast_slice_mut(&mut memory[skip..])[..len]
}
