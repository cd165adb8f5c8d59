//! Where columns and their places are in a spectrum and in a packed weight.

use super::First;
use super::pointwise::At;

/// Where columns and their places are.
#[derive(Clone, Copy)]
pub(crate) struct Geometry<'a> {
    /// The position of each frequency.
    pub(crate) outputs: &'a [usize],
    /// Columns of one vector.
    pub(super) count: usize,
    /// Complex vectors from one column to the next.
    pub(crate) pitch: usize,
    pub(super) first: First,
    pub(super) first_places: usize,
}

impl Geometry<'_> {
    /// Whether a column is two real lines.
    #[inline(always)]
    pub(crate) fn is_pair(&self, column: usize) -> bool {
        column == 0 && self.first == First::TwoReal
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
