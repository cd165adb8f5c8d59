//! A batch in pieces: who takes which, the packed weights that they share, and the sums of gradients.

use bytemuck::cast_slice_mut;
use ndarray::{ArrayView3, ArrayViewMut3, Axis};

use super::tiling::{Grain, Tiling, in_order};
use crate::kernel::{Backward, Kernel};
use crate::number::Number;
use crate::parallel::{self, Pool, Team};
use crate::scratch::{Needs, Workers};
use crate::simd::{LINE_BYTES, Stored};
use crate::{Real, Shape};

const BATCH: Axis = Axis(0);

/// Numbers of a sum that one member of a team adds up at a time.
const ADDED_TOGETHER: usize = 1 << 12;

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

/// A weight to filter a batch with.
#[derive(Clone, Copy)]
pub(crate) enum Weight<'a, T> {
    /// `(bins, lanes, 2)`.
    Natural(ArrayView3<'a, T>),
    /// In kernel order, all of it.
    Packed(&'a [T]),
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
    ) -> Self {
        let elements = images * shape.points() * shape.lanes;
        let threads = parallel::worth(pool, elements);
        let (least, most) = (kernel.narrowest_tile(), kernel.tile());
        let grain = Grain { least, most, together: kernel.images_together() };
        let cut = if summed { Tiling::summed } else { Tiling::even };
        let tiling = cut(shape, images, grain, threads);
        let images_each = tiling.images_each();
        let alone =
            Self { shape, kernel, pool, tiling, images_each, granule, workers: 1, members: 1 };
        if threads == 1 {
            return alone;
        }
        let pieces = tiling.pieces();
        let rounds = pieces.div_ceil(threads);
        // threads that would idle for more than a fifth of the time help with each piece, if the kernel lets them
        if kernel.is_shared() && 4 * rounds * threads > 5 * pieces {
            let tiling = Tiling::new(shape, kernel.tile(), images, images);
            return Self { tiling, members: parallel::worth_together(pool, elements), ..alone };
        }
        Self { workers: pieces.div_ceil(rounds), ..alone }
    }

    /// What the call needs, with so many numbers for all workers together.
    pub(crate) fn needs(&self, shared: usize) -> Needs {
        let (workers, members) = (self.workers, self.members);
        Needs { workers, members, kernel: self.kernel.scratch_len(), shared }
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

    /// Numbers for packed weights: of a tile for each worker, or of all tiles for all workers.
    pub(crate) fn packed_len(&self) -> usize {
        match self.kernel.packs() {
            false => 0,
            true if self.is_by_tiles() => {
                self.offset(self.lanes_each()).saturating_mul(self.workers)
            }
            true => self.offset(self.shape.lanes),
        }
    }

    /// Whether each worker takes whole tiles; else several share a tile and its packed weight.
    fn is_by_tiles(&self) -> bool {
        self.tiling.tiles().is_multiple_of(self.workers)
    }

    /// Numbers for the sums of all parts.
    pub(crate) fn sums_len(&self) -> usize {
        self.sum_len().saturating_mul(self.parts()).saturating_mul(self.tiling.tiles())
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
        self.run(jobs, weight, true, packed, workers, |piece, y, packed, team| match x {
            Some(x) => self.kernel.forward(self.tiling.images(x, piece), packed, y, team),
            None => self.copied(y, team, |x, y, team| self.kernel.forward(x, packed, y, team)),
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
        let (pieces, with_x) = (self.tiling.pieces(), grad_x.is_some());
        let sums_each = self.sums_len() / pieces;
        let jobs = in_order(pieces, grad_x.map(|g| self.tiling.images_mut(g)))
            .zip(in_order(pieces, sums.map(|sums| sums.chunks_exact_mut(sums_each))));
        let images_each = self.images_each;
        self.run(
            jobs,
            weight,
            with_x,
            packed,
            workers,
            |piece, (grad_x, mut sum), packed, team| {
                if let Some(sum) = &mut sum {
                    team.run(sum.chunks_mut(ADDED_TOGETHER), |sum, _| sum.fill(X::Real::default()));
                }
                let (grad, x) = (self.tiling.images(grad, piece), self.tiling.images(x, piece));
                let pass = Backward { grad, x, packed, grad_x, grad_sum: sum, images_each };
                self.kernel.backward(pass, team);
            },
        );
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
            let len = self.offset(narrow.lanes_each()).min(sum_len);
            let totals = total.chunks_mut(len).enumerate();
            totals
                .zip(narrow.bins_mut(grad_weight))
                .map(move |((index, total), grad_weight)| (total, parts, index * len, grad_weight))
        });
        let add_and_unpack = |job: (&mut [_], _, _, _), team: &mut Team<'_, X::Real>| {
            let (total, parts, start, grad_weight) = job;
            self.add_parts(total, parts, start, team);
            self.kernel.unpack_gradient(total, grad_weight, team);
        };
        if self.shape.lanes <= narrow.lanes_each() {
            let mut team = workers.together();
            return jobs.for_each(|job| add_and_unpack(job, &mut team));
        }
        parallel::run(self.pool, workers.each(), jobs, add_and_unpack);
    }

    /// Adds to `total` what stands at `start` of each of `parts`, one after the other.
    fn add_parts(
        &self,
        total: &mut [X::Real],
        parts: &[X::Real],
        start: usize,
        team: &mut Team<'_, X::Real>,
    ) {
        let chunks = total.chunks_mut(ADDED_TOGETHER).enumerate();
        team.run(chunks, |(index, total), _| {
            for part in parts.chunks_exact(self.sum_len()) {
                add(total, &part[start + index * ADDED_TOGETHER..]);
            }
        });
    }

    /// Runs `work` on each piece, its job and the packed weight of its tile, packed before that if `is_wanted`.
    fn run<J: Send>(
        &self,
        jobs: impl Iterator<Item = J>,
        weight: Weight<'_, X::Real>,
        is_wanted: bool,
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
        work: impl Fn(usize, J, &[X::Real], &mut Team<'_, X::Real>) + Sync,
    ) {
        let packed = match weight {
            Weight::Packed(packed) => packed,
            Weight::Natural(weight) if !self.kernel.packs() => {
                weight.to_slice().expect("a whole weight")
            }
            Weight::Natural(weight) if self.is_by_tiles() => {
                let weight = is_wanted.then_some(weight);
                return self.run_by_tiles(jobs, weight, packed, workers, work);
            }
            Weight::Natural(weight) => {
                if is_wanted {
                    self.pack(weight, packed, workers);
                }
                packed
            }
        };
        parallel::run(self.pool, workers.each(), jobs.enumerate(), |(piece, job), team| {
            let lanes = self.tiling.lanes_of(self.tiling.place_of(piece).0);
            let packed = &packed[self.offset(lanes.start)..];
            let len = self.kernel.packed_len(lanes.len()).min(packed.len());
            work(piece, job, &packed[..len], team);
        });
    }

    /// As [`run`](Self::run), where all pieces of a tile are one worker's: each packs the weights of his tiles where that of the
    /// last one was, in his cache.
    fn run_by_tiles<J: Send>(
        &self,
        mut jobs: impl Iterator<Item = J>,
        weight: Option<ArrayView3<'_, X::Real>>,
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
        work: impl Fn(usize, J, &[X::Real], &mut Team<'_, X::Real>) + Sync,
    ) {
        let parts = self.tiling.parts();
        let tiles = (0..self.tiling.tiles())
            .map(|tile| (tile, jobs.by_ref().take(parts).collect::<Vec<_>>()));
        let rooms = packed.chunks_exact_mut(self.offset(self.lanes_each()));
        let workers = workers.each().zip(rooms);
        parallel::run(self.pool, workers, tiles, |(tile, jobs), (team, packed)| {
            let packed = &mut packed[..self.kernel.packed_len(self.tiling.lanes_of(tile).len())];
            if let Some(weight) = weight {
                self.kernel.pack(self.tiling.bins(weight, tile), packed, team);
            }
            for (part, job) in jobs.into_iter().enumerate() {
                work(tile * parts + part, job, packed, team);
            }
        });
    }

    /// Packs the whole weight, all workers together.
    fn pack(
        &self,
        weight: ArrayView3<'_, X::Real>,
        packed: &mut [X::Real],
        workers: &mut Workers<'_, X::Real>,
    ) {
        let widest = self.kernel.tile().next_multiple_of(self.granule);
        let lanes = self.share_of_lanes().min(widest);
        let tiling = Tiling::new(self.shape, lanes, 1, 1);
        let jobs = packed.chunks_mut(self.offset(lanes)).enumerate();
        parallel::run(self.pool, workers.each(), jobs, |(tile, packed), team| {
            let len = self.kernel.packed_len(tiling.lanes_of(tile).len());
            self.kernel.pack(tiling.bins(weight, tile), &mut packed[..len], team);
        });
    }

    /// Lanes for each worker where they share a weight.
    fn share_of_lanes(&self) -> usize {
        self.shape.lanes.div_ceil(self.granule).div_ceil(self.workers) * self.granule
    }

    /// Where the packed weight of the lanes from `lane` on begins.
    fn offset(&self, lane: usize) -> usize {
        packed_offset(self.kernel, self.granule, lane)
    }

    fn sum_len(&self) -> usize {
        self.offset(self.lanes_each())
    }

    fn lanes_each(&self) -> usize {
        self.tiling.lanes_each().min(self.shape.lanes)
    }

    fn parts(&self) -> usize {
        self.tiling.images_len().div_ceil(self.images_each)
    }
}

/// Where the packed weight of the lanes from `lane` on begins, and ends that of those before.
pub(crate) fn packed_offset<X: Stored>(
    kernel: &dyn Kernel<X>,
    granule: usize,
    lane: usize,
) -> usize {
    lane.div_ceil(granule).saturating_mul(kernel.packed_len(granule))
}

fn add<T: Real>(sums: &mut [T], terms: &[T]) {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum = *sum + *term);
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use ndarray::{Array3, ArrayD, Axis};

    use super::*;
    use crate::fft::Grid;
    use crate::{Gradients, Isa, Layout, Scratch, SpectralFilter, StdThreads};

    /// Threads that take a share of as little work as torch's.
    struct Threads(usize);

    impl Pool for Threads {
        fn threads(&self) -> usize {
            self.0
        }

        fn grain(&self) -> usize {
            1 << 14
        }

        fn run(&self, _: usize, _: &(dyn Fn(usize) + Sync)) {
            unreachable!("nothing is run");
        }
    }

    /// Shapes of the networks, and sizes that no power of two divides.
    const SHAPES: [(Layout, [usize; 3]); 12] = [
        (Layout::Grid, [7, 7, 512]),
        (Layout::Grid, [14, 14, 256]),
        (Layout::Grid, [14, 14, 384]),
        (Layout::Grid, [28, 28, 256]),
        (Layout::Grid, [56, 56, 64]),
        (Layout::Grid, [31, 31, 150]),
        (Layout::Grid, [1, 512, 128]),
        (Layout::Tokens, [1, 196, 128]),
        (Layout::Tokens, [1, 196, 256]),
        (Layout::Tokens, [1, 784, 128]),
        (Layout::Tokens, [1, 784, 256]),
        (Layout::Tokens, [1, 197, 256]),
    ];

    /// Numbers of images that each worker, or each member, is done with at the end, if all numbers take the same time.
    fn loads(batch: &Batch<'_, f32>, shape: Shape) -> Vec<usize> {
        let tiling = batch.tiling;
        let len = |piece| {
            let (tile, part) = tiling.place_of(piece);
            let first = part * tiling.images_each();
            tiling.lanes_of(tile).len() * tiling.images_each().min(tiling.images_len() - first)
        };
        let pieces: Vec<_> = if batch.members > 1 {
            // the passes of the tokens here have 14 or 28 pieces of each of the images that go together
            let images = tiling.images_len().min(batch.members);
            vec![1; images * if shape.rows == 784 { 28 } else { 14 }]
        } else if batch.kernel.packs() && batch.is_by_tiles() {
            (0..tiling.tiles())
                .map(|tile| (0..tiling.parts()).map(|part| len(tile * tiling.parts() + part)).sum())
                .collect()
        } else {
            (0..tiling.pieces()).map(len).collect()
        };
        shared_out(&pieces, batch.workers * batch.members)
    }

    /// Loads of workers who begin with equal shares of neighbouring pieces and then take what is left of the others', as
    /// [`parallel::run`] has them.
    fn shared_out(pieces: &[usize], workers: usize) -> Vec<usize> {
        let bound = |worker| pieces.len() * worker / workers;
        let mut shares: Vec<VecDeque<_>> = (0..workers)
            .map(|i| pieces[bound(i)..bound(i + 1)].iter().copied().collect())
            .collect();
        let mut loads = vec![0; workers];
        let mut working: Vec<_> = (0..workers).collect();
        while let Some(&worker) = working.iter().min_by_key(|worker| loads[**worker]) {
            let next = shares[worker].pop_front();
            let others = (1..workers).map(|i| (worker + i) % workers);
            match next.or_else(|| others.into_iter().find_map(|other| shares[other].pop_back())) {
                Some(piece) => loads[worker] += piece,
                None => working.retain(|other| *other != worker),
            }
        }
        loads
    }

    /// The largest load over the mean, if all threads that are worth it took part in the work.
    fn imbalance(shape: Shape, isa: Isa, (images, summed): (usize, bool), threads: usize) -> f64 {
        let filter = SpectralFilter::<f32>::new(isa, shape);
        let (kernel, pool) = (filter.kernel.as_deref().unwrap(), Threads(threads));
        let granule = kernel.narrowest_tile();
        let batch = Batch::new(shape, kernel, granule, (images, summed), &pool);
        let loads = loads(&batch, shape);
        let elements = images * shape.points() * shape.lanes;
        let worth = match batch.members {
            1 => parallel::worth(&pool, elements),
            _ => parallel::worth_together(&pool, elements),
        };
        let (most, all) = (loads.iter().max().unwrap(), loads.iter().sum::<usize>());
        let pieces = match kernel.is_shared() {
            true => 14 * images,
            false if summed => batch.tiling.parts() * shape.lanes / granule,
            false => images * shape.lanes / granule,
        };
        // with fewer pieces than this no cut is even enough
        if pieces < 4 * worth { 0.0 } else { (most * worth) as f64 / all as f64 }
    }

    #[test]
    fn every_thread_has_its_share_of_the_work() {
        let batches = [1, 2, 3, 8, 32, 100].map(|images| [(images, false), (images, images > 1)]);
        for (layout, dim) in SHAPES {
            let shape = Shape::of_images(layout, &dim).unwrap();
            for isa in Isa::available() {
                for batch in batches.into_iter().flatten() {
                    for threads in [1, 2, 4, 8, 16, 64] {
                        let most = imbalance(shape, isa, batch, threads);
                        let what = format!("{layout:?} {dim:?} {batch:?}, {threads} threads");
                        assert!(most <= 1.25, "{} {what}: {most}", isa.name());
                    }
                }
            }
        }
    }

    /// Few images with a gradient of the weight, and few without.
    #[test]
    fn small_batches_occupy_many_threads() {
        let isa = *Isa::available().last().unwrap();
        for (layout, dim, images, threads) in [
            (Layout::Tokens, [1, 196, 256], 8, 16),
            (Layout::Tokens, [1, 784, 256], 8, 16),
            (Layout::Tokens, [1, 784, 256], 1, 8),
            (Layout::Grid, [14, 14, 256], 8, 16),
            (Layout::Grid, [28, 28, 256], 2, 16),
        ] {
            let shape = Shape::of_images(layout, &dim).unwrap();
            for summed in [false, images > 1] {
                let filter = SpectralFilter::<f32>::new(isa, shape);
                let (kernel, pool) = (filter.kernel.as_deref().unwrap(), Threads(threads));
                let granule = kernel.narrowest_tile();
                let batch = Batch::new(shape, kernel, granule, (images, summed), &pool);
                assert_eq!(loads(&batch, shape).len(), threads, "{layout:?} {dim:?} {images}");
            }
        }
    }

    /// A kernel that counts the lanes whose weight it packs.
    struct Counting<'a>(&'a dyn Kernel<f32>, AtomicUsize);

    impl Kernel<f32> for Counting<'_> {
        fn tile(&self) -> usize {
            self.0.tile()
        }

        fn narrowest_tile(&self) -> usize {
            self.0.narrowest_tile()
        }

        fn packed_len(&self, lanes: usize) -> usize {
            self.0.packed_len(lanes)
        }

        fn scratch_len(&self) -> usize {
            self.0.scratch_len()
        }

        fn pack(&self, weight: ArrayView3<'_, f32>, packed: &mut [f32], team: &mut Team<'_, f32>) {
            self.1.fetch_add(weight.len_of(Axis(1)), Ordering::Relaxed);
            self.0.pack(weight, packed, team);
        }

        fn forward(
            &self,
            x: ArrayView3<'_, f32>,
            packed: &[f32],
            y: ArrayViewMut3<'_, f32>,
            team: &mut Team<'_, f32>,
        ) {
            self.0.forward(x, packed, y, team);
        }

        fn backward(&self, pass: Backward<'_, f32>, team: &mut Team<'_, f32>) {
            self.0.backward(pass, team);
        }

        fn unpack_gradient(
            &self,
            grad_sum: &[f32],
            grad_weight: ArrayViewMut3<'_, f32>,
            team: &mut Team<'_, f32>,
        ) {
            self.0.unpack_gradient(grad_sum, grad_weight, team);
        }
    }

    #[test]
    fn a_weight_is_packed_once_for_all_threads() {
        let shape = Shape::of_images(Layout::Grid, &[14, 14, 300]).unwrap();
        let (x, weight) = (Array3::zeros((9, 196, 300)), Array3::zeros((112, 300, 2)));
        for isa in Isa::available() {
            let filter = SpectralFilter::<f32>::new(isa, shape);
            for threads in [1, 2, 3, 16] {
                let kernel = Counting(filter.kernel.as_deref().unwrap(), AtomicUsize::new(0));
                let (granule, pool) = (kernel.narrowest_tile(), StdThreads(threads));
                let batch = Batch::new(shape, &kernel, granule, (9, false), &pool);
                let mut scratch = Scratch::default();
                let needs = batch.needs(batch.packed_len());
                let (mut workers, packed) = scratch.lend(&pool, needs).unwrap();
                let mut y = x.clone();
                let natural = Weight::Natural(weight.view());
                batch.forward((Some(x.view()), y.view_mut()), natural, packed, &mut workers);
                assert_eq!(kernel.1.into_inner(), 300);
            }
        }
    }

    /// Gradient of the weight of a grid, as planned for cores with `cache` bytes of L2 cache.
    fn weight_gradient(isa: Isa, shape: Shape, cache: usize, threads: usize) -> ArrayD<f32> {
        let kernel = Arc::new(Grid::tuned(isa, shape, cache));
        let filter = SpectralFilter { isa, shape, kernel: Some(kernel) };
        let dim = [32, shape.rows, shape.columns, shape.lanes];
        let number = |i: usize| (i as f32 * 12.9898).sin();
        let images = |from| {
            let numbers = (from..).map(number).take(dim.iter().product()).collect();
            ArrayD::from_shape_vec(dim.to_vec(), numbers).unwrap()
        };
        let (x, grad, weight) = (images(0), images(7), ArrayD::zeros(shape.weight()));
        let mut grad_weight = weight.clone();
        let gradients = Gradients { x: None, weight: Some(grad_weight.view_mut()) };
        let scratch = &mut Scratch::default();
        let pool = StdThreads(threads);
        filter.backward(grad.view(), x.view(), weight.view(), gradients, &pool, scratch).unwrap();
        grad_weight
    }

    #[test]
    fn the_order_of_a_sum_does_not_depend_on_the_size_of_a_cache() {
        for lanes in [40, 260] {
            let shape = Shape::of_images(Layout::Grid, &[14, 14, lanes]).unwrap();
            for isa in Isa::available() {
                let expected = weight_gradient(isa, shape, 1 << 20, 1);
                for (cache, threads) in [(1 << 16, 1), (1 << 18, 2), (1 << 22, 1), (1 << 24, 3)] {
                    assert_eq!(weight_gradient(isa, shape, cache, threads), expected);
                }
            }
        }
    }
}
