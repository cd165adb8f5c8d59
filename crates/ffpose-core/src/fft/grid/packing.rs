//! The weight of a grid to kernel order.

use std::ops::Range;

use ndarray::{ArrayView3, Axis};

use super::Grid;
use crate::kernel::{Factor, Packing};
use crate::parallel::Team;
use crate::simd::Element;
use crate::views;

impl<T: Element> Packing<T> for Grid<T> {
    fn packed_len(&self, lanes: usize) -> usize {
        lanes.div_ceil(self.lanes) * self.columns.packed_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        lanes: Range<usize>,
        factor: Factor,
        packed: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let packed = &mut packed[..self.packed_len(lanes.len())];
        let weight = views::bins_of(weight, lanes, self.lanes);
        if weight.len_of(Axis(1)) < self.lanes {
            let [room, _] = self.scratch(team.scratch()).bins;
            let weight = views::padded_bins(weight, self.lanes, room);
            self.order.pack(self.isa, weight, factor, packed);
        } else {
            self.order.pack(self.isa, weight, factor, packed);
        }
    }
}
