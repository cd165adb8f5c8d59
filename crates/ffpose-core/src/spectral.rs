//! The learnable spectral filter `y = irfft2(rfft2(x) · W)`, forward and backward.
//!
//! Same numbers as `torch.fft.rfft2`/`irfft2` with their default norm. `irfft2` ignores what is not Hermitian in the
//! column of DC and, when the second axis is even, in that of Nyquist: a learned weight acts there as
//! `(W(u) + conj W(-u)) / 2`. Source: Ye et al., Sensors 2023, 23(20), 8633, Eq. 1-3; the grid layout is `GFNet`'s.
//!
//! This file checks shapes, hands out jobs and adds up in a fixed order; the transforms are [`Kernel`]s.

use std::sync::Arc;

use ndarray::{ArrayView3, ArrayViewD, ArrayViewMut3, ArrayViewMutD, Axis, Dimension};

use crate::fft::Batched;
use crate::general::General;
use crate::kernel::{Backward, Kernel, Single, SingleBackward};
use crate::number::Number;
use crate::parallel::{self, Pool};
use crate::scratch::{self, Needs, Scratch, Worker};
use crate::tiling::Tiling;
use crate::widened::Widened;
use crate::{Error, Isa, Layout, Real, Shape, fft, plans};

const BATCH: Axis = Axis(0);

/// More bytes than the tables of a plan take for each number of a plane's half spectrum.
const BYTES_A_BIN: usize = 64;

/// A spectral filter for images of one shape: planned once, run on any batch with any weight.
///
/// Arrays are C-contiguous. `x`, `y` and their gradients are `(..., X, Y)` or `(..., H, W, C)`, with any number of
/// leading axes; `weight` and its gradient are `(X, Y/2+1, 2)` or `(H, W/2+1, C, 2)`, real and imaginary parts last.
/// Elements are `T`, or half precision where `T` is `f32`: computed in `f32`, each result rounded once.
/// Results are bit-identical for any number of threads, and `y` and the gradient of `x` for any split of the batch.
#[derive(Clone)]
pub struct SpectralFilter<T> {
    isa: Isa,
    shape: Shape,
    /// None for images without elements, which have no transform.
    kernel: Option<Arc<dyn Kernel<T>>>,
}

/// Where the gradients of a backward pass go, if they are wanted.
#[derive(Debug)]
pub struct Gradients<'a, X, W> {
    /// Gradient with respect to `x`: `irfft2(rfft2(grad) · conj W)`.
    pub x: Option<ArrayViewMutD<'a, X>>,
    /// Gradient with respect to the weight, summed over the batch.
    pub weight: Option<ArrayViewMutD<'a, W>>,
}

/// The arguments of a backward pass, checked: images `(batch, points, lanes)`, weights `(bins, lanes, 2)`.
struct Pass<'a, X, W> {
    grad: ArrayView3<'a, X>,
    x: ArrayView3<'a, X>,
    weight: ArrayView3<'a, W>,
    grad_x: Option<ArrayViewMut3<'a, X>>,
    grad_weight: Option<ArrayViewMut3<'a, W>>,
}

impl<T: Real> SpectralFilter<T> {
    /// Plans the transform of images of one shape, for one instruction set.
    #[must_use]
    pub fn new(isa: Isa, shape: Shape) -> Self {
        let kernel = (!shape.is_empty()).then(|| T::plan(isa, shape));
        Self { isa, shape, kernel }
    }

    /// The plan for a shape, made at its first use and kept for the next, on any thread.
    ///
    /// # Errors
    /// [`Error::Isa`] as [`Isa::current`]; [`Error::Memory`] if there is no room for a plan.
    pub fn planned(shape: Shape) -> Result<Self, Error> {
        let isa = Isa::current()?;
        plans::kept(shape, || {
            scratch::check_room(shape.bins_len().saturating_mul(BYTES_A_BIN))?;
            Ok(Self::new(isa, shape))
        })
    }

    /// Filters `x` with `weight` into `y`, of the shape of `x`, on threads of `pool`.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Strides`] or [`Error::Memory`]; `y` is then untouched.
    pub fn forward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        x: ArrayViewD<'_, X>,
        weight: ArrayViewD<'_, W>,
        y: ArrayViewMutD<'_, X>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let like_x = x.raw_dim();
        let x = self.shape.images("x", like_x.slice(), x)?;
        let y = self.shape.images_mut("y", like_x.slice(), y)?;
        let weight = self.shape.bins("weight", weight)?;
        let Some(kernel) = self.kernel.as_deref().filter(|_| !x.is_empty()) else {
            return Ok(());
        };

