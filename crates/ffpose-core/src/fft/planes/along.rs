//! realfft along rows and rustfft along columns, for machines without vectors, double precision, images too small for squares of
//! vectors (long sequences of few channels among them), and lines too long for them.

use std::sync::Arc;

use bytemuck::{cast_slice, cast_slice_mut};
use ndarray::{ArrayView2, ArrayViewMut2};
use num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use transpose::transpose;

use super::{Spectra, Sum};
use crate::parallel::Team;
use crate::simd::Stored;
use crate::tuning::GATHERED_POINTS;
use crate::views::in_order;
use crate::{Real, Shape};

/// The spectrum of each lane by columns, one lane after the other.
pub(crate) struct Along<T: Real> {
    rows: usize,
    width: usize,
    lanes: usize,
    /// Complex numbers of the spectrum of a row.
    half: usize,
    /// Of that of a lane.
    bins: usize,
    rows_forward: Arc<dyn RealToComplex<T>>,
    rows_inverse: Arc<dyn ComplexToReal<T>>,
    columns_forward: Arc<dyn Fft<T>>,
    columns_inverse: Arc<dyn Fft<T>>,
}

/// Scratch of a call, cut into its uses.
struct AlongBuffers<'a, T> {
    /// One row of each lane.
    row: &'a mut [T],
    by_rows: &'a mut [Complex<T>],
    inner: &'a mut [Complex<T>],
}

impl<T: Real> Along<T> {
    pub(crate) fn new(shape: Shape) -> Self {
        let (mut rows, mut columns) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            rows: shape.rows,
            width: shape.columns,
            lanes: shape.channels(),
            half: shape.half(),
            bins: shape.bins_len(),
            rows_forward: rows.plan_fft_forward(shape.columns),
            rows_inverse: rows.plan_fft_inverse(shape.columns),
            columns_forward: columns.plan_fft_forward(shape.rows),
            columns_inverse: columns.plan_fft_inverse(shape.rows),
        }
    }

    /// Scratch that the libraries ask for.
    fn inner_len(&self) -> usize {
        let rows = [self.rows_forward.get_scratch_len(), self.rows_inverse.get_scratch_len()];
        let columns = [&self.columns_forward, &self.columns_inverse];
        let columns = columns.map(|columns| columns.get_inplace_scratch_len());
        rows.into_iter().chain(columns).max().expect("four")
    }

    fn buffers<'a>(&self, scratch: &'a mut [T]) -> AlongBuffers<'a, T> {
        let (by_rows, rest) = scratch.split_at_mut(2 * self.lanes * self.bins);
        let (inner, rest) = rest.split_at_mut(2 * self.inner_len());
        AlongBuffers {
            row: &mut rest[..self.lanes * self.width],
            by_rows: cast_slice_mut(by_rows),
            inner: cast_slice_mut(inner),
        }
    }

    /// For few points at a time, whose lanes stay in cache, where each number of a row stands in the row of its lane.
    fn places(&self) -> impl Iterator<Item = (usize, usize)> + use<T> {
        let (width, lanes) = (self.width, self.lanes);
        (0..width).step_by(GATHERED_POINTS).flat_map(move |first| {
            let points = first..width.min(first + GATHERED_POINTS);
            (0..lanes).flat_map(move |lane| {
                points.clone().map(move |point| (point * lanes + lane, lane * width + point))
            })
        })
    }
}

impl<T: Real> Spectra<T> for Along<T> {
    fn numbers(&self) -> usize {
        2 * self.lanes * self.bins
    }

    fn scratch_len(&self) -> usize {
        2 * (self.lanes * self.bins + self.inner_len()) + self.lanes * self.width
    }

    fn gain(&self) -> f64 {
        1.0
    }

    fn pack(&self, weight: &[[T; 2]], norm: [T; 2], packed: &mut [T], _: &mut Team<'_, T>) {
        let packed = packed.as_chunks_mut().0;
        for (u, row) in weight.chunks_exact(self.half * self.lanes).enumerate() {
            for (v, lanes) in row.chunks_exact(self.lanes).enumerate() {
                for (lane, &[re, im]) in lanes.iter().enumerate() {
                    packed[lane * self.bins + v * self.rows + u] = [re * norm[0], im * norm[1]];
                }
            }
        }
    }

