//! Rows of lengths with a codelet: all of a tile, one after the other.

use crate::fft::codelets::{Codelet, Dft, RealDft, RealLine, TwoReal};
use crate::simd::{Algorithm, Stored, Tile, TileMut, Vector, complex_vectors};
use crate::tuning::GRID_AHEAD;

/// A row, whose frequencies stay where the codelets leave them.
pub(super) type Row<const P: usize, const Q: usize, const ROWS: usize> =
    RealLine<P, Q, ROWS, false>;

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

/// Rows to columns, of the first lanes that fill the vectors of `spectrum`.
pub(super) struct RowsForward<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    pub(super) image: Tile<'a, X>,
    pub(super) place: Place<'a>,
    pub(super) spectrum: &'a mut [X::Real],
    pub(super) work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for RowsForward<'_, X, P, Q, ROWS>
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
                    prefetch::<_, P, Q>(self.image, first, i, vectors);
                }
                let image = self.image.skip_lanes(i * V::LANES);
                Row::<P, Q, ROWS>::forward(image, first, spectrum, position, pitch, work);
            }
        }
    }
}

/// Columns to rows.
pub(super) struct RowsInverse<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    pub(super) image: TileMut<'a, X>,
    pub(super) place: Place<'a>,
    pub(super) spectrum: &'a mut [X::Real],
    pub(super) work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for RowsInverse<'_, X, P, Q, ROWS>
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
                    prefetch::<_, P, Q>(self.image.reader(), first, i, vectors);
                }
                let image = &mut self.image.skip_lanes(i * V::LANES);
                Row::<P, Q, ROWS>::inverse(spectrum, position, pitch, image, first, work);
            }
        }
    }
}

/// Asks for a share of the row behind that from point `first` on.
#[inline(always)]
fn prefetch<X: Stored, const P: usize, const Q: usize>(
    image: Tile<'_, X>,
    first: usize,
    share: usize,
    shares: usize,
) {
    let ahead = first + GRID_AHEAD.max(P * Q);
    if P * Q < GRID_AHEAD {
        image.prefetch_share(ahead, P * Q, share, shares);
    } else {
        image.call_prefetch_share(ahead, P * Q, share, shares);
    }
}
