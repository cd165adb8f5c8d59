//! The kernel for few lines: realfft along rows, rustfft along columns, plane by plane.
//!
//! Vectors across lines, as in [`crate::fft`], are mostly empty when an image has one to four channels, or tokens one to
//! four rows; here vectors lie along the lines. Planes of a grid are gathered and scattered. The spectrum of
//! a plane is kept by columns, `(columns/2+1, rows)`, and so is the packed weight. After the inverse transform of the
//! columns those of DC and Nyquist lose their imaginary parts, which is the projection that `irfft2` makes.

use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3};
use num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use transpose::transpose;

use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::views::BATCH;
use crate::{Layout, Real, Shape};

pub(crate) struct AlongLines<T: Real> {
    shape: Shape,
    rows_forward: Arc<dyn RealToComplex<T>>,
    rows_inverse: Arc<dyn ComplexToReal<T>>,
    columns_forward: Arc<dyn Fft<T>>,
    columns_inverse: Arc<dyn Fft<T>>,
}

/// Scratch of a call, cut into its uses.
struct AlongBuffers<'a, T> {
    /// Planes of `x` or of the gradient, one after the other.
    planes: &'a mut [T],
    /// Planes of `x` beside those of the gradient.
    inputs: &'a mut [T],
    /// The spectrum of a plane.
    spectrum: &'a mut [Complex<T>],
    /// The spectrum of a plane of `inputs`.
    input: &'a mut [Complex<T>],
    work: Work<'a, T>,
}

/// Scratch of one transform.
struct Work<'a, T> {
    by_rows: &'a mut [Complex<T>],
    inner: &'a mut [Complex<T>],
}

impl<T: Real> AlongLines<T> {
    /// Plans a shape without zeros.
    pub(crate) fn new(shape: Shape) -> Self {
        let (mut rows, mut columns) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            shape,
            rows_forward: rows.plan_fft_forward(shape.columns),
            rows_inverse: rows.plan_fft_inverse(shape.columns),
            columns_forward: columns.plan_fft_forward(shape.rows),
            columns_inverse: columns.plan_fft_inverse(shape.rows),
        }
    }

    fn plane_len(&self) -> usize {
        self.shape.rows * self.shape.columns
    }

    fn spectrum_len(&self) -> usize {
        self.shape.rows * self.shape.half()
    }

    /// Planes of an image: each lane of a grid is one, all lanes of tokens are one together.
    fn planes(&self) -> usize {
        match self.shape.layout {
            Layout::Tokens => 1,
            Layout::Grid => self.shape.lanes,
        }
    }

    /// Scratch that the libraries ask for.
    fn inner_len(&self) -> usize {
        let rows = self.rows_forward.get_scratch_len().max(self.rows_inverse.get_scratch_len());
        let forward = self.columns_forward.get_inplace_scratch_len();
        rows.max(forward).max(self.columns_inverse.get_inplace_scratch_len())
    }

    fn buffers<'a>(&self, scratch: &'a mut [T]) -> AlongBuffers<'a, T> {
        let len = self.planes() * self.plane_len();
        let (planes, rest) = scratch.split_at_mut(len);
        let (inputs, rest) = rest.split_at_mut(len);
        let len = self.spectrum_len();
        let (spectrum, rest) = cast_slice_mut(rest).split_at_mut(len);
        let (input, rest) = rest.split_at_mut(len);
        let (by_rows, inner) = rest.split_at_mut(len);
        AlongBuffers { planes, inputs, spectrum, input, work: Work { by_rows, inner } }
    }

    /// Copies an image `(points, lanes)` to planes.
    fn gather(&self, image: ArrayView2<'_, T>, planes: &mut [T]) {
        let image = match self.shape.layout {
            Layout::Tokens => image,
            Layout::Grid => image.reversed_axes(),
        };
        view_mut(planes, image.dim()).assign(&image);
    }

    /// Copies planes to an image `(points, lanes)`.
    fn scatter(&self, planes: &mut [T], image: ArrayViewMut2<'_, T>) {
        let mut image = match self.shape.layout {
            Layout::Tokens => image,
            Layout::Grid => image.reversed_axes(),
        };
        let planes = view_mut(planes, image.dim());
        image.assign(&planes);
    }

    /// The spectrum of a plane, by columns; `plane` is lost.
    fn transform(&self, plane: &mut [T], spectrum: &mut [Complex<T>], work: &mut Work<'_, T>) {
        let Shape { rows, columns, .. } = self.shape;
        let half = self.shape.half();
        for (row, to) in plane.chunks_exact_mut(columns).zip(work.by_rows.chunks_exact_mut(half)) {
            self.rows_forward.process_with_scratch(row, to, work.inner).expect("planned lengths");
        }
        transpose(work.by_rows, spectrum, half, rows);
        self.columns_forward.process_with_scratch(spectrum, work.inner);
    }

    /// The inverse of [`AlongLines::transform`], times the points of a plane; `spectrum` is lost.
    fn invert(&self, spectrum: &mut [Complex<T>], plane: &mut [T], work: &mut Work<'_, T>) {
        let Shape { rows, columns, .. } = self.shape;
        let half = self.shape.half();
        self.columns_inverse.process_with_scratch(spectrum, work.inner);
        for (v, column) in spectrum.chunks_exact_mut(rows).enumerate() {
            if self.is_real(v) {
                for value in column {
                    value.im = T::zero();
                }
            }
        }
        transpose(spectrum, work.by_rows, rows, half);
        for (from, row) in work.by_rows.chunks_exact_mut(half).zip(plane.chunks_exact_mut(columns))
        {
            self.rows_inverse.process_with_scratch(from, row, work.inner).expect("planned lengths");
        }
    }

    /// Whether a column of the spectrum is that of DC or Nyquist, real before the transform of the columns.
    fn is_real(&self, v: usize) -> bool {
        v == 0 || 2 * v == self.shape.columns
    }

    /// Where the numbers of one bin of a weight `(bins, lanes, 2)` stand in its packed form: first and step.
    fn places(&self, bin: usize) -> (usize, usize) {
        let (rows, half) = (self.shape.rows, self.shape.half());
        match self.shape.layout {
            Layout::Tokens => (bin, rows),
            Layout::Grid => (bin % half * rows + bin / half, half * rows),
        }
    }

    /// One over the points of a plane, times `copies`.
    fn norm(&self, copies: f64) -> T {
        T::nearest(copies / self.plane_len() as f64)
    }
}

