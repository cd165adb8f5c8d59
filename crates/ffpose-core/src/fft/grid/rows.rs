//! The rows of a grid: real lines of one length, from an image to columns of complex vectors and back.
//!
//! Row `h` becomes place `positions[h]` of each column, column `s` starts at `s * pitch`, and `frequencies[s]` is what column
//! `s` holds. Column 0 of an even length packs the real frequencies 0 and `W / 2` as real and imaginary part.

use super::composite::CompositeRow;
use crate::fft::codelets::{Codelet, Dft, RealDft, TwoReal, has_codelet, pair, with_codelet};
use crate::fft::transform::Transform;
use crate::simd::{
    Algorithm, Complex, Element, Isa, Stored, Tile, TileMut, Vector, complex_vectors, gather,
    scatter,
};
use crate::tuning::GRID_AHEAD;

/// How lines of one length are transformed.
pub(crate) enum Rows<T> {
    /// By a real codelet of this length.
    Codelet(usize),
    /// Two by two, as real and imaginary part of a complex line. The spectrum comes out doubled.
    Pairs(Transform<T>),
}

/// Where columns are.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    pub(crate) positions: &'a [usize],
    pub(crate) pitch: usize,
    /// Complex vectors of all columns: those of the next lanes of the tile follow.
    pub(crate) set: usize,
    /// Whether the image comes from memory, which is worth asking for ahead of the work.
    pub(crate) far: bool,
}

impl<T: Element> Rows<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        if isa.is_tuned::<T>() && has_codelet!(row length) {
            Self::Codelet(length)
        } else {
            Self::Pairs(Transform::new(isa, length))
        }
    }

    /// The frequency of each column.
    pub(crate) fn frequencies(&self) -> Vec<usize> {
        match self {
            Self::Codelet(length) => {
                with_codelet!(row *length,
                    (N, S) => <Codelet as RealDft<N, S>>::FREQUENCIES.to_vec(),
                    (P, Q, ROWS) => CompositeRow::<P, Q, ROWS>::frequencies(),
                    _ => unreachable!("planned lengths"))
            }
            Self::Pairs(transform) => (0..transform.len().div_ceil(2)).collect(),
        }
    }

    /// What the spectrum is multiplied by.
    pub(crate) fn gain(&self) -> f64 {
        match self {
            Self::Codelet(_) => 1.0,
            Self::Pairs(_) => 2.0,
        }
    }

    /// What columns after the first have to be multiplied by for the way back.
    pub(crate) fn inverse_gain(&self) -> f64 {
        match self {
            Self::Codelet(_) => 2.0,
            Self::Pairs(_) => 1.0,
        }
    }

    /// Complex vectors of scratch that a run needs.
    pub(crate) fn work_len(&self) -> usize {
        match self {
            Self::Codelet(length) => length / 2,
            Self::Pairs(transform) => transform.len() + transform.work_len(),
        }
    }

    /// All rows of `image` to the columns of `spectrum`.
    pub(crate) fn forward<X: Stored<Real = T>>(
        &self,
        isa: Isa,
        image: Tile<'_, X>,
        place: Place<'_>,
        spectrum: &mut [T],
        work: &mut [T],
    ) {
        match self {
            Self::Codelet(length) => with_codelet!(row *length,
                (N, S) => isa.run_tuned(ShortForward::<X, N, S> { image, place, spectrum }),
                (P, Q, ROWS) => isa.run_tuned(CompositeForward::<X, P, Q, ROWS> { image, place, spectrum, work }),
                _ => unreachable!("planned lengths")),
            Self::Pairs(transform) => {
                let (outputs, width, lanes) =
                    (transform.outputs(), transform.len(), isa.lanes::<T>());
                let (line, work) = work.split_at_mut(2 * lanes * width);
                for (pair, places) in place.positions.chunks(2).enumerate() {
                    let first = 2 * pair * width;
                    let second = (places.len() == 2).then_some(first + width);
                    let places = [places[0], places[places.len() - 1]];
                    let spectra = spectrum.chunks_exact_mut(2 * lanes * place.set);
                    let vectors = spectra.len();
                    for (i, spectrum) in spectra.enumerate() {
                        if place.far {
                            let ahead = first + GRID_AHEAD.max(2 * width);
                            image.prefetch_share(ahead, 2 * width, i, vectors);
                        }
                        let image = image.skip_lanes(i * lanes);
                        isa.run(EnterPair {
                            inputs: transform.inputs(),
                            image,
                            first,
                            second,
                            line,
                        });
                        transform.forward(line, work);
                        isa.run(SplitPair { outputs, line, spectrum, pitch: place.pitch, places });
                    }
                }
            }
        }
    }

    /// The columns of `spectrum` to all rows of `image`.
    pub(crate) fn inverse<X: Stored<Real = T>>(
        &self,
        isa: Isa,
        spectrum: &mut [T],
        place: Place<'_>,
        mut image: TileMut<'_, X>,
        work: &mut [T],
    ) {
        match self {
            Self::Codelet(length) => with_codelet!(row *length,
                (N, S) => isa.run_tuned(ShortInverse::<X, N, S> { image, place, spectrum }),
                (P, Q, ROWS) => isa.run_tuned(CompositeInverse::<X, P, Q, ROWS> { image, place, spectrum, work }),
                _ => unreachable!("planned lengths")),
            Self::Pairs(transform) => {
                let (outputs, width, lanes) =
                    (transform.outputs(), transform.len(), isa.lanes::<T>());
                let (line, work) = work.split_at_mut(2 * lanes * width);
                for (pair, places) in place.positions.chunks(2).enumerate() {
                    let first = 2 * pair * width;
                    let second = (places.len() == 2).then_some(first + width);
                    let places = [places[0], places[places.len() - 1]];
                    let spectra = spectrum.chunks_exact_mut(2 * lanes * place.set);
                    let vectors = spectra.len();
                    for (i, spectrum) in spectra.enumerate() {
                        if place.far {
                            let ahead = first + GRID_AHEAD.max(2 * width);
                            image.reader().prefetch_share(ahead, 2 * width, i, vectors);
                        }
                        let image = &mut image.skip_lanes(i * lanes);
                        isa.run(JoinPair { outputs, line, spectrum, pitch: place.pitch, places });
                        transform.inverse(line, work);
                        isa.run(LeavePair {
                            inputs: transform.inputs(),
                            image,
                            first,
                            second,
                            line,
                        });
                    }
                }
            }
        }
    }
}

