//! Rows of an image, as real lines of vectors, to slots of a block and back.
//!
//! A line of `M` vectors has `M / 2` slots: slot `k` is frequency `k`, and slot 0 has the two real frequencies 0 and `M / 2` as
//! real and imaginary part.

use super::blocks::Block;
use crate::fft::codelets::{Codelet, Dft, RealDft, RealLine, TwoReal, with_codelet};
use crate::simd::{Algorithm, Isa, Stored, Tile, TileMut, Vector, complex_vectors};

/// Rows of `image` to rows of `block`; `work` has room for half a line of complex vectors. Where memory is far, `target` is where
/// the rows go after that: it is asked for in time, and so are the rows of the next call.
#[inline(always)]
pub(super) fn forward<X: Stored>(
    isa: Isa,
    image: Tile<'_, X>,
    target: Option<Tile<'_, X::Real>>,
    block: Block<'_, X::Real>,
    work: &mut [X::Real],
) {
    with_codelet!(line image.lanes() / isa.lanes::<X::Real>(), (P, Q, ROWS) => {
        isa.run(LinesForward::<X, P, Q, ROWS> { image, target, block, work });
    }, _ => unreachable!("planned lengths"));
}

/// Rows of `block`, doubled but for slot 0, to rows of `image`, up to a factor of their length. Where memory is far, the rows of
/// the next call are asked for.
#[inline(always)]
pub(super) fn inverse<X: Stored>(
    isa: Isa,
    block: Block<'_, X::Real>,
    image: TileMut<'_, X>,
    work: &mut [X::Real],
    far: bool,
) {
    with_codelet!(line image.reader().lanes() / isa.lanes::<X::Real>(), (P, Q, ROWS) => {
        isa.run(LinesInverse::<X, P, Q, ROWS> { block, image, work, far });
    }, _ => unreachable!("planned lengths"));
}

struct LinesForward<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    image: Tile<'a, X>,
    target: Option<Tile<'a, X::Real>>,
    block: Block<'a, X::Real>,
    work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for LinesForward<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Block { vectors, pitch } = self.block;
        let (block, work) = (complex_vectors::<V>(vectors), complex_vectors::<V>(self.work));
        for row in 0..self.image.points() {
            let line = self.image.point(row, V::LANES);
            if let Some(target) = self.target {
                line.prefetch_behind(); // of the next `x2`
                target.point(row, V::LANES).prefetch_all();
            }
            RealLine::<P, Q, ROWS, true>::forward(line, 0, block, row * pitch, 1, work);
        }
    }
}

struct LinesInverse<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    block: Block<'a, X::Real>,
    image: TileMut<'a, X>,
    work: &'a mut [X::Real],
    far: bool,
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for LinesInverse<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let Block { vectors, pitch } = self.block;
        let (block, work) = (complex_vectors::<V>(vectors), complex_vectors::<V>(self.work));
        for row in 0..self.image.reader().points() {
            let mut line = self.image.point(row, V::LANES);
            if self.far {
                line.reader().prefetch_behind(); // of the next `x2`
            }
            RealLine::<P, Q, ROWS, true>::inverse(block, row * pitch, 1, &mut line, 0, work);
        }
    }
}
