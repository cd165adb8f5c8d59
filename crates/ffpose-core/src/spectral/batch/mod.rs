//! A batch in pieces, and who takes which.
//!
//! Pieces share packed weights ([`weights`]), and sums of the weight's gradient ([`sums`]).

mod sums;
#[cfg(test)]
mod tests;
mod weights;

use bytemuck::cast_slice_mut;
use ndarray::{ArrayView3, ArrayViewMut3};

pub(crate) use self::weights::Weight;
use super::tiling::{PieceSizes, Tiling};
use crate::Shape;
use crate::kernel::{Backward, Factor, Kernel};
use crate::number::Number;
use crate::parallel::{self, Pool, Team};
use crate::scratch::{Needs, Workers};
use crate::simd::LINE_BYTES;
use crate::tuning::{ADDED_TOGETHER, Tuning};
use crate::views::{BATCH, in_order};

/// The pieces of a call, and how many work on them.
pub(crate) struct Batch<'a, X: Number> {
    shape: Shape,
    kernel: &'a dyn Kernel<X>,
    pool: &'a dyn Pool,
    pub(crate) tiling: Tiling,
    /// Images that share a sum of the weight's gradient.
    images_each: usize,
    /// Lanes whose packed weight, and sum, is apart from that of others.
    granule: usize,
    workers: usize,
    members: usize,
}

/// The images of a backward pass, `(batch, points, lanes)`.
pub(crate) struct Images<'a, X> {
    pub(crate) grad: ArrayView3<'a, X>,
    pub(crate) x: ArrayView3<'a, X>,
    pub(crate) grad_x: Option<ArrayViewMut3<'a, X>>,
}

impl<'a, X: Number> Batch<'a, X> {
    /// The pieces of `images` images for threads of `pool`; `summed` if a gradient is summed over them.
    pub(crate) fn new(
        shape: Shape,
        kernel: &'a dyn Kernel<X>,
        granule: usize,
        (images, summed): (usize, bool),
        pool: &'a dyn Pool,
        tuning: &'static Tuning,
    ) -> Self {
        let elements = images * shape.points() * shape.lanes;
        let threads = parallel::worth(pool, elements);
        let (least, most) = (kernel.narrowest_tile(), kernel.tile());
        let sizes = PieceSizes { least, most, together: kernel.images_together(), tuning };
        let cut = if summed { Tiling::summed } else { Tiling::even };
        let tiling = cut(shape, images, sizes, threads);
        let images_each = tiling.images_each();
        let alone =
            Self { shape, kernel, pool, tiling, images_each, granule, workers: 1, members: 1 };
        if threads == 1 {
            return alone;
        }
        let pieces = tiling.pieces();
        let rounds = pieces.div_ceil(threads);
        // threads that would idle for more than a fifth of the time help with each piece, if the kernel lets them
        if kernel.shares(images) && 4 * rounds * threads > 5 * pieces {
            let tiling = Tiling::new(shape, kernel.tile(), images, images);
            return Self { tiling, members: parallel::worth_together(pool, elements), ..alone };
        }
        Self { workers: pieces.div_ceil(rounds), ..alone }
    }

    /// What the call needs, with so many numbers for all workers together.
    pub(crate) fn needs(&self, shared: usize) -> Needs {
        let (workers, members) = (self.workers, self.members);
        Needs { workers, members, kernel: self.kernel.scratch_len(members), shared }
    }

    /// As [`needs`](Self::needs), with room for copies of what goes together in place.
    pub(crate) fn needs_in_place(&self, shared: usize) -> Needs {
        let needs = self.needs(shared);
        Needs { kernel: needs.kernel.saturating_add(self.copy_len()), ..needs }
    }

    /// Numbers of each member of a team for a copy of the images that go together, in whole cache lines.
    fn copy_len(&self) -> usize {
        let images = self.kernel.images_together().min(self.tiling.images_each());
        let elements = images * self.shape.points() * self.lanes_each();
        let line = LINE_BYTES / size_of::<X::Real>();
        let numbers = (elements * size_of::<X>()).div_ceil(size_of::<X::Real>());
        numbers.div_ceil(self.members).next_multiple_of(line)
    }

    /// `y = irfft2(rfft2(x) · W)`, where `y` is `x` itself if there is no other. `packed` has room for
    /// [`packed_len`](Self::packed_len) numbers.
    pub(crate) fn forward(
        &self,
        (x, y): (Option<ArrayView3<'_, X>>, ArrayViewMut3<'_, X>),
        weight: Weight<'_, X::Real>,
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
    ) {
        let jobs = self.tiling.images_mut(y);
        self.run(jobs, weight, Some(Factor::Weight), packed, workers, |piece, y, weight, team| {
            match x {
                Some(x) => self.kernel.forward(self.tiling.images(x, piece), weight, y, team),
                None => self.copied(y, team, |x, y, team| self.kernel.forward(x, weight, y, team)),
            }
        });
    }

    /// Runs `filter` in place, from a copy of the images that go together: small enough for a cache to hold it.
    pub(crate) fn copied(
        &self,
        mut piece: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
        filter: impl Fn(ArrayView3<'_, X>, ArrayViewMut3<'_, X>, &mut Team<'_, X::Real>),
    ) {
        let (room, mut team) = team.share(self.copy_len());
        let room: &mut [X] = cast_slice_mut(room);
        for images in piece.axis_chunks_iter_mut(BATCH, self.kernel.images_together()) {
            let copy = ArrayViewMut3::from_shape(images.raw_dim(), &mut room[..images.len()]);
            let mut copy = copy.expect("room for the images that go together");
            copy.assign(&images);
            filter(copy.view(), images, &mut team);
        }
    }

    /// The gradient of `x` if there is one, and the sums of that of the weight if there is room for
    /// [`sums_len`](Self::sums_len) numbers of it.
    pub(crate) fn backward(
        &self,
        Images { grad, x, grad_x }: Images<'_, X>,
        weight: Weight<'_, X::Real>,
        packed: &mut [X::Real],
        sums: Option<&mut [X::Real]>,
        workers: &mut Workers<'_, X::Real>,
    ) {
        let pieces = self.tiling.pieces();
        let factor = grad_x.is_some().then_some(Factor::Conjugate);
        let sums_each = self.sums_len() / pieces;
        let jobs = in_order(pieces, grad_x.map(|g| self.tiling.images_mut(g)))
            .zip(in_order(pieces, sums.map(|sums| sums.chunks_exact_mut(sums_each))));
        let images_each = self.images_each;
        self.run(
            jobs,
            weight,
            factor,
            packed,
            workers,
            |piece, (grad_x, mut sum), weight, team| {
                if let Some(sum) = &mut sum {
                    team.run(sum.chunks_mut(ADDED_TOGETHER), |sum, _| sum.fill(X::Real::default()));
                }
                let (grad, x) = (self.tiling.images(grad, piece), self.tiling.images(x, piece));
                let pass = Backward { grad, x, weight, grad_x, grad_sum: sum, images_each };
                self.kernel.backward(pass, team);
            },
        );
    }

    /// Lanes for each worker where they share a weight.
    fn share_of_lanes(&self) -> usize {
        self.shape.lanes.div_ceil(self.granule).div_ceil(self.workers) * self.granule
    }

    /// Most lanes of a tile of the images that there are.
    fn lanes_each(&self) -> usize {
        self.tiling.lanes_each().min(self.shape.lanes)
    }
}
