//! The kernel along the lines: realfft for rows, plane by plane; columns across vectors, or by rustfft.
//!
//! Vectors across lines of a grid are mostly empty when an image has one to four channels, and in a plane of tokens rows are
//! contiguous; besides there are none of double precision, nor without an instruction set for them, and rustfft has more ways for
//! large primes. Planes of a grid are gathered and scattered. After the inverse transform of the columns those of DC and Nyquist
//! lose their imaginary parts, which is the projection that `irfft2` makes.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis};
use num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use transpose::transpose;

use super::transform::{Transform, has_transform};
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Element, Isa, Stored, Tile, TileMut, Vector, aligned, complex_vectors, slack,
};
use crate::tuning::GATHERED_POINTS;
use crate::views::BATCH;
use crate::{Layout, Real, Shape};

pub(crate) struct AlongLines<T: Real> {
    isa: Isa,
    shape: Shape,
    rows_forward: Arc<dyn RealToComplex<T>>,
    rows_inverse: Arc<dyn ComplexToReal<T>>,
    columns: Columns<T>,
    /// Complex numbers of a row in a spectrum that is kept by rows: whole vectors.
    pitch: usize,
}

/// How columns are transformed, and how a spectrum is kept, and so the packed weight.
enum Columns<T> {
    /// There is one row.
    Alone,
    /// As many together as a vector has lanes; by rows.
    Across(Transform<T>),
    /// One by one, forward and back; by columns.
    Along(Arc<dyn Fft<T>>, Arc<dyn Fft<T>>),
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
    /// Columns of vectors, and what their transform needs.
    line: &'a mut [T],
    by_rows: &'a mut [Complex<T>],
    inner: &'a mut [Complex<T>],
}

impl<T: Real> AlongLines<T> {
    /// Plans a shape without zeros.
    pub(crate) fn new(isa: Isa, shape: Shape) -> Self {
        let (mut rows, lanes) = (RealFftPlanner::new(), isa.lanes::<T>());
        let fills_vectors = isa.has_vectors::<T>() && 2 * shape.half() > lanes;
        let columns = if shape.rows == 1 {
            Columns::Alone
        } else if fills_vectors && has_transform(shape.rows) {
            Columns::Across(Transform::new(isa, shape.rows))
        } else {
            let mut columns = FftPlanner::new();
            let forward = columns.plan_fft_forward(shape.rows);
            Columns::Along(forward, columns.plan_fft_inverse(shape.rows))
        };
        let across = matches!(columns, Columns::Across(_));
        Self {
            isa,
            shape,
            rows_forward: rows.plan_fft_forward(shape.columns),
            rows_inverse: rows.plan_fft_inverse(shape.columns),
            columns,
            pitch: if across { shape.half().next_multiple_of(lanes) } else { shape.half() },
        }
    }

    fn plane_len(&self) -> usize {
        self.shape.rows * self.shape.columns
    }

    fn spectrum_len(&self) -> usize {
        self.shape.rows * self.pitch
    }

    /// Planes of an image: each lane of a grid is one, all lanes of tokens are one together.
    fn planes(&self) -> usize {
        match self.shape.layout {
            Layout::Tokens => 1,
            Layout::Grid => self.shape.lanes,
        }
    }

    /// Numbers of columns of vectors, and of what their transform needs.
    fn line_len(&self) -> usize {
        match &self.columns {
            Columns::Across(transform) => {
                2 * self.isa.lanes::<T>() * (transform.len() + transform.work_len())
            }
            _ => 0,
        }
    }

    /// Scratch that the libraries ask for.
    fn inner_len(&self) -> usize {
        let rows = self.rows_forward.get_scratch_len().max(self.rows_inverse.get_scratch_len());
        match &self.columns {
            Columns::Along(forward, inverse) => {
                let columns = forward.get_inplace_scratch_len();
                rows.max(columns).max(inverse.get_inplace_scratch_len())
            }
            _ => rows,
        }
    }