        let widened = Widened::new(self.isa, self.shape, kernel);
        let kernel = X::kernel(kernel, &widened);
        let threads = parallel::worth(pool, x.len());
        let tiling = self.tiling(kernel, x.dim().0, Some(threads));
        let needs = needs(kernel, (pool, x.len()), &tiling, widened_len::<W>(weight.len()));
        let (mut workers, wide_weight) = scratch.lend(pool, needs)?;
        let weight = W::read(self.isa, weight, wide_weight);
        let jobs = tiling.images_mut(y).enumerate();
        parallel::run(pool, workers.each(), jobs, |(piece, y), worker| {
            let Worker { packed, team } = worker;
            let (weight, x) = (tiling.bins(weight, tiling.tile_of(piece)), tiling.images(x, piece));
            match kernel.single() {
                Some(single) if x.dim().0 == 1 => {
                    let (x, y) = (x.index_axis_move(BATCH, 0), y.index_axis_move(BATCH, 0));
                    single.forward(x, weight, y, team);
                }
                _ => {
                    kernel.pack(weight, packed, team);
                    kernel.forward(x, packed, y, team);
                }
            }
        });
        Ok(())
    }

    /// Writes the gradients that are wanted, given `grad`, the gradient of `y`.
    ///
    /// The weight's gradient is `c_v / N · Σ_b conj(X_b) · G_b` with N points in a plane and `c_v` = 1 in the columns
    /// of DC and Nyquist, 2 between them: what autograd gives for the real tensor of parts. The order of the sum
    /// follows from shapes alone, never from `pool`.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Strides`] or [`Error::Memory`]; the gradients are then untouched.
    pub fn backward<'a, X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        grad: ArrayViewD<'a, X>,
        x: ArrayViewD<'a, X>,
        weight: ArrayViewD<'a, W>,
        gradients: Gradients<'a, X, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let mut pass = self.pass(grad, x, weight, gradients)?;
        let Some(kernel) = self.kernel.as_deref().filter(|_| !pass.x.is_empty()) else {
            pass.grad_weight.iter_mut().for_each(|grad| grad.fill(W::default()));
            return Ok(());
        };
        let widened = Widened::new(self.isa, self.shape, kernel);
        let kernel = X::kernel(kernel, &widened);
        match kernel.single() {
            Some(single) if pass.x.dim().0 == 1 => {
                self.run_single_backward(kernel, single, pass, pool, scratch)
            }
            _ => self.run_backward(kernel, pass, pool, scratch),
        }
    }

    /// Checks the arguments of a backward pass.
    fn pass<'a, X: Number, W: Number>(
        &self,
        grad: ArrayViewD<'a, X>,
        x: ArrayViewD<'a, X>,
        weight: ArrayViewD<'a, W>,
        gradients: Gradients<'a, X, W>,
    ) -> Result<Pass<'a, X, W>, Error> {
        let (shape, dim) = (self.shape, x.raw_dim());
        let like_x = dim.slice();
        Ok(Pass {
            x: shape.images("x", like_x, x)?,
            grad: shape.images("grad", like_x, grad)?,
            weight: shape.bins("weight", weight)?,
            grad_x: gradients.x.map(|g| shape.images_mut("grad_x", like_x, g)).transpose()?,
            grad_weight: gradients.weight.map(|g| shape.bins_mut("grad_weight", g)).transpose()?,
        })
    }

    fn run_backward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        kernel: &dyn Kernel<X>,
        pass: Pass<'_, X, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let Pass { grad, x, weight, grad_x, grad_weight } = pass;
        let threads = parallel::worth(pool, x.len());
        let summed = grad_weight.is_some();
        let tiling = self.tiling(kernel, x.dim().0, (!summed).then_some(threads));
        let packed_len = kernel.packed_len(tiling.lanes_each());
        let sums = if summed { tiling.pieces().saturating_mul(packed_len) } else { 0 };
        let shared = sums.saturating_add(widened_len::<W>(weight.len()));
        let needs = needs(kernel, (pool, x.len()), &tiling, shared);
        let (mut workers, shared) = scratch.lend(pool, needs)?;
        let (sums, wide_weight) = shared.split_at_mut(sums);
        let weight = W::read(self.isa, weight, wide_weight);
        let jobs = in_order(tiling.pieces(), grad_x.map(|g| tiling.images_mut(g)))
            .zip(in_order(tiling.pieces(), summed.then(|| sums.chunks_exact_mut(packed_len))))
            .enumerate();
        parallel::run(pool, workers.each(), jobs, |(piece, (grad_x, mut grad_sum)), worker| {
            let Worker { packed, team } = worker;
            if let Some(sum) = &mut grad_sum {
                sum.fill(T::default());
            }
            if grad_x.is_some() {
                kernel.pack(tiling.bins(weight, tiling.tile_of(piece)), packed, team);
            }
            let (grad, x) = (tiling.images(grad, piece), tiling.images(x, piece));
            kernel.backward(Backward { grad, x, packed, grad_x, grad_sum }, team);
        });
        if let Some(grad_weight) = grad_weight {
            let (totals, parts) = sums.split_at_mut(tiling.tiles() * packed_len);
            let parts = parts.chunks_exact(totals.len());
            W::write(self.isa, grad_weight, wide_weight, |grad_weight| {
                let totals = totals.chunks_exact_mut(packed_len).enumerate();
                let jobs = totals.zip(tiling.bins_mut(grad_weight));
                parallel::run(
                    pool,
                    workers.each(),
                    jobs,
                    |((tile, total), grad_weight), worker| {
                        for part in parts.clone() {
                            add(total, &part[tile * packed_len..][..packed_len]);
                        }
                        kernel.unpack_gradient(total, grad_weight, &mut worker.team);
                    },
                );
            });
        }
        Ok(())
    }

    /// As [`run_backward`](Self::run_backward), for a batch of one image: every tile has its own part of the gradients.
    fn run_single_backward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        kernel: &dyn Kernel<X>,
        single: &dyn Single<X>,
        pass: Pass<'_, X, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let Pass { grad, x, weight, grad_x, grad_weight } = pass;
        let threads = parallel::worth(pool, x.len());
        let tiling = self.tiling(kernel, 1, Some(threads));
        let bins_len = widened_len::<W>(weight.len());
        let needs = needs(kernel, (pool, x.len()), &tiling, 2 * bins_len);
        let (mut workers, shared) = scratch.lend(pool, needs)?;
        let (wide_weight, wide_grad_weight) = shared.split_at_mut(bins_len);
        let weight = W::read(self.isa, weight, wide_weight);
        let run = |grad_weight: Option<ArrayViewMut3<'_, T>>| {
            let jobs = in_order(tiling.pieces(), grad_x.map(|g| tiling.images_mut(g)))
                .zip(in_order(tiling.pieces(), grad_weight.map(|g| tiling.bins_mut(g))))
                .enumerate();
            parallel::run(pool, workers.each(), jobs, |(piece, (grad_x, grad_weight)), worker| {
                let pass = SingleBackward {
                    grad: tiling.images(grad, piece).index_axis_move(BATCH, 0),
                    x: tiling.images(x, piece).index_axis_move(BATCH, 0),
                    weight: tiling.bins(weight, piece),
                    grad_x: grad_x.map(|grad_x| grad_x.index_axis_move(BATCH, 0)),
                    grad_weight,
                };
                single.backward(pass, &mut worker.team);
            });
        };
        match grad_weight {
            Some(grad) => W::write(self.isa, grad, wide_grad_weight, |grad| run(Some(grad))),
            None => run(None),
        }
        Ok(())
    }

    /// Pieces that let `threads` share the work evenly: parts of the batch, or narrower tiles of one image. Without
    /// threads, pieces that follow from shapes.
    fn tiling<X: Number<Real = T>>(
        &self,
        kernel: &dyn Kernel<X>,
        images: usize,
        threads: Option<usize>,
    ) -> Tiling {
        let lanes = self.shape.lanes;
        if let (1, Some(single), Some(threads)) = (images, kernel.single(), threads) {
            let tile = even_tile(lanes, single.narrowest_tile(), kernel.tile(), threads);
            return Tiling::new(self.shape, tile, (1, 1), 1);
        }
        let together = kernel.images_together();
        let groups = images.div_ceil(together);
        let tiling = |tile| {
            let tiles = lanes.div_ceil(tile);
            let parts = threads.map_or_else(|| sum_parts(tiles, groups), |n| even_parts(tiles, n));
            Tiling::new(self.shape, tile, (images, together), parts.min(groups))
        };
        let wide = tiling(kernel.tile());
        let is_enough = wide.pieces() >= threads.unwrap_or(SUM_PIECES);
        if is_enough { wide } else { tiling(kernel.narrow_tile()) }
    }
}

