//! The weight of a grid to kernel order.

use ndarray::{ArrayView3, ArrayViewMut3, Axis, s};

use super::Grid;
use crate::kernel::{Factor, Packing};
use crate::parallel::Team;
use crate::simd::Element;

impl<T: Element> Grid<T> {
    /// `room` as a weight `(bins, lanes, 2)` of one vector of lanes.
    pub(super) fn bins<'a>(&self, room: &'a mut [T]) -> ArrayViewMut3<'a, T> {
        let bins = room.len() / (2 * self.lanes);
        ArrayViewMut3::from_shape((bins, self.lanes, 2), room).expect("room for a vector of lanes")
    }

    /// `weight` `(bins, lanes, 2)` with zeros up to one vector, in `room`.
    pub(super) fn padded_bins<'a>(
        &self,
        weight: ArrayView3<'_, T>,
        room: &'a mut [T],
    ) -> ArrayView3<'a, T> {
        let mut whole = self.bins(room);
        whole.fill(T::default());
        whole.slice_mut(s![.., ..weight.len_of(Axis(1)), ..]).assign(&weight);
        ArrayView3::from_shape(whole.raw_dim(), room).expect("room for a vector of lanes")
    }
}

impl<T: Element> Packing<T> for Grid<T> {
    fn packed_len(&self, lanes: usize) -> usize {
        lanes.div_ceil(self.lanes) * self.columns.packed_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        mut packed: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        for lanes in self.parts(weight.len_of(Axis(1)), usize::MAX) {
            let part = packed.split_off_mut(..self.packed_len(lanes.len())).expect("all lanes");
            let weight = weight.slice(s![.., lanes.clone(), ..]);
            if lanes.len().is_multiple_of(self.lanes) {
                self.order.pack(self.isa, weight, factor, part);
            } else {
                let [room, _] = self.scratch(team.scratch()).bins;
                self.order.pack(self.isa, self.padded_bins(weight, room), factor, part);
            }
        }
    }
}