    fn buffers<'a>(&self, scratch: &'a mut [T]) -> AlongBuffers<'a, T> {
        let (line, rest) = aligned(scratch).split_at_mut(self.line_len());
        let len = self.planes() * self.plane_len();
        let (planes, rest) = rest.split_at_mut(len);
        let (inputs, rest) = rest.split_at_mut(len);
        let rest = &mut rest[..2 * (3 * self.spectrum_len() + self.inner_len())];
        let len = self.spectrum_len();
        let (spectrum, rest) = cast_slice_mut(rest).split_at_mut(len);
        let (input, rest) = rest.split_at_mut(len);
        let (by_rows, inner) = rest.split_at_mut(len);
        AlongBuffers { planes, inputs, spectrum, input, work: Work { line, by_rows, inner } }
    }

    /// Copies an image `(points, lanes)` to planes.
    fn gather<X: Stored<Real = T>>(&self, image: ArrayView2<'_, X>, planes: &mut [T]) {
        let image = image.to_slice().expect("an image has no gaps");
        for points in self.blocks() {
            for (i, plane) in planes.chunks_exact_mut(self.plane_len()).enumerate() {
                let numbers = image[points.start * self.planes() + i..].iter();
                let numbers = numbers.step_by(self.planes());
                plane[points.clone()].iter_mut().zip(numbers).for_each(|(to, x)| *to = x.widened());
            }
        }
    }

    /// Copies planes to an image `(points, lanes)`.
    fn scatter<X: Stored<Real = T>>(&self, planes: &[T], image: ArrayViewMut2<'_, X>) {
        let image = image.into_slice().expect("an image has no gaps");
        for points in self.blocks() {
            for (i, plane) in planes.chunks_exact(self.plane_len()).enumerate() {
                let numbers = image[points.start * self.planes() + i..].iter_mut();
                let numbers = numbers.step_by(self.planes());
                numbers.zip(&plane[points.clone()]).for_each(|(to, x)| *to = X::nearest_to(*x));
            }
        }
    }

    /// Few points at a time, whose lanes stay in cache for all planes.
    fn blocks(&self) -> impl Iterator<Item = Range<usize>> {
        let points = self.plane_len();
        (0..points).step_by(GATHERED_POINTS).map(move |p| p..points.min(p + GATHERED_POINTS))
    }

    /// The spectrum of a plane, which is lost.
    fn transform(&self, plane: &mut [T], spectrum: &mut [Complex<T>], work: &mut Work<'_, T>) {
        let Shape { rows, columns, .. } = self.shape;
        let half = self.shape.half();
        let along = matches!(self.columns, Columns::Along(..));
        let by_rows = if along { &mut *work.by_rows } else { &mut *spectrum };
        for (row, to) in plane.chunks_exact_mut(columns).zip(by_rows.chunks_exact_mut(self.pitch)) {
            let (to, rest) = to.split_at_mut(half);
            self.rows_forward.process_with_scratch(row, to, work.inner).expect("planned lengths");
            rest.fill(Complex::default());
        }
        match &self.columns {
            Columns::Alone => {}
            Columns::Across(transform) => self.across::<false>(transform, spectrum, work.line),
            Columns::Along(forward, _) => {
                transpose(work.by_rows, spectrum, half, rows);
                forward.process_with_scratch(spectrum, work.inner);
            }
        }
    }

    /// The inverse of [`AlongLines::transform`], times the points of a plane; `spectrum` is lost.
    fn invert(&self, spectrum: &mut [Complex<T>], plane: &mut [T], work: &mut Work<'_, T>) {
        let Shape { rows, columns, .. } = self.shape;
        let half = self.shape.half();
        let along = matches!(self.columns, Columns::Along(..));
        match &self.columns {
            Columns::Alone => {}
            Columns::Across(transform) => self.across::<true>(transform, spectrum, work.line),
            Columns::Along(_, inverse) => {
                inverse.process_with_scratch(spectrum, work.inner);
                transpose(spectrum, work.by_rows, rows, half);
            }
        }
        let by_rows = if along { &mut *work.by_rows } else { spectrum };
        for (from, row) in by_rows.chunks_exact_mut(self.pitch).zip(plane.chunks_exact_mut(columns))
        {
            let from = &mut from[..half];
            from[0].im = T::zero();
            if columns.is_multiple_of(2) {
                from[half - 1].im = T::zero();
            }
            self.rows_inverse.process_with_scratch(from, row, work.inner).expect("planned lengths");
        }
    }

    /// All columns of a spectrum forward, to natural order, or back.
    fn across<const INVERSE: bool>(
        &self,
        transform: &Transform<T>,
        spectrum: &mut [Complex<T>],
        line: &mut [T],
    ) {
        let lanes = self.isa.lanes::<T>();
        let (line, work) = line.split_at_mut(2 * lanes * transform.len());
        let (from, to) = (transform.inputs(), transform.outputs());
        let (from, to) = if INVERSE { (to, from) } else { (from, to) };
        let spectrum = cast_slice_mut(spectrum);
        for first in (0..self.pitch).step_by(lanes) {
            let rows = TileMut::dense(spectrum, 2 * self.pitch);
            self.isa.run(Enter { rows: rows.reader(), first, places: from, line });
            if INVERSE {
                transform.inverse(line, work);
            } else {
                transform.forward(line, work);
            }
            self.isa.run(Leave { rows, first, places: to, line });
        }
    }

    /// Whether a column of the spectrum is that of DC or Nyquist, real before the transform of the columns.
    fn is_real(&self, v: usize) -> bool {
        v == 0 || 2 * v == self.shape.columns
    }

    /// Where a bin stands in a spectrum.
    fn place(&self, u: usize, v: usize) -> usize {
        match self.columns {
            Columns::Along(..) => v * self.shape.rows + u,
            _ => u * self.pitch + v,
        }
    }

    /// Where the numbers of one bin of a weight `(bins, lanes, 2)` stand in its packed form.
    fn places(&self, bin: usize) -> impl Iterator<Item = usize> + use<T> {
        let half = self.shape.half();
        let (first, step) = match self.shape.layout {
            Layout::Tokens => (self.place(bin, 0), self.place(0, 1)),
            Layout::Grid => (self.place(bin / half, bin % half), self.spectrum_len()),
        };
        (first..).step_by(step)
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
        packed.fill(Complex::default());
        let lanes = 2 * weight.len_of(Axis(1));
        let weight = weight.to_slice().expect("a weight has no gaps");
        for (bin, lanes) in weight.chunks_exact(lanes).enumerate() {
            for (&[re, im], place) in lanes.as_chunks().0.iter().zip(self.places(bin)) {
                let w = Complex::new(re, im) * norm;
                packed[place] = if factor == Factor::Conjugate { w.conj() } else { w };
            }
        }
    }
}

