//! The rows of a grid: real lines of one length, from an image to columns of complex vectors and back.
//!
//! Row `h` becomes place `positions[h]` of each column, column `s` starts at `s * pitch`, and `frequencies[s]` is what column
//! `s` holds. Column 0 of an even length packs the real frequencies 0 and `W / 2` as real and imaginary part.

use super::row_codelets::{Place, Row, RowsForward, RowsInverse};
use super::row_pairs::{EnterPair, JoinPair, LeavePair, SplitPair};
use crate::fft::codelets::{has_codelet, with_codelet};
use crate::fft::transform::Transform;
use crate::simd::{Element, Isa, Stored, Tile, TileMut};
use crate::tuning::GRID_AHEAD;

/// How lines of one length are transformed.
pub(crate) enum Rows<T> {
    /// By a real codelet of this length.
    Codelet(usize),
    /// Two by two, as real and imaginary part of a complex line. The spectrum comes out doubled.
    Pairs(Transform<T>),
}

impl<T: Element> Rows<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        if has_codelet!(row length) {
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
                    (P, Q, ROWS) => Row::<P, Q, ROWS>::FREQUENCIES.as_flattened().to_vec(),
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

    /// Complex vectors of scratch that a run needs.
    pub(crate) fn work_len(&self) -> usize {
        match self {
            Self::Codelet(length) => length.div_ceil(2),
            Self::Pairs(transform) => transform.len() + transform.work_len(),
        }
    }

    /// All rows of `image`, of its first lanes that fill the vectors of `spectrum`, to the columns of that.
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
                (P, Q, ROWS) => isa.run(RowsForward::<X, P, Q, ROWS> { image, place, spectrum, work }),
                _ => unreachable!("planned lengths")),
            Self::Pairs(transform) => {
                let (inputs, outputs) = (transform.inputs(), transform.outputs());
                let (width, lanes) = (transform.len(), isa.lanes::<T>());
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
                        isa.run(EnterPair { inputs, image, first, second, line });
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
                (P, Q, ROWS) => isa.run(RowsInverse::<X, P, Q, ROWS> { image, place, spectrum, work }),
                _ => unreachable!("planned lengths")),
            Self::Pairs(transform) => {
                let (inputs, outputs) = (transform.inputs(), transform.outputs());
                let (width, lanes) = (transform.len(), isa.lanes::<T>());
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
                        isa.run(LeavePair { inputs, image, first, second, line });
                    }
                }
            }
        }
    }
}
