//! The kernels of whole images: tokens without codelets, large grids of few channels, and all that has no vectors.
//!
//! An image is rows of `columns · lanes` numbers. The spectra of its lanes are kept as a [`Spectra`] likes them, and packed weights
//! and sums of gradients in the same order. The inverse along the columns leaves imaginary parts in the columns of DC and Nyquist,
//! which the rows do not see: that is the projection that `irfft2` makes.

mod across;
mod along;

use std::ops::Range;

use ndarray::{ArrayBase, ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Ix2, RawData};

pub(crate) use self::across::Across;
pub(crate) use self::along::Along;
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{Element, Stored, slack};
use crate::tuning::ADDED_TOGETHER;
use crate::views::BATCH;
use crate::{Real, Shape};

/// The plan for images of one shape.
pub(crate) struct Planes<P> {
    shape: Shape,
    spectra: P,
}

/// How the lanes of an image are transformed, and how their spectra are kept.
pub(crate) trait Spectra<T: Real>: Send + Sync {
    /// Numbers of the spectra of an image.
    fn numbers(&self) -> usize;

    /// Numbers from each member of a team that make room for the spectra of two images, in whole cache lines.
    fn share_len(&self, members: usize) -> usize {
        (2 * self.numbers()).div_ceil(members).next_multiple_of(slack::<T>())
    }

    /// Numbers of scratch that each member needs besides.
    fn scratch_len(&self) -> usize;

    /// What spectra are multiplied by.
    fn gain(&self) -> f64;

    /// Brings a weight `(rows, columns / 2 + 1, lanes)` to the order of the spectra, real and imaginary parts times those of `norm`.
    fn pack(&self, weight: &[[T; 2]], norm: [T; 2], packed: &mut [T], team: &mut Team<'_, T>);

    /// The numbers at frequency `u` as a row of a weight.
    fn unpack(&self, u: usize, sum: &[T], row: &mut [[T; 2]]);

    /// As [`Kernel::shares`]: images go through a team one after the other.
    fn shares(&self, images: usize) -> bool;

    /// Transforms the rows of `image` `(rows, columns · lanes)`.
    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        spectra: &mut [T],
        team: &mut Team<'_, T>,
    );

    /// Transforms the columns of spectra and, if there is a sum, of those of `x`, whose conjugate times the spectra it grows by.
    /// Multiplies by `factor`, if there is one, and transforms the columns back. What is left without one is of no account.
    fn filter_columns(
        &self,
        spectra: &mut [T],
        factor: Option<&[T]>,
        sum: Option<Sum<'_, T>>,
        team: &mut Team<'_, T>,
    );

    /// Transforms rows back to an image.
    fn leave<X: Stored<Real = T>>(
        &self,
        spectra: &mut [T],
        image: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, T>,
    );
}

/// A sum that grows by products of the spectra of `x`, whose rows are transformed.
pub(crate) struct Sum<'a, T> {
    pub(crate) x: &'a mut [T],
    pub(crate) sum: &'a mut [T],
}

impl<P> Planes<P> {
    /// The plan for a shape without zeros.
    pub(crate) fn new(shape: Shape, spectra: P) -> Self {
        Self { shape, spectra }
    }

    /// An image `(points, lanes)` by rows.
    fn by_rows<S: RawData>(&self, image: ArrayBase<S, Ix2>) -> ArrayBase<S, Ix2> {
        let dim = (self.shape.rows, self.shape.columns * self.shape.channels());
        image.into_shape_with_order(dim).expect("an image has no gaps")
    }

    /// Points of a plane.
    fn points(&self) -> f64 {
        (self.shape.rows * self.shape.columns) as f64
    }
}

impl<T: Real, P: Spectra<T>> Packing<T> for Planes<P> {
    fn packed_len(&self, _: usize) -> usize {
        self.spectra.numbers()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        _: Range<usize>,
        factor: Factor,
        packed: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let norm = T::nearest(1.0 / (self.points() * self.spectra.gain()));
        let weight = weight.to_slice().expect("a weight has no gaps");
        let norm = [norm, if factor == Factor::Conjugate { -norm } else { norm }];
        self.spectra.pack(weight.as_chunks().0, norm, packed, team);
    }
}

impl<X: Stored<Real: Real>, P: Spectra<X::Real>> Kernel<X> for Planes<P> {
    fn tile(&self) -> usize {
        self.shape.lanes
    }

    fn scratch_len(&self, members: usize) -> usize {
        self.spectra.share_len(members) + self.spectra.scratch_len()
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        Some(self)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        packed: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let (spectra, mut team) = team.share(self.spectra.share_len(team.members()));
        let spectra = &mut spectra[..self.spectra.numbers()];
        for (x, y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.spectra.enter(self.by_rows(x), spectra, &mut team);
            self.spectra.filter_columns(spectra, Some(packed), None, &mut team);
            self.spectra.leave(spectra, self.by_rows(y), &mut team);
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, mut grad_x, mut grad_sum, images_each } = pass;
        let numbers = self.spectra.numbers();
        let (spectra, mut team) = team.share(self.spectra.share_len(team.members()));
        let (spectra, of_x) = spectra[..2 * numbers].split_at_mut(numbers);
        for (image, (grad, x)) in grad.outer_iter().zip(x.outer_iter()).enumerate() {
            self.spectra.enter(self.by_rows(grad), spectra, &mut team);
            let sum = grad_sum.as_deref_mut().map(|sums| {
                self.spectra.enter(self.by_rows(x), of_x, &mut team);
                Sum { x: &mut *of_x, sum: &mut sums[image / images_each * numbers..][..numbers] }
            });
            let factor = grad_x.is_some().then_some(weight);
            self.spectra.filter_columns(spectra, factor, sum, &mut team);
            if let Some(grad_x) = &mut grad_x {
                let grad_x = grad_x.index_axis_mut(BATCH, image);
                self.spectra.leave(spectra, self.by_rows(grad_x), &mut team);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let once = 1.0 / (self.points() * self.spectra.gain().powi(2));
        let factors = [once, 2.0 * once].map(X::Real::nearest);
        let grad_weight = grad_weight.as_slice_mut().expect("a weight has no gaps");
        let row_len = self.shape.half() * self.shape.channels();
        let rows_each = (ADDED_TOGETHER / (2 * row_len)).max(1);
        let jobs = grad_weight.as_chunks_mut().0.chunks_mut(rows_each * row_len).enumerate();
        team.run(jobs, |(job, rows), _| {
            for (i, row) in rows.chunks_exact_mut(row_len).enumerate() {
                self.spectra.unpack(job * rows_each + i, grad_sum, row);
                for (v, lanes) in row.chunks_exact_mut(self.shape.channels()).enumerate() {
                    // columns of DC and Nyquist stand for themselves alone
                    let is_real = v == 0 || 2 * v == self.shape.columns;
                    let factor = factors[usize::from(!is_real)];
                    lanes.as_flattened_mut().iter_mut().for_each(|part| *part = *part * factor);
                }
            }
        });
    }

    fn shares(&self, images: usize) -> bool {
        self.spectra.shares(images)
    }
}
