//! The learnable spectral filter `y = irfft2(rfft2(x) · W)`, forward and backward.
//!
//! Same numbers as `torch.fft.rfft2`/`irfft2` with their default norm. `irfft2` ignores what is not Hermitian in the
//! column of DC and, when the second axis is even, in that of Nyquist: a learned weight acts there as
//! `(W(u) + conj W(-u)) / 2`. Source: Ye et al., Sensors 2023, 23(20), 8633, Eq. 1-3; the grid layout is `GFNet`'s.
//!
//! This file checks shapes, hands out jobs and adds up in a fixed order; the transforms are [`crate::kernel`]s.

mod batch;
mod plans;
mod prepared;
mod tiling;

use std::sync::Arc;

use ndarray::{ArrayView3, ArrayViewD, ArrayViewMut3, ArrayViewMutD, Dimension};

use self::batch::{Batch, Images, Weight};
use crate::fft::{Plan, Planned};
use crate::kernel::{Single, SingleBackward};
use crate::number::{self, Number};
use crate::parallel::{self, Pool, Team};
use crate::scratch::{self, Scratch};
use crate::tuning::Tuning;
use crate::views::{BATCH, in_order};
use crate::{Error, Isa, Real, Shape};

pub use self::prepared::Prepared;

/// More bytes than a plan takes for each number of a plane's half spectrum, and for each of the lengths that are transformed; for
/// large primes these are tables of convolutions, which are made where nothing can fail.
const BYTES_A_BIN: usize = 64;
const BYTES_A_POINT: usize = 512;

/// A spectral filter for images of one shape: planned once, run on any batch with any weight.
///
/// Arrays are C-contiguous. `x`, `y` and their gradients are `(..., X, Y)` or `(..., H, W, C)`, with any number of
/// leading axes; `weight` and its gradient are `(X, Y/2+1, 2)` or `(H, W/2+1, C, 2)`, real and imaginary parts last.
/// Elements are `T`, or half precision where `T` is `f32`: computed in `f32`, each result rounded once.
/// Results are bit-identical for any number of threads, and `y` and the gradient of `x` for any split of the batch.
#[derive(Clone)]
pub struct SpectralFilter<T: Real> {
    isa: Isa,
    shape: Shape,
    tuning: &'static Tuning,
    /// None for images without elements, which have no transform.
    plan: Option<Arc<Plan<T>>>,
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
struct BackwardCall<'a, X, W> {
    grad: ArrayView3<'a, X>,
    x: ArrayView3<'a, X>,
    weight: ArrayView3<'a, W>,
    grad_x: Option<ArrayViewMut3<'a, X>>,
    grad_weight: Option<ArrayViewMut3<'a, W>>,
}

impl<T: Planned> SpectralFilter<T> {
    /// Plans the transform of images of one shape, for one instruction set.
    #[must_use]
    pub fn new(isa: Isa, shape: Shape) -> Self {
        Self::tuned(isa, shape, Tuning::of_machine())
    }