impl<T: Real> Packing<T> for AlongLines<T> {
    fn packed_len(&self, _: usize) -> usize {
        2 * self.planes() * self.spectrum_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        packed: &mut [T],
        _: &mut Team<'_, T>,
    ) {
        let packed: &mut [Complex<T>] = cast_slice_mut(packed);
        let norm = self.norm(1.0);
        for (bin, lanes) in weight.outer_iter().enumerate() {
            let (first, step) = self.places(bin);
            let to = packed[first..].iter_mut().step_by(step);
            for (w, to) in lanes.outer_iter().zip(to) {
                let w = Complex::new(w[0], w[1]) * norm;
                *to = if factor == Factor::Conjugate { w.conj() } else { w };
            }
        }
    }
}

impl<T: Real> Kernel<T> for AlongLines<T> {
    fn tile(&self) -> usize {
        self.shape.lanes
    }

    fn scratch_len(&self) -> usize {
        2 * (self.planes() * self.plane_len() + 3 * self.spectrum_len() + self.inner_len())
    }

    fn packing(&self) -> Option<&dyn Packing<T>> {
        Some(self)
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.packed_len(lanes)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, T>,
        packed: &[T],
        mut y: ArrayViewMut3<'_, T>,
        team: &mut Team<'_, T>,
    ) {
        let weights = cast_slice(packed).chunks_exact(self.spectrum_len());
        let AlongBuffers { planes, spectrum, mut work, .. } = self.buffers(team.scratch());
        for (x, y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.gather(x, planes);
            for (plane, weight) in planes.chunks_exact_mut(self.plane_len()).zip(weights.clone()) {
                self.transform(plane, spectrum, &mut work);
                multiply(spectrum, weight);
                self.invert(spectrum, plane, &mut work);
            }
            self.scatter(planes, y);
        }
    }

    fn backward(&self, pass: Backward<'_, T>, team: &mut Team<'_, T>) {
        let Backward { grad, x, weight: packed, mut grad_x, mut grad_sum, .. } = pass;
        let AlongBuffers { planes, inputs, spectrum, input, mut work } =
            self.buffers(team.scratch());
        for (image, (grad, x)) in grad.outer_iter().zip(x.outer_iter()).enumerate() {
            self.gather(grad, planes);
            if grad_sum.is_some() {
                self.gather(x, inputs);
            }
            for index in 0..self.planes() {
                let plane = nth(planes, self.plane_len(), index);
                self.transform(plane, spectrum, &mut work);
                if let Some(sum) = &mut grad_sum {
                    self.transform(nth(inputs, self.plane_len(), index), input, &mut work);
                    let sum = cast_slice_mut(nth(sum, 2 * self.spectrum_len(), index));
                    add_conjugate_product(sum, input, spectrum);
                }
                if grad_x.is_some() {
                    let weights = cast_slice(packed);
                    multiply(spectrum, &weights[index * self.spectrum_len()..]);
                    self.invert(spectrum, plane, &mut work);
                }
            }
            if let Some(grad_x) = &mut grad_x {
                self.scatter(planes, grad_x.index_axis_mut(BATCH, image));
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[T],
        mut grad_weight: ArrayViewMut3<'_, T>,
        _: &mut Team<'_, T>,
    ) {
        let sums: &[Complex<T>] = cast_slice(grad_sum);
        let (rows, half) = (self.shape.rows, self.shape.half());
        let (once, twice) = (self.norm(1.0), self.norm(2.0));
        for (bin, mut lanes) in grad_weight.outer_iter_mut().enumerate() {
            let (first, step) = self.places(bin);
            for (lane, mut g) in lanes.outer_iter_mut().enumerate() {
                let place = first + lane * step;
                let norm = if self.is_real(place / rows % half) { once } else { twice };
                let sum = sums[place] * norm;
                (g[0], g[1]) = (sum.re, sum.im);
            }
        }
    }
}

/// `spectrum · weight`.
fn multiply<T: Real>(spectrum: &mut [Complex<T>], weight: &[Complex<T>]) {
    spectrum.iter_mut().zip(weight).for_each(|(value, w)| *value = *value * *w);
}

/// `sum + conj(input) · grad`.
fn add_conjugate_product<T: Real>(
    sum: &mut [Complex<T>],
    input: &[Complex<T>],
    grad: &[Complex<T>],
) {
    for ((sum, x), g) in sum.iter_mut().zip(input).zip(grad) {
        *sum = *sum + x.conj() * *g;
    }
}

/// Piece number `index` of those of length `len`.
fn nth<T>(all: &mut [T], len: usize, index: usize) -> &mut [T] {
    &mut all[index * len..][..len]
}

/// A buffer as a matrix.
fn view_mut<T>(buffer: &mut [T], dim: (usize, usize)) -> ArrayViewMut2<'_, T> {
    ArrayViewMut2::from_shape(dim, buffer).expect("the length is that of dim")
}
