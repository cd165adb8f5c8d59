//! Where columns and their places are in a spectrum and in a packed weight.

use super::First;
use super::pointwise::At;
use crate::simd::Element;

/// Where columns and their places are.
pub(crate) struct Geometry<'a, T> {
    /// The position of each frequency.
    pub(crate) outputs: &'a [usize],
    /// Columns of one vector.
    pub(super) count: usize,
    /// Complex vectors from one column to the next.
    pub(crate) pitch: usize,
    pub(super) first: &'a First<T>,
    pub(super) first_places: usize,
}

impl<T> Clone for Geometry<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Geometry<'_, T> {}

impl<T: Element> Geometry<'_, T> {
    /// Whether a column is two real lines.
    #[inline(always)]
    pub(crate) fn is_pair(&self, column: usize) -> bool {
        column == 0 && !self.first.is_complex()
    }

    /// Column and vector of each of `lines` lines, in the order in which a weight in natural order is read in longer runs.
    #[inline(always)]
    pub(crate) fn lines(self, lines: usize) -> impl Iterator<Item = (usize, usize)> {
        let vectors = lines / self.count;
        (0..self.count).flat_map(move |column| (0..vectors).map(move |vector| (column, vector)))
    }

    /// Where a line begins.
    #[inline(always)]
    pub(crate) fn at(&self, column: usize, vector: usize) -> At {
        let place =
            if column == 0 { 0 } else { self.first_places + (column - 1) * self.outputs.len() };
        At { vector, position: (vector * self.count + column) * self.pitch, place }
    }
}
