//! Images of one channel side by side, by squares of vectors.

use crate::simd::{Algorithm, MAX_LANES, Stored, Tile, TileMut, Vector, squares, transpose_square};

/// Images `(images, points)`, at most as many as a vector has lanes, to `stage` `(points, lanes)`. Lanes without one are zero.
pub(super) struct Enter<'a, X: Stored> {
    pub(super) images: Tile<'a, X>,
    pub(super) points: usize,
    pub(super) stage: &'a mut [X],
}

impl<X: Stored> Algorithm<X::Real> for Enter<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let mut stage = TileMut::dense(self.stage, V::LANES);
        for start in squares::<V>(self.points) {
            let images = self.images.skip_lanes(start);
            let mut square = [V::splat(X::Real::default()); MAX_LANES];
            for i in 0..images.points() {
                [square[i]] = images.gather(i, 1);
            }
            transpose_square(&mut square);
            for i in 0..V::LANES {
                stage.scatter(start + i, 1, [square[i]]);
            }
        }
    }
}

/// Undoes [`Enter`].
pub(super) struct Leave<'a, X: Stored> {
    pub(super) stage: &'a [X],
    pub(super) points: usize,
    pub(super) images: TileMut<'a, X>,
}

impl<X: Stored> Algorithm<X::Real> for Leave<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let stage = Tile::dense(self.stage, V::LANES);
        for start in squares::<V>(self.points) {
            let mut square = [V::splat(X::Real::default()); MAX_LANES];
            for i in 0..V::LANES {
                [square[i]] = stage.gather(start + i, 1);
            }
            transpose_square(&mut square);
            let mut images = self.images.skip_lanes(start);
            for i in 0..images.reader().points() {
                images.scatter(i, 1, [square[i]]);
            }
        }
    }
}