struct ShortForward<'a, X: Stored, const N: usize, const S: usize> {
    image: Tile<'a, X>,
    place: Place<'a>,
    spectrum: &'a mut [X::Real],
}

impl<X: Stored, const N: usize, const S: usize> Algorithm<X::Real> for ShortForward<'_, X, N, S>
where
    Codelet: RealDft<N, S>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Place { positions, pitch, set, far } = self.place;
        let spectrum = complex_vectors::<V>(self.spectrum);
        let vectors = spectrum.len() / set;
        for (row, &position) in positions.iter().enumerate() {
            for (i, spectrum) in spectrum.chunks_exact_mut(set).enumerate() {
                if far {
                    self.image.prefetch_share(row * N + GRID_AHEAD.max(N), N, i, vectors);
                }
                let image = self.image.skip_lanes(i * V::LANES);
                let line = image.gather::<V, N>(row * N, 1);
                scatter(spectrum, position, pitch, <Codelet as RealDft<N, S>>::real_dft(line));
            }
        }
    }
}

struct CompositeForward<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    image: Tile<'a, X>,
    place: Place<'a>,
    spectrum: &'a mut [X::Real],
    work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for CompositeForward<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Place { positions, pitch, set, far } = self.place;
        let (spectrum, work) =
            (complex_vectors::<V>(self.spectrum), complex_vectors::<V>(self.work));
        let vectors = spectrum.len() / set;
        for (row, &position) in positions.iter().enumerate() {
            let first = row * P * Q;
            for (i, spectrum) in spectrum.chunks_exact_mut(set).enumerate() {
                if far {
                    self.image.prefetch_share(first + GRID_AHEAD.max(P * Q), P * Q, i, vectors);
                }
                let image = self.image.skip_lanes(i * V::LANES);
                CompositeRow::<P, Q, ROWS>::forward(image, first, spectrum, position, pitch, work);
            }
        }
    }
}

struct CompositeInverse<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    image: TileMut<'a, X>,
    place: Place<'a>,
    spectrum: &'a mut [X::Real],
    work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for CompositeInverse<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let Place { positions, pitch, set, far } = self.place;
        let (spectrum, work) =
            (complex_vectors::<V>(self.spectrum), complex_vectors::<V>(self.work));
        let vectors = spectrum.len() / set;
        for (row, &position) in positions.iter().enumerate() {
            let first = row * P * Q;
            for (i, spectrum) in spectrum.chunks_exact(set).enumerate() {
                if far {
                    let image = self.image.reader();
                    image.prefetch_share(first + GRID_AHEAD.max(P * Q), P * Q, i, vectors);
                }
                let image = &mut self.image.skip_lanes(i * V::LANES);
                CompositeRow::<P, Q, ROWS>::inverse(spectrum, position, pitch, image, first, work);
            }
        }
    }
}

struct ShortInverse<'a, X: Stored, const N: usize, const S: usize> {
    image: TileMut<'a, X>,
    place: Place<'a>,
    spectrum: &'a mut [X::Real],
}

impl<X: Stored, const N: usize, const S: usize> Algorithm<X::Real> for ShortInverse<'_, X, N, S>
where
    Codelet: RealDft<N, S>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let Place { positions, pitch, set, far } = self.place;
        let spectrum = complex_vectors::<V>(self.spectrum);
        let vectors = spectrum.len() / set;
        for (row, &position) in positions.iter().enumerate() {
            for (i, spectrum) in spectrum.chunks_exact(set).enumerate() {
                if far {
                    self.image.reader().prefetch_share(row * N + GRID_AHEAD.max(N), N, i, vectors);
                }
                let image = &mut self.image.skip_lanes(i * V::LANES);
                let line = <Codelet as RealDft<N, S>>::real_idft(gather(spectrum, position, pitch));
                image.scatter::<V, N>(row * N, 1, line);
            }
        }
    }
}

/// The lines of a pair of rows as one complex line; a missing second row is zero.
struct EnterPair<'a, X: Stored> {
    inputs: &'a [usize],
    image: Tile<'a, X>,
    first: usize,
    second: Option<usize>,
    line: &'a mut [X::Real],
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
struct LeavePair<'a, 'b, X: Stored> {
    inputs: &'a [usize],
    image: &'a mut TileMut<'b, X>,
    first: usize,
    second: Option<usize>,
    line: &'a mut [X::Real],
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
struct SplitPair<'a, T> {
    outputs: &'a [usize],
    line: &'a mut [T],
    spectrum: &'a mut [T],
    pitch: usize,
    places: [usize; 2],
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
struct JoinPair<'a, T> {
    outputs: &'a [usize],
    line: &'a mut [T],
    spectrum: &'a mut [T],
    pitch: usize,
    places: [usize; 2],
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
