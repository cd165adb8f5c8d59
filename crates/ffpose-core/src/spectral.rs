//! The learnable spectral filter `y = irfft2(rfft2(x) · W)`, forward and backward.
//!
//! Same numbers as `torch.fft.rfft2`/`irfft2` with their default norm. `irfft2` ignores what is not Hermitian in the
//! column of DC and, when the second axis is even, in that of Nyquist: a learned weight acts there as
//! `(W(u) + conj W(-u)) / 2`. Source: Ye et al., Sensors 2023, 23(20), 8633, Eq. 1-3; the grid layout is `GFNet`'s.
//!
//! This file checks shapes, hands out jobs and adds up in a fixed order; the transforms are [`Kernel`]s.

use std::any::{Any, TypeId};
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;

use ndarray::{ArrayView3, ArrayViewD, ArrayViewMut3, ArrayViewMutD};

use crate::general::General;
use crate::kernel::{Backward, Kernel};
use crate::scratch::{Scratch, Worker};
use crate::tiling::Tiling;
use crate::{Error, Isa, Layout, Real, Shape, fft, parallel};

/// Plans that one thread keeps; a program that filters more shapes than this in turn plans again.
const PLANS_KEPT: usize = 64;

thread_local! {
    static PLANS: RefCell<HashMap<(TypeId, Shape), Box<dyn Any>>> = RefCell::default();
}

/// A spectral filter for images of one shape: planned once, run on any batch with any weight.
///
/// Arrays are C-contiguous. `x`, `y` and their gradients are `(..., X, Y)` or `(..., H, W, C)`, with any number of
/// leading axes; `weight` and its gradient are `(X, Y/2+1, 2)` or `(H, W/2+1, C, 2)`, real and imaginary parts last.
/// Results are bit-identical for any number of threads, and `y` and the gradient of `x` for any split of the batch.
#[derive(Clone)]
pub struct SpectralFilter<T> {
    shape: Shape,
    /// None for images without elements, which have no transform.
    kernel: Option<Arc<dyn Kernel<T>>>,
}

/// Where the gradients of a backward pass go, if they are wanted.
#[derive(Debug)]
pub struct Gradients<'a, T> {
    /// Gradient with respect to `x`: `irfft2(rfft2(grad) · conj W)`.
    pub x: Option<ArrayViewMutD<'a, T>>,
    /// Gradient with respect to the weight, summed over the batch.
    pub weight: Option<ArrayViewMutD<'a, T>>,
}

/// The arguments of a backward pass, checked: images `(batch, points, lanes)`, weights `(bins, lanes, 2)`.
struct Pass<'a, T> {
    grad: ArrayView3<'a, T>,
    x: ArrayView3<'a, T>,
    weight: ArrayView3<'a, T>,
    grad_x: Option<ArrayViewMut3<'a, T>>,
    grad_weight: Option<ArrayViewMut3<'a, T>>,
}

impl<T: Real> SpectralFilter<T> {
    /// Plans the transform of images of one shape, for one instruction set.
    #[must_use]
    pub fn new(isa: Isa, shape: Shape) -> Self {
        let kernel = (!shape.is_empty()).then(|| plan_kernel(isa, shape));
        Self { shape, kernel }
    }

    /// The plan for a shape, made at its first use on this thread and kept for the next.
    ///
    /// # Errors
    /// [`Error::Isa`] as [`Isa::current`].
    #[allow(clippy::missing_panics_doc)] // the key names the element type
    pub fn planned(shape: Shape) -> Result<Self, Error> {
        let isa = Isa::current()?;
        Ok(PLANS.with_borrow_mut(|plans| {
            if plans.len() >= PLANS_KEPT {
                plans.clear();
            }
            plans
                .entry((TypeId::of::<T>(), shape))
                .or_insert_with(|| Box::new(Self::new(isa, shape)))
                .downcast_ref::<Self>()
                .expect("the key names the element type")
                .clone()
        }))
    }

    /// Filters `x` with `weight` into `y`, of the shape of `x`, on at most `threads` threads.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Strides`]; `y` is then untouched.
    pub fn forward(
        &self,
        x: ArrayViewD<'_, T>,
        weight: ArrayViewD<'_, T>,
        y: ArrayViewMutD<'_, T>,
        threads: usize,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let like_x = x.shape().to_vec();
        let x = self.shape.images("x", &like_x, x)?;
        let y = self.shape.images_mut("y", &like_x, y)?;
        let weight = self.shape.bins("weight", weight)?;
        let Some(kernel) = self.kernel.as_deref().filter(|_| !x.is_empty()) else {
            return Ok(());
        };

        let threads = parallel::worth(threads, x.len());
        let tiling = self.tiling(kernel, x.dim().0, Some(threads));
        let (workers, _) = scratch.lend(threads, kernel.packed_len(), kernel.scratch_len(), 0);
        let jobs = tiling.images_mut(y).enumerate().collect();
        parallel::run(jobs, workers, |(piece, y), Worker { packed, scratch }| {
            kernel.pack(tiling.bins(weight, tiling.tile_of(piece)), packed);
            kernel.forward(tiling.images(x, piece), packed, y, scratch);
        });
        Ok(())
    }