impl<X: Stored<Real: Real>> Kernel<X> for AlongLines<X::Real> {
    fn tile(&self) -> usize {
        self.shape.lanes
    }

    fn scratch_len(&self) -> usize {
        let planes = 2 * self.planes() * self.plane_len();
        let spectra = 2 * (3 * self.spectrum_len() + self.inner_len());
        slack::<X::Real>() + self.line_len() + planes + spectra
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        Some(self)
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.packed_len(lanes)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        packed: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
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

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
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
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        _: &mut Team<'_, X::Real>,
    ) {
        let sums: &[Complex<X::Real>] = cast_slice(grad_sum);
        let (once, twice) = (self.norm(1.0), self.norm(2.0));
        let (half, lanes) = (self.shape.half(), 2 * grad_weight.len_of(Axis(1)));
        let grad_weight = grad_weight.as_slice_mut().expect("a weight has no gaps");
        for (bin, lanes) in grad_weight.chunks_exact_mut(lanes).enumerate() {
            let numbers = lanes.as_chunks_mut().0.iter_mut().zip(self.places(bin));
            for (lane, (g, place)) in numbers.enumerate() {
                let column = if self.shape.layout == Layout::Tokens { lane } else { bin % half };
                let sum = sums[place] * if self.is_real(column) { once } else { twice };
                *g = [sum.re, sum.im];
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

/// Columns `first` and following of a spectrum as one complex line.
struct Enter<'a, T> {
    rows: Tile<'a, T>,
    first: usize,
    places: &'a [usize],
    line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Enter<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (rows, line) = (self.rows.skip_lanes(2 * self.first), complex_vectors::<V>(self.line));
        for (row, &place) in self.places.iter().enumerate() {
            line[place] = rows.complex(row);
        }
    }
}

/// Undoes [`Enter`].
struct Leave<'a, T> {
    rows: TileMut<'a, T>,
    first: usize,
    places: &'a [usize],
    line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Leave<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let mut rows = self.rows.skip_lanes(2 * self.first);
        for (row, &place) in self.places.iter().enumerate() {
            rows.set_complex(row, complex_vectors::<V>(self.line)[place]);
        }
    }
}