/// The kernel for a shape: vectors across its lines, unless these would leave half of every vector empty. Then across several
/// images, or, measured with AVX2, rustfft along the lines is two to six times faster, and else two to fourteen times slower.
pub(crate) fn plan_kernel<T: Real>(isa: Isa, shape: Shape) -> Arc<dyn Kernel<T>> {
    let lines = match shape.layout {
        Layout::Tokens => shape.rows,
        Layout::Grid => shape.lanes,
    };
    if is_batched(isa.lanes::<T>(), shape) {
        Arc::new(Batched::new(isa, shape))
    } else if 2 * lines <= isa.lanes::<T>() {
        Arc::new(General::new(shape))
    } else {
        fft::plan(isa, shape)
    }
}

/// Whether images are filtered several together in vectors of so many lanes. One alone takes as long as all of them, so that
/// large ones are not: of sequences up to these lengths a batch of 32 was measured at 3 to 5 times the speed of rustfft along the
/// lines, a single one of the longest at half of it.
fn is_batched(lanes: usize, shape: Shape) -> bool {
    const POINTS: usize = 1 << 10; // of a plane, for each channel
    const SEQUENCE: usize = 1 << 12; // the same of a sequence, and of tokens
    let Shape { layout, rows, columns, lanes: channels } = shape;
    match layout {
        // two columns fill a small part of the vectors across them
        Layout::Tokens => lanes > 2 && columns <= 2 && rows <= SEQUENCE,
        Layout::Grid if rows == 1 => channels < lanes && columns <= SEQUENCE * channels,
        Layout::Grid => channels < lanes && rows * columns <= POINTS * channels,
    }
}

