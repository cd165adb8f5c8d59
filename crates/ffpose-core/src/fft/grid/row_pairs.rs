//! Rows of any length: two of them are the real and the imaginary part of a complex line.

use crate::fft::codelets::pair;
use crate::simd::{Algorithm, Complex, Element, Stored, Tile, TileMut, Vector, complex_vectors};

/// The lines of a pair of rows as one complex line; a missing second row is zero.
pub(super) struct EnterPair<'a, X: Stored> {
    pub(super) inputs: &'a [usize],
    pub(super) image: Tile<'a, X>,
    pub(super) first: usize,
    pub(super) second: Option<usize>,
    pub(super) line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for EnterPair<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let line = complex_vectors::<V>(self.line);
        for (column, &input) in self.inputs.iter().enumerate() {
            let [re] = self.image.gather(self.first + column, 1);
            let im = match self.second {
                Some(second) => self.image.gather::<V, 1>(second + column, 1)[0],
                None => V::splat(X::Real::default()),
            };
            line[input] = Complex::new(re, im);
        }
    }
}

/// The real part of a complex line to a row, the imaginary part to a second one.
pub(super) struct LeavePair<'a, 'b, X: Stored> {
    pub(super) inputs: &'a [usize],
    pub(super) image: &'a mut TileMut<'b, X>,
    pub(super) first: usize,
    pub(super) second: Option<usize>,
    pub(super) line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for LeavePair<'_, '_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let line = complex_vectors::<V>(self.line);
        for (column, &input) in self.inputs.iter().enumerate() {
            self.image.scatter(self.first + column, 1, [line[input].re]);
            if let Some(second) = self.second {
                self.image.scatter(second + column, 1, [line[input].im]);
            }
        }
    }
}

/// The doubled spectra of the two rows of a complex line, to places `[first, second]` of the columns.
pub(super) struct SplitPair<'a, T> {
    pub(super) outputs: &'a [usize],
    pub(super) line: &'a mut [T],
    pub(super) spectrum: &'a mut [T],
    pub(super) pitch: usize,
    pub(super) places: [usize; 2],
}

impl<T: Element> Algorithm<T> for SplitPair<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, spectrum) =
            (complex_vectors::<V>(self.line), complex_vectors::<V>(self.spectrum));
        let (outputs, width, [first, second]) = (self.outputs, self.outputs.len(), self.places);
        let z = line[outputs[0]];
        let nyquist =
            if width.is_multiple_of(2) { line[outputs[width / 2]] } else { Complex::zero() };
        // the second first: a row without a partner has the place of its partner
        spectrum[second] = Complex::new(z.im + z.im, nyquist.im + nyquist.im);
        spectrum[first] = Complex::new(z.re + z.re, nyquist.re + nyquist.re);
        for k in 1..width.div_ceil(2) {
            let both = pair::split(line[outputs[k]], line[outputs[width - k]]);
            spectrum[k * self.pitch + second] = both[1];
            spectrum[k * self.pitch + first] = both[0];
        }
    }
}

/// Undoes [`SplitPair`] up to a factor 2.
pub(super) struct JoinPair<'a, T> {
    pub(super) outputs: &'a [usize],
    pub(super) line: &'a mut [T],
    pub(super) spectrum: &'a mut [T],
    pub(super) pitch: usize,
    pub(super) places: [usize; 2],
}

impl<T: Element> Algorithm<T> for JoinPair<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, spectrum) =
            (complex_vectors::<V>(self.line), complex_vectors::<V>(self.spectrum));
        let (outputs, width, [first, second]) = (self.outputs, self.outputs.len(), self.places);
        let (a, b) = (spectrum[first], spectrum[second]);
        if width.is_multiple_of(2) {
            line[outputs[width / 2]] = Complex::new(a.im, b.im);
        }
        line[outputs[0]] = Complex::new(a.re, b.re);
        for k in 1..width.div_ceil(2) {
            let both = [spectrum[k * self.pitch + first], spectrum[k * self.pitch + second]];
            let (z, mirror) = pair::join(both);
            line[outputs[k]] = z;
            line[outputs[width - k]] = mirror;
        }
    }
}
