//! The sums of a weight's gradient over the parts of a batch.

use ndarray::ArrayViewMut3;

use super::Batch;
use crate::number::Number;
use crate::parallel::{self, Team};
use crate::scratch::Workers;
use crate::spectral::tiling::Tiling;
use crate::tuning::ADDED_TOGETHER;

impl<X: Number> Batch<'_, X> {
    /// Numbers for the sums of all parts.
    pub(crate) fn sums_len(&self) -> usize {
        self.sum_len().saturating_mul(self.parts()).saturating_mul(self.tiling.tiles())
    }

    /// The gradient of the weight, from the sums of all parts; these are lost.
    pub(crate) fn finish(
        &self,
        sums: &mut [X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        workers: &mut Workers<'_, X::Real>,
    ) {
        let sum_len = self.sum_len();
        let narrow = self.share_of_lanes().min(self.lanes_each());
        let narrow = Tiling::new(self.shape, narrow, 1, 1);
        let jobs =
            sums.chunks_exact_mut(sum_len * self.parts()).zip(self.tiling.bins_mut(grad_weight));
        let jobs = jobs.flat_map(|(sums, grad_weight)| {
            let (total, parts) = sums.split_at_mut(sum_len);
            let parts = &*parts;
            let len = self.sum_offset(narrow.lanes_each()).min(sum_len);
            let totals = total.chunks_mut(len).enumerate();
            totals
                .zip(narrow.bins_mut(grad_weight))
                .map(move |((index, total), grad_weight)| (total, parts, index * len, grad_weight))
        });
        let add_and_unpack = |job: (&mut [X::Real], &[_], _, _), team: &mut Team<'_, _>| {
            let (total, parts, start, grad_weight) = job;
            team.run(total.chunks_mut(ADDED_TOGETHER).enumerate(), |(index, total), _| {
                for part in parts.chunks_exact(sum_len) {
                    let terms = &part[start + index * ADDED_TOGETHER..];
                    total.iter_mut().zip(terms).for_each(|(sum, term)| *sum = *sum + *term);
                }
            });
            self.kernel.unpack_gradient(total, grad_weight, team);
        };
        if self.shape.lanes <= narrow.lanes_each() {
            let mut team = workers.together();
            return jobs.for_each(|job| add_and_unpack(job, &mut team));
        }
        parallel::run(self.pool, workers.each(), jobs, add_and_unpack);
    }

    /// Where the sum of the lanes from `lane` on begins.
    fn sum_offset(&self, lane: usize) -> usize {
        lane.div_ceil(self.granule).saturating_mul(self.kernel.sum_len(self.granule))
    }

    /// Numbers of one part of the sum of a tile.
    fn sum_len(&self) -> usize {
        self.sum_offset(self.lanes_each())
    }

    fn parts(&self) -> usize {
        self.tiling.images_len().div_ceil(self.images_each)
    }
}