    fn unpack(&self, u: usize, sum: &[T], row: &mut [[T; 2]]) {
        let sum = sum.as_chunks().0;
        for (v, lanes) in row.chunks_exact_mut(self.lanes).enumerate() {
            for (lane, to) in lanes.iter_mut().enumerate() {
                *to = sum[lane * self.bins + v * self.rows + u];
            }
        }
    }

    fn shares(&self, _: usize) -> bool {
        false
    }

    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        spectra: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let AlongBuffers { row, by_rows, inner } = self.buffers(team.scratch());
        for (u, numbers) in image.outer_iter().enumerate() {
            let numbers = numbers.to_slice().expect("a row has no gaps");
            self.places().for_each(|(from, to)| row[to] = numbers[from].widened());
            for (lane, row) in row.chunks_exact_mut(self.width).enumerate() {
                let to = &mut by_rows[lane * self.bins + u * self.half..][..self.half];
                self.rows_forward.process_with_scratch(row, to, inner).expect("planned lengths");
            }
        }
        let spectra: &mut [Complex<T>] = cast_slice_mut(spectra);
        let lanes = by_rows.chunks_exact(self.bins).zip(spectra.chunks_exact_mut(self.bins));
        lanes.for_each(|(by_rows, to)| transpose(by_rows, to, self.half, self.rows));
    }

    fn filter_columns(
        &self,
        spectra: &mut [T],
        factor: Option<&[T]>,
        sum: Option<Sum<'_, T>>,
        team: &mut Team<'_, T>,
    ) {
        let AlongBuffers { inner, .. } = self.buffers(team.scratch());
        let len = 2 * self.bins;
        let (x, sum) = sum.map(|Sum { x, sum }| (x, sum)).unzip();
        let x = in_order(self.lanes, x.map(|x| x.chunks_exact_mut(len)));
        let sums = in_order(self.lanes, sum.map(|sum| sum.chunks_exact_mut(len)));
        let factors = in_order(self.lanes, factor.map(|factor| factor.chunks_exact(len)));
        // lane by lane, while one is in cache
        for (((lane, x), sum), factor) in
            spectra.chunks_exact_mut(len).zip(x).zip(sums).zip(factors)
        {
            let lane: &mut [Complex<T>] = cast_slice_mut(lane);
            self.columns_forward.process_with_scratch(lane, inner);
            if let (Some(x), Some(sum)) = (x, sum) {
                let (x, sum): (&mut [Complex<T>], &mut [Complex<T>]) =
                    (cast_slice_mut(x), cast_slice_mut(sum));
                self.columns_forward.process_with_scratch(x, inner);
                for ((sum, x), value) in sum.iter_mut().zip(x).zip(&*lane) {
                    *sum = *sum + x.conj() * *value;
                }
            }
            if let Some(factor) = factor {
                let factor: &[Complex<T>] = cast_slice(factor);
                lane.iter_mut().zip(factor).for_each(|(value, w)| *value = *value * *w);
                self.columns_inverse.process_with_scratch(lane, inner);
            }
        }
    }

    fn leave<X: Stored<Real = T>>(
        &self,
        spectra: &mut [T],
        mut image: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, T>,
    ) {
        let AlongBuffers { row, by_rows, inner } = self.buffers(team.scratch());
        let spectra: &[Complex<T>] = cast_slice(spectra);
        let lanes = spectra.chunks_exact(self.bins).zip(by_rows.chunks_exact_mut(self.bins));
        lanes.for_each(|(from, by_rows)| transpose(from, by_rows, self.rows, self.half));
        for (u, numbers) in image.outer_iter_mut().enumerate() {
            for (lane, row) in row.chunks_exact_mut(self.width).enumerate() {
                let from = &mut by_rows[lane * self.bins + u * self.half..][..self.half];
                from[0].im = T::zero();
                if self.width.is_multiple_of(2) {
                    from[self.width / 2].im = T::zero();
                }
                self.rows_inverse.process_with_scratch(from, row, inner).expect("planned lengths");
            }
            let numbers = numbers.into_slice().expect("a row has no gaps");
            self.places().for_each(|(to, from)| numbers[to] = X::nearest_to(row[from]));
        }
    }
}
