//! The packed weights of a batch: which worker packs what, and where it stands.

use ndarray::ArrayView3;

use super::Batch;
use crate::kernel::{Factor, Packing};
use crate::number::Number;
use crate::parallel::{self, Team};
use crate::scratch::Workers;
use crate::spectral::tiling::Tiling;

/// A weight to filter a batch with.
#[derive(Clone, Copy)]
pub(crate) enum Weight<'a, T> {
    /// `(bins, lanes, 2)`.
    Natural(ArrayView3<'a, T>),
    /// As the kernel reads it, all of it.
    Prepared(&'a [T]),
}

impl<X: Number> Batch<'_, X> {
    /// Numbers for packed weights: of a tile for each worker, or of all tiles for all workers.
    pub(crate) fn packed_len(&self) -> usize {
        self.kernel.packing().map_or(0, |packing| {
            if self.is_by_tiles() {
                packing.offset(self.granule, self.lanes_each()).saturating_mul(self.workers)
            } else {
                packing.offset(self.granule, self.shape.lanes)
            }
        })
    }

    /// Whether each worker takes whole tiles; else several share a tile and its packed weight.
    pub(super) fn is_by_tiles(&self) -> bool {
        self.tiling.tiles().is_multiple_of(self.workers)
    }

    /// Runs `work` on each piece, its job and the factor of its tile, packed before that if it is wanted.
    pub(super) fn run<J: Send>(
        &self,
        jobs: impl Iterator<Item = J>,
        weight: Weight<'_, X::Real>,
        factor: Option<Factor>,
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
        work: impl Fn(usize, J, &[X::Real], &mut Team<'_, X::Real>) + Sync,
    ) {
        let Some(packing) = self.kernel.packing() else {
            let weight = match weight {
                Weight::Natural(weight) => weight.to_slice().expect("a whole weight has no gaps"),
                Weight::Prepared(weight) => weight,
            };
            return parallel::run(self.pool, workers.each(), jobs.enumerate(), |job, team| {
                work(job.0, job.1, weight, team);
            });
        };
        let packed = match weight {
            Weight::Prepared(packed) => packed,
            Weight::Natural(weight) if self.is_by_tiles() => {
                let wanted = (packing, weight, factor);
                return self.run_by_tiles(jobs, wanted, packed, workers, work);
            }
            Weight::Natural(weight) => {
                if let Some(factor) = factor {
                    self.pack(packing, (weight, factor), packed, workers);
                }
                packed
            }
        };
        parallel::run(self.pool, workers.each(), jobs.enumerate(), |(piece, job), team| {
            let lanes = self.tiling.lanes_of(self.tiling.place_of(piece).0);
            let packed = &packed[packing.offset(self.granule, lanes.start)..];
            work(piece, job, &packed[..packing.packed_len(lanes.len())], team);
        });
    }

    /// As [`run`](Self::run), where all pieces of a tile are one worker's: each packs the weights of his tiles where that of the
    /// last one was, in his cache.
    fn run_by_tiles<J: Send>(
        &self,
        mut jobs: impl Iterator<Item = J>,
        (packing, weight, factor): (&dyn Packing<X::Real>, ArrayView3<'_, X::Real>, Option<Factor>),
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
        work: impl Fn(usize, J, &[X::Real], &mut Team<'_, X::Real>) + Sync,
    ) {
        let parts = self.tiling.parts();
        let tiles = (0..self.tiling.tiles())
            .map(|tile| (tile, jobs.by_ref().take(parts).collect::<Vec<_>>()));
        let rooms = packed.chunks_exact_mut(packing.offset(self.granule, self.lanes_each()));
        let workers = workers.each().zip(rooms);
        parallel::run(self.pool, workers, tiles, |(tile, jobs), (team, packed)| {
            let lanes = self.tiling.lanes_of(tile);
            let packed = &mut packed[..packing.packed_len(lanes.len())];
            if let Some(factor) = factor {
                packing.pack(weight, lanes, factor, packed, team);
            }
            for (part, job) in jobs.into_iter().enumerate() {
                work(tile * parts + part, job, packed, team);
            }
        });
    }

    /// Packs the whole weight, all workers together.
    pub(crate) fn pack(
        &self,
        packing: &dyn Packing<X::Real>,
        (weight, factor): (ArrayView3<'_, X::Real>, Factor),
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
    ) {
        let widest = self.kernel.tile().next_multiple_of(self.granule);
        let lanes = self.share_of_lanes().min(widest);
        if self.shape.lanes <= lanes {
            let packed = &mut packed[..packing.packed_len(self.shape.lanes)];
            let lanes = 0..self.shape.lanes;
            return packing.pack(weight, lanes, factor, packed, &mut workers.together());
        }
        let tiling = Tiling::new(self.shape, lanes, 1, 1);
        let jobs = packed.chunks_mut(packing.offset(self.granule, lanes)).enumerate();
        parallel::run(self.pool, workers.each(), jobs, |(tile, packed), team| {
            let lanes = tiling.lanes_of(tile);
            let packed = &mut packed[..packing.packed_len(lanes.len())];
            packing.pack(weight, lanes, factor, packed, team);
        });
    }
}
