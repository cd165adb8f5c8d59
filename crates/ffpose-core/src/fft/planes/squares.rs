//! Rows of a spectrum to lanes and back, by squares of vectors.

use super::SpectrumRows;
use crate::simd::{Algorithm, Complex, Element, MAX_LANES, Vector, complex_vectors};

/// Rows `first` and following of a spectrum as the lanes of a line; lanes without a row repeat the last one.
#[derive(Clone, Copy)]
pub(super) struct RowBlock<'a> {
    pub(super) rows: SpectrumRows,
    pub(super) first: usize,
    pub(super) inputs: &'a [usize],
}

/// Rows to lanes.
pub(super) struct Gather<'a, T> {
    pub(super) block: RowBlock<'a>,
    pub(super) spectrum: &'a mut [T],
    pub(super) line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Gather<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let RowBlock { rows: SpectrumRows { count, pitch }, first, inputs } = self.block;
        let spectrum = complex_vectors::<V>(self.spectrum);
        let line = complex_vectors::<V>(self.line);
        let (mut re, mut im) =
            ([V::splat(T::default()); MAX_LANES], [V::splat(T::default()); MAX_LANES]);
        for (vector, inputs) in inputs.chunks(V::LANES).enumerate() {
            for lane in 0..V::LANES {
                let z = spectrum[(first + lane).min(count - 1) * pitch + vector];
                (re[lane], im[lane]) = (z.re, z.im);
            }
            V::transpose(&mut re[..V::LANES]);
            V::transpose(&mut im[..V::LANES]);
            for (lane, &input) in inputs.iter().enumerate() {
                line[input] = Complex::new(re[lane], im[lane]);
            }
        }
    }
}

/// Lanes to rows.
pub(super) struct Put<'a, T> {
    pub(super) block: RowBlock<'a>,
    pub(super) spectrum: &'a mut [T],
    pub(super) line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Put<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let RowBlock { rows: SpectrumRows { count, pitch }, first, inputs } = self.block;
        let spectrum = complex_vectors::<V>(self.spectrum);
        let line = complex_vectors::<V>(self.line);
        let (mut re, mut im) =
            ([V::splat(T::default()); MAX_LANES], [V::splat(T::default()); MAX_LANES]);
        for (vector, inputs) in inputs.chunks(V::LANES).enumerate() {
            for (lane, &input) in inputs.iter().enumerate() {
                (re[lane], im[lane]) = (line[input].re, line[input].im);
            }
            V::transpose(&mut re[..V::LANES]);
            V::transpose(&mut im[..V::LANES]);
            for (lane, row) in (first..count.min(first + V::LANES)).enumerate() {
                spectrum[row * pitch + vector] = Complex::new(re[lane], im[lane]);
            }
        }
    }
}