    /// As [`new`](Self::new), for another machine than this one.
    fn tuned(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Self {
        let plan = (!shape.is_empty()).then(|| Arc::new(T::plan(isa, shape, tuning)));
        Self { isa, shape, tuning, plan }
    }

    /// The plan for a shape, made at its first use and kept for the next, on any thread. A bound on bytes holds for all that are
    /// kept ([`PLANS_KEPT`](crate::tuning::PLANS_KEPT)): a plan larger than that is made again for each call.
    ///
    /// # Errors
    /// [`Error::Isa`] as [`Isa::current`]; [`Error::Memory`] if there is no room for a plan.
    pub fn planned(shape: Shape) -> Result<Self, Error> {
        let isa = Isa::current()?;
        let bytes = plan_bytes(shape);
        plans::kept(shape, bytes, || {
            scratch::check_room(bytes)?;
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
        let (x, y) = self.images(x, y)?;
        self.run_forward(Some(x), y, weight, pool, scratch)
    }

    /// As [`forward`](Self::forward), with the same bits, to where the images are.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Strides`] or [`Error::Memory`]; the images are then untouched.
    pub fn forward_in_place<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        images: ArrayViewMutD<'_, X>,
        weight: ArrayViewD<'_, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let dim = images.raw_dim();
        let images = self.shape.images("x", dim.slice(), images)?;
        self.run_forward(None, images, weight, pool, scratch)
    }

    /// Filters `x` into `y`, or `y` in place.
    fn run_forward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        x: Option<ArrayView3<'_, X>>,
        y: ArrayViewMut3<'_, X>,
        weight: ArrayViewD<'_, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let weight = self.shape.bins("weight", weight)?;
        let Some(plan) = self.plan.as_deref().filter(|_| !y.is_empty()) else {
            return Ok(());
        };
        let granule = T::kernel(plan).narrowest_tile();
        let kernel = X::kernel_of(plan);
        let single = kernel.single().filter(|_| y.dim().0 == 1);
        let batch = Batch::new(self.shape, kernel, granule, (y.dim().0, false), pool, self.tuning);
        let packed_len = if single.is_some() { 0 } else { batch.packed_len() };
        let shared = packed_len.saturating_add(widened_len::<W>(weight.len()));
        let needs = if x.is_some() { batch.needs(shared) } else { batch.needs_in_place(shared) };
        let (mut workers, shared) = scratch.lend(pool, needs)?;
        let (packed, wide_weight) = shared.split_at_mut(packed_len);
        let weight = number::read(self.isa, weight, wide_weight);
        let Some(single) = single else {
            batch.forward((x, y), Weight::Natural(weight), packed, &mut workers);
            return Ok(());
        };
        let tiling = batch.tiling;
        let jobs = tiling.images_mut(y).enumerate();
        parallel::run(pool, workers.each(), jobs, |(tile, y), team| {
            let filter = |x: ArrayView3<'_, X>, y: ArrayViewMut3<'_, X>, team: &mut Team<'_, T>| {
                let (x, y) = (x.index_axis_move(BATCH, 0), y.index_axis_move(BATCH, 0));
                single.forward(x, tiling.bins(weight, tile), y, team);
            };
            match x {
                Some(x) => filter(tiling.images(x, tile), y, team),
                None => batch.copied(y, team, filter),
            }
        });
        Ok(())
    }

