//! Pieces share work evenly, weights are packed once, and sums have one order.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array3, ArrayD};

use super::*;
use crate::kernel::{Factor, Packing};
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
const SHAPES: [(Layout, [usize; 3]); 11] = [
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
    } else if batch.kernel.packing().is_some() && batch.is_by_tiles() {
        (0..tiling.tiles())
            .map(|tile| (0..tiling.parts()).map(|part| len(tile * tiling.parts() + part)).sum())
            .collect()
    } else {
        (0..tiling.pieces()).map(len).collect()
    };
    shared_out(&pieces, batch.workers * batch.members)
}

/// Loads of workers who begin with equal shares of neighboring pieces and then take what is left of the others', as
/// [`parallel::run`] has them.
fn shared_out(pieces: &[usize], workers: usize) -> Vec<usize> {
    let bound = |worker| pieces.len() * worker / workers;
    let mut shares: Vec<VecDeque<_>> =
        (0..workers).map(|i| pieces[bound(i)..bound(i + 1)].iter().copied().collect()).collect();
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
    let (kernel, pool) = (filter.plan.as_deref().unwrap().kernel(), Threads(threads));
    let granule = kernel.narrowest_tile();
    let batch = Batch::new(shape, kernel, granule, (images, summed), &pool, filter.tuning);
    let loads = loads(&batch, shape);
    let elements = images * shape.points() * shape.lanes;
    let worth = match batch.members {
        1 => parallel::worth(&pool, elements),
        _ => parallel::worth_together(&pool, elements),
    };
    let (most, all) = (loads.iter().max().unwrap(), loads.iter().sum::<usize>());
    let pieces = match kernel.shares(images) {
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
            let (kernel, pool) = (filter.plan.as_deref().unwrap().kernel(), Threads(threads));
            let granule = kernel.narrowest_tile();
            let batch = Batch::new(shape, kernel, granule, (images, summed), &pool, filter.tuning);
            assert_eq!(loads(&batch, shape).len(), threads, "{layout:?} {dim:?} {images}");
        }
    }
}

#[test]
fn tiles_are_whole_cache_lines_of_half_precision() {
    for isa in Isa::available().into_iter().filter(|isa| isa.has_vectors::<f32>()) {
        for (side, lanes) in [(7, 17), (7, 512), (7, 5000), (14, 129), (14, 384), (28, 600)] {
            let shape = Shape { layout: Layout::Grid, rows: side, columns: side, lanes };
            let plan = crate::fft::Plan::new(isa, shape, Tuning::of_machine());
            let (tile, narrowest) =
                (plan.kernel::<f32>().tile(), plan.kernel::<crate::Bf16>().narrowest_tile());
            for tile in [tile, narrowest] {
                assert_eq!(tile * size_of::<crate::Bf16>() % LINE_BYTES, 0, "{tile} of {lanes}");
            }
        }
    }
}

/// A kernel that counts the lanes whose weight it packs.
struct Counting<'a>(&'a dyn Kernel<f32>, AtomicUsize);

impl Packing<f32> for Counting<'_> {
    fn packed_len(&self, lanes: usize) -> usize {
        self.0.packing().unwrap().packed_len(lanes)
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, f32>,
        lanes: Range<usize>,
        factor: Factor,
        packed: &mut [f32],
        team: &mut Team<'_, f32>,
    ) {
        self.1.fetch_add(lanes.len(), Ordering::Relaxed);
        self.0.packing().unwrap().pack(weight, lanes, factor, packed, team);
    }
}

impl Kernel<f32> for Counting<'_> {
    fn tile(&self) -> usize {
        self.0.tile()
    }

    fn narrowest_tile(&self) -> usize {
        self.0.narrowest_tile()
    }

    fn scratch_len(&self, members: usize) -> usize {
        self.0.scratch_len(members)
    }

    fn packing(&self) -> Option<&dyn Packing<f32>> {
        Some(self)
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.0.sum_len(lanes)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, f32>,
        weight: &[f32],
        y: ArrayViewMut3<'_, f32>,
        team: &mut Team<'_, f32>,
    ) {
        self.0.forward(x, weight, y, team);
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
            let kernel = Counting(filter.plan.as_deref().unwrap().kernel(), AtomicUsize::new(0));
            let (granule, pool) = (kernel.narrowest_tile(), StdThreads(threads));
            let batch = Batch::new(shape, &kernel, granule, (9, false), &pool, filter.tuning);
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
    let tuning = Tuning { l2_cache: cache, ..*Tuning::of_machine() };
    let filter = SpectralFilter::<f32>::tuned(isa, shape, tuning.kept());
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
    for dim in [[14, 14, 40], [14, 14, 260], [14, 14, 3], [1, 49, 5], [1, 50, 1]] {
        let shape = Shape::of_images(Layout::Grid, &dim).unwrap();
        for isa in Isa::available() {
            let expected = weight_gradient(isa, shape, 1 << 20, 1);
            for (cache, threads) in [(1 << 16, 1), (1 << 18, 2), (1 << 22, 1), (1 << 24, 3)] {
                assert_eq!(weight_gradient(isa, shape, cache, threads), expected);
            }
        }
    }
}

/// Sums in the order that [`SpectralFilter::backward`] tells, of images that go `together`: planes of one point, whose spectrum is
/// the point, so that every rounding is one of the sum.
fn summed_in_order(points: &[f32], together: usize) -> f32 {
    let parts = 8.min(points.len().div_ceil(4));
    let each = points.len().div_ceil(parts).next_multiple_of(together);
    let mut totals = vec![0.0; together];
    for part in points.chunks(each) {
        let mut sums = vec![0.0; together];
        for group in part.chunks(together) {
            sums.iter_mut().zip(group).for_each(|(sum, point)| *sum += point);
        }
        totals.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    totals.into_iter().reduce(|total, sum| total + sum).unwrap()
}

#[test]
fn the_order_of_a_sum_follows_from_shape_and_lanes() {
    let number = |i: usize| (i as f32 * 12.9898).sin() * [1.0, 1e4, 1e-3][i % 3];
    for (channels, images) in [(1, 37), (1, 100), (2, 37), (3, 37), (3, 64), (5, 23), (7, 32)] {
        let shape = Shape::of_images(Layout::Grid, &[1, 1, channels]).unwrap();
        let dim = vec![images, 1, 1, channels];
        let x = ArrayD::from_elem(dim.clone(), 1.0);
        let numbers: Vec<f32> = (0..images * channels).map(number).collect();
        let grad = ArrayD::from_shape_vec(dim, numbers).unwrap();
        for isa in Isa::available() {
            let filter = SpectralFilter::<f32>::new(isa, shape);
            let expected: Vec<f32> = (0..channels)
                .map(|c| {
                    let points: Vec<f32> = grad.iter().copied().skip(c).step_by(channels).collect();
                    summed_in_order(&points, (isa.lanes::<f32>() / channels).max(1))
                })
                .collect();
            for threads in [1, 2, 5] {
                let weight = ArrayD::zeros(shape.weight());
                let mut grad_weight = weight.clone();
                let gradients = Gradients { x: None, weight: Some(grad_weight.view_mut()) };
                let (pool, scratch) = (StdThreads(threads), &mut Scratch::default());
                filter
                    .backward(grad.view(), x.view(), weight.view(), gradients, &pool, scratch)
                    .unwrap();
                let got: Vec<f32> = grad_weight.iter().copied().step_by(2).collect();
                assert_eq!(got, expected, "{} {channels} {images}", isa.name());
            }
        }
    }
}