/// Lanes of a tile, from `least` to `most` (`most` if `least` is more), with which `threads` are done soonest with one image
/// of so many lanes.
fn even_tile(lanes: usize, least: usize, most: usize, threads: usize) -> usize {
    if threads == 1 {
        return most;
    }
    let tiles = (1..=most / least).rev().map(|steps| steps * least);
    // a tile takes the time of its lanes and, measured, of a third of `least` besides
    let time = |tile: &usize| lanes.div_ceil(*tile).div_ceil(threads) * (3 * tile + least);
    tiles.min_by_key(time).unwrap_or(most)
}

/// Parts that let `threads` share `tiles` of each evenly; many tiles do without.
fn even_parts(tiles: usize, threads: usize) -> usize {
    let even = (1..threads).find(|parts| (tiles * parts).is_multiple_of(threads));
    if tiles >= 8 * threads { 1 } else { even.unwrap_or(threads) }
}

/// Pieces of a gradient's sum that are enough for threads.
const SUM_PIECES: usize = 8;

/// Parts in which a gradient is summed over `images`: few tiles leave too little work for threads, so that parts of about
/// four images or more, as many as make enough pieces, are summed apart and then added.
fn sum_parts(tiles: usize, images: usize) -> usize {
    images.div_ceil(images.div_ceil((SUM_PIECES / tiles).max(1)).max(4))
}

fn add<T: Real>(sums: &mut [T], terms: &[T]) {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum = *sum + *term);
}

/// The items in `Some`, or `None` for each of `len`.
fn in_order<I: Iterator>(len: usize, items: Option<I>) -> impl Iterator<Item = Option<I::Item>> {
    let absent = if items.is_some() { 0 } else { len };
    items.into_iter().flatten().map(Some).chain((0..absent).map(|_| None))
}

/// Numbers in the copy of `len` elements in a wider type, if there is one.
fn widened_len<N: Number>(len: usize) -> usize {
    if N::HALF { len } else { 0 }
}

/// What a call on so many elements in such pieces needs. A single piece is for all threads together, if the kernel shares it.
fn needs<X: Number>(
    kernel: &dyn Kernel<X>,
    (pool, elements): (&dyn Pool, usize),
    tiling: &Tiling,
    shared: usize,
) -> Needs {
    let packed = kernel.packed_len(tiling.lanes_each());
    let (workers, members) = match tiling.pieces() {
        1 if kernel.is_shared() => (1, parallel::worth_together(pool, elements)),
        pieces => (parallel::worth(pool, elements).min(pieces), 1),
    };
    Needs { workers, members, packed, kernel: kernel.scratch_len(), shared }
}