    /// Writes the gradients that are wanted, given `grad`, the gradient of `y`.
    ///
    /// The weight's gradient is `c_v / N · Σ_b conj(X_b) · G_b` with N points in a plane and `c_v` = 1 in the columns
    /// of DC and Nyquist, 2 between them: what autograd gives for the real tensor of parts. The order of the sum
    /// follows from the shapes and, where images of few channels fill vectors together, from the lanes of the instruction set:
    /// image by image within a part of the batch, of those that lie in the same lanes; part by part; then across the lanes. It
    /// never follows from `pool`, or from the caches. Processors of other instruction sets round, and may sum, differently.
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
        let Some(plan) = self.plan.as_deref().filter(|_| !pass.x.is_empty()) else {
            pass.grad_weight.iter_mut().for_each(|grad| grad.fill(W::default()));
            return Ok(());
        };
        if pass.grad_x.is_none() && pass.grad_weight.is_none() {
            return Ok(());
        }
        let granule = T::kernel(plan).narrowest_tile();
        let kernel = X::kernel_of(plan);
        let images = pass.x.dim().0;
        let single = kernel.single().filter(|_| images == 1);
        let summed = single.is_none() && pass.grad_weight.is_some();
        let batch = Batch::new(self.shape, kernel, granule, (images, summed), pool, self.tuning);
        match single {
            Some(single) => self.run_single_backward(&batch, single, pass, pool, scratch),
            None => self.run_backward(&batch, pass, pool, scratch),
        }
    }

    /// Checks the images of a forward pass.
    pub(crate) fn images<'a, X>(
        &self,
        x: ArrayViewD<'a, X>,
        y: ArrayViewMutD<'a, X>,
    ) -> Result<(ArrayView3<'a, X>, ArrayViewMut3<'a, X>), Error> {
        let dim = x.raw_dim();
        let x = self.shape.images("x", dim.slice(), x)?;
        Ok((x, self.shape.images("y", dim.slice(), y)?))
    }

    /// Checks the arguments of a backward pass.
    fn pass<'a, X: Number, W: Number>(
        &self,
        grad: ArrayViewD<'a, X>,
        x: ArrayViewD<'a, X>,
        weight: ArrayViewD<'a, W>,
        gradients: Gradients<'a, X, W>,
    ) -> Result<BackwardCall<'a, X, W>, Error> {
        let (shape, dim) = (self.shape, x.raw_dim());
        let like_x = dim.slice();
        Ok(BackwardCall {
            x: shape.images("x", like_x, x)?,
            grad: shape.images("grad", like_x, grad)?,
            weight: shape.bins("weight", weight)?,
            grad_x: gradients.x.map(|g| shape.images("grad_x", like_x, g)).transpose()?,
            grad_weight: gradients.weight.map(|g| shape.bins("grad_weight", g)).transpose()?,
        })
    }

    fn run_backward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        batch: &Batch<'_, X>,
        pass: BackwardCall<'_, X, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let BackwardCall { grad, x, weight, grad_x, grad_weight } = pass;
        let summed = grad_weight.is_some();
        let lens = [batch.packed_len(), if summed { batch.sums_len() } else { 0 }];
        let shared = lens[0].saturating_add(lens[1]).saturating_add(widened_len::<W>(weight.len()));
        let (mut workers, shared) = scratch.lend(pool, batch.needs(shared))?;
        let (packed, shared) = shared.split_at_mut(lens[0]);
        let (sums, wide_weight) = shared.split_at_mut(lens[1]);
        let images = Images { grad, x, grad_x };
        let weight = Weight::Natural(number::read(self.isa, weight, wide_weight));
        batch.backward(images, weight, packed, summed.then_some(&mut *sums), &mut workers);
        if let Some(grad_weight) = grad_weight {
            number::write(self.isa, grad_weight, wide_weight, |grad_weight| {
                batch.finish(sums, grad_weight, &mut workers);
            });
        }
        Ok(())
    }

    /// As [`run_backward`](Self::run_backward), for a batch of one image: every tile has its own part of the gradients.
    fn run_single_backward<X: Number<Real = T>, W: Number<Real = T>>(
        &self,
        batch: &Batch<'_, X>,
        single: &dyn Single<X>,
        pass: BackwardCall<'_, X, W>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let BackwardCall { grad, x, weight, grad_x, grad_weight } = pass;
        let bins_len = widened_len::<W>(weight.len());
        let (mut workers, shared) = scratch.lend(pool, batch.needs(2 * bins_len))?;
        let (wide_weight, wide_grad_weight) = shared.split_at_mut(bins_len);
        let weight = number::read(self.isa, weight, wide_weight);
        let tiling = batch.tiling;
        let run = |grad_weight: Option<ArrayViewMut3<'_, T>>| {
            let jobs = in_order(tiling.pieces(), grad_x.map(|g| tiling.images_mut(g)))
                .zip(in_order(tiling.pieces(), grad_weight.map(|g| tiling.bins_mut(g))))
                .enumerate();
            parallel::run(pool, workers.each(), jobs, |(tile, (grad_x, grad_weight)), team| {
                let pass = SingleBackward {
                    grad: tiling.images(grad, tile).index_axis_move(BATCH, 0),
                    x: tiling.images(x, tile).index_axis_move(BATCH, 0),
                    weight: tiling.bins(weight, tile),
                    grad_x: grad_x.map(|grad_x| grad_x.index_axis_move(BATCH, 0)),
                    grad_weight,
                };
                single.backward(pass, team);
            });
        };
        match grad_weight {
            Some(grad) => number::write(self.isa, grad, wide_grad_weight, |grad| run(Some(grad))),
            None => run(None),
        }
        Ok(())
    }
}

/// More bytes than the plan for a shape takes while it is made.
fn plan_bytes(shape: Shape) -> usize {
    let lengths = shape.rows.saturating_add(shape.columns);
    let tables = shape.bins_len().saturating_mul(BYTES_A_BIN);
    tables.saturating_add(lengths.saturating_mul(BYTES_A_POINT))
}

/// Numbers in the copy of `len` elements in a wider type, if there is one.
pub(crate) fn widened_len<N: Number>(len: usize) -> usize {
    if N::HALF { len } else { 0 }
}