    /// Writes the gradients that are wanted, given `grad`, the gradient of `y`.
    ///
    /// The weight's gradient is `c_v / N · Σ_b conj(X_b) · G_b` with N points in a plane and `c_v` = 1 in the columns
    /// of DC and Nyquist, 2 between them: what autograd gives for the real tensor of parts. The order of the sum
    /// follows from shapes alone, never from `threads`.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Strides`]; the gradients are then untouched.
    pub fn backward<'a>(
        &self,
        grad: ArrayViewD<'a, T>,
        x: ArrayViewD<'a, T>,
        weight: ArrayViewD<'a, T>,
        gradients: Gradients<'a, T>,
        threads: usize,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let mut pass = self.pass(grad, x, weight, gradients)?;
        match self.kernel.as_deref() {
            Some(kernel) if !pass.x.is_empty() => self.run_backward(kernel, pass, threads, scratch),
            _ => pass.grad_weight.iter_mut().for_each(|grad| grad.fill(T::default())),
        }
        Ok(())
    }

    /// Checks the arguments of a backward pass.
    fn pass<'a>(
        &self,
        grad: ArrayViewD<'a, T>,
        x: ArrayViewD<'a, T>,
        weight: ArrayViewD<'a, T>,
        gradients: Gradients<'a, T>,
    ) -> Result<Pass<'a, T>, Error> {
        let shape = self.shape;
        let like_x = x.shape().to_vec();
        Ok(Pass {
            x: shape.images("x", &like_x, x)?,
            grad: shape.images("grad", &like_x, grad)?,
            weight: shape.bins("weight", weight)?,
            grad_x: gradients.x.map(|g| shape.images_mut("grad_x", &like_x, g)).transpose()?,
            grad_weight: gradients.weight.map(|g| shape.bins_mut("grad_weight", g)).transpose()?,
        })
    }

    fn run_backward(
        &self,
        kernel: &dyn Kernel<T>,
        pass: Pass<'_, T>,
        threads: usize,
        scratch: &mut Scratch,
    ) {
        let Pass { grad, x, weight, grad_x, grad_weight } = pass;
        let threads = parallel::worth(threads, x.len());
        let summed = grad_weight.is_some();
        let tiling = self.tiling(kernel, x.dim().0, (!summed).then_some(threads));
        let packed_len = kernel.packed_len();
        let sums = if summed { tiling.pieces() * packed_len } else { 0 };
        let (workers, sums) = scratch.lend(threads, packed_len, kernel.scratch_len(), sums);
        let grad_sums = summed.then(|| sums.chunks_exact_mut(packed_len));
        let jobs = in_order(tiling.pieces(), grad_x.map(|g| tiling.images_mut(g)))
            .zip(in_order(tiling.pieces(), grad_sums))
            .enumerate()
            .collect();
        parallel::run(jobs, workers, |(piece, (grad_x, grad_sum)), Worker { packed, scratch }| {
            if grad_x.is_some() {
                kernel.pack(tiling.bins(weight, tiling.tile_of(piece)), packed);
            }
            let (grad, x) = (tiling.images(grad, piece), tiling.images(x, piece));
            kernel.backward(Backward { grad, x, packed, grad_x, grad_sum }, scratch);
        });
        if let Some(grad_weight) = grad_weight {
            let total = add_parts(sums, tiling.tiles() * packed_len).chunks_exact(packed_len);
            let jobs = total.zip(tiling.bins_mut(grad_weight)).collect();
            parallel::run(jobs, vec![(); threads], |(sum, grad_weight), ()| {
                kernel.unpack_gradient(sum, grad_weight);
            });
        }
    }

    /// Parts of the batch: as many as keep `threads` busy, or, without threads, a number that follows from shapes.
    fn tiling(&self, kernel: &dyn Kernel<T>, images: usize, threads: Option<usize>) -> Tiling {
        let tiles = self.shape.lanes.div_ceil(kernel.tile());
        let parts = threads.map_or_else(|| sum_parts(tiles, images), |n| n.div_ceil(tiles));
        Tiling::new(self.shape, kernel.tile(), images, parts.min(images))
    }
}

/// The kernel for a shape: vectors across its lines, unless these would leave half of every vector empty. Measured with
/// AVX2, rustfft along the lines is then two to six times faster, and else two to fourteen times slower.
fn plan_kernel<T: Real>(isa: Isa, shape: Shape) -> Arc<dyn Kernel<T>> {
    let lines = match shape.layout {
        Layout::Tokens => shape.rows,
        Layout::Grid => shape.lanes,
    };
    if 2 * lines <= isa.lanes::<T>() {
        Arc::new(General::new(shape))
    } else {
        fft::plan(isa, shape)
    }
}

/// Parts in which a gradient is summed over `images`: few tiles leave too little work for threads, so that parts of
/// at least four images, sixteen parts at most, are summed apart and then added.
fn sum_parts(tiles: usize, images: usize) -> usize {
    if tiles >= 4 { 1 } else { images.div_ceil(images.div_ceil(16).max(4)) }
}

/// Adds parts of `len` numbers to the first of them, in order, and returns it.
fn add_parts<T: Real>(parts: &mut [T], len: usize) -> &[T] {
    let (total, rest) = parts.split_at_mut(len);
    for part in rest.chunks_exact(len) {
        total.iter_mut().zip(part).for_each(|(sum, term)| *sum = *sum + *term);
    }
    total
}

/// The items in `Some`, or `None` for each of `len`.
fn in_order<I: Iterator>(len: usize, items: Option<I>) -> impl Iterator<Item = Option<I::Item>> {
    let absent = if items.is_some() { 0 } else { len };
    items.into_iter().flatten().map(Some).chain((0..absent).map(|_| None))
}
