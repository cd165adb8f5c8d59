//! Two vectors of a row as the real and the imaginary part of a complex line, and its two spectra.

use super::SpectrumRows;
use crate::fft::codelets::pair::{join, split};
use crate::simd::{Algorithm, Complex, Element, Tile, TileMut, Vector, complex_vectors};

/// Two vectors of each point as one complex line.
pub(super) struct EnterVectors<'a, T> {
    pub(super) image: Tile<'a, T>,
    pub(super) inputs: &'a [usize],
    pub(super) line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for EnterVectors<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let second = self.image.skip_lanes(V::LANES);
        for (point, &input) in self.inputs.iter().enumerate() {
            let ([re], [im]) = (self.image.gather(point, 1), second.gather(point, 1));
            line[input] = Complex::new(re, im);
        }
    }
}

/// Undoes [`EnterVectors`].
pub(super) struct LeaveVectors<'a, T> {
    pub(super) image: TileMut<'a, T>,
    pub(super) inputs: &'a [usize],
    pub(super) line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for LeaveVectors<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let line = complex_vectors::<V>(self.line);
        for (point, &input) in self.inputs.iter().enumerate() {
            self.image.scatter(point, 1, [line[input].re]);
            self.image.skip_lanes(V::LANES).scatter(point, 1, [line[input].im]);
        }
    }
}

/// The doubled spectra of the two real lines of a complex line, to vectors `2 pair` and `2 pair + 1` of the rows.
pub(super) struct SplitVectors<'a, T> {
    pub(super) outputs: &'a [usize],
    pub(super) line: &'a mut [T],
    pub(super) spectrum: &'a mut [T],
    pub(super) rows: SpectrumRows,
    pub(super) pair: usize,
}

impl<T: Element> Algorithm<T> for SplitVectors<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let rows = complex_vectors::<V>(self.spectrum).chunks_exact_mut(self.rows.pitch);
        let length = self.outputs.len();
        for (k, row) in rows.enumerate() {
            let mirror = self.outputs[(length - k) % length];
            let both = split(line[self.outputs[k]], line[mirror]);
            row[2 * self.pair..2 * self.pair + 2].copy_from_slice(&both);
        }
    }
}

/// Undoes [`SplitVectors`] up to a factor 2. The spectra of real lines are real in rows 0 and `X / 2`.
pub(super) struct JoinVectors<'a, T> {
    pub(super) outputs: &'a [usize],
    pub(super) line: &'a mut [T],
    pub(super) spectrum: &'a mut [T],
    pub(super) rows: SpectrumRows,
    pub(super) pair: usize,
}

impl<T: Element> Algorithm<T> for JoinVectors<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let rows = complex_vectors::<V>(self.spectrum).chunks_exact(self.rows.pitch);
        let length = self.outputs.len();
        for (k, row) in rows.enumerate() {
            let [a, b] = [row[2 * self.pair], row[2 * self.pair + 1]];
            let (place, mirror) = (self.outputs[k], self.outputs[(length - k) % length]);
            if place == mirror {
                line[place] = Complex::new(a.re, b.re);
            } else {
                (line[place], line[mirror]) = join([a, b]);
            }
        }
    }
}
