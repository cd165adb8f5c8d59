//! One image of a grid: its weight and the gradient of that stay in natural order.

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, s};

use super::row_codelets::Place;
use super::{Grid, GridBuffers};
use crate::fft::columns::pointwise::{NaturalGradient, NaturalProduct};
use crate::kernel::{Factor, Single, SingleBackward};
use crate::parallel::Team;
use crate::simd::{Element, LINE_BYTES, Stored, Tile, TileMut};
use crate::views;

impl<T: Element> Grid<T> {
    /// Lanes of one image that go together: at least a cache line of what is stored.
    fn alone<X>(&self) -> usize {
        self.alone.max(LINE_BYTES / size_of::<X>()).min(self.together)
    }

    /// Whether so many lanes of one image go together without padding; cutting views takes its time.
    fn undivided<X>(&self, lanes: usize) -> bool {
        (self.lanes..=self.alone::<X>()).contains(&lanes)
    }

    /// For lanes of one image: far are those that do not come to the cache by themselves, with their result and their weight.
    fn place_of_one<X>(&self, x: &ArrayView2<'_, X>) -> Place<'_> {
        self.place(!self.tuning.is_prefetched(3 * size_of::<X>() * x.len()))
    }

    /// As [`Single::forward`], for lanes that go together.
    fn forward_single<X: Stored<Real = T>>(
        &self,
        x: ArrayView2<'_, X>,
        weight: ArrayView3<'_, T>,
        y: ArrayViewMut2<'_, X>,
        scratch: &mut GridBuffers<'_, T>,
    ) {
        let GridBuffers { spectrum, work, padded, .. } = scratch;
        let spectrum = &mut spectrum[..self.spectra(x.ncols())];
        let place = self.place_of_one(&x);
        self.rows_forward(place, x, spectrum, work, padded);
        self.columns.through::<_, true>(spectrum, self.product(weight, Factor::Weight), work);
        self.rows_inverse(place, spectrum, y, work, padded);
    }

    /// As [`Single::backward`], for lanes that go together.
    fn backward_single<X: Stored<Real = T>>(
        &self,
        pass: SingleBackward<'_, X>,
        scratch: &mut GridBuffers<'_, T>,
    ) {
        let SingleBackward { grad, x, weight, grad_x, grad_weight } = pass;
        let GridBuffers { spectrum, other, work, padded, .. } = scratch;
        let spectrum = &mut spectrum[..self.spectra(grad.ncols())];
        let other = &mut other[..spectrum.len()];
        let place = self.place_of_one(&grad);
        self.rows_forward(place, grad, spectrum, work, padded);
        if grad_weight.is_some() {
            self.rows_forward(place, x, other, work, padded);
        }
        let product = self.product(weight, Factor::Conjugate);
        match grad_weight {
            None => self.columns.through::<_, true>(spectrum, product, work),
            Some(gradient) => {
                self.columns.through::<_, false>(other, (), work);
                let gradient = NaturalGradient {
                    order: &self.order,
                    x: Tile::dense(other, self.lanes),
                    gradient: TileMut::of_complex(gradient),
                };
                if grad_x.is_some() {
                    self.columns.through::<_, true>(spectrum, (gradient, product), work);
                } else {
                    self.columns.look(spectrum, gradient, work);
                }
            }
        }
        if let Some(grad_x) = grad_x {
            self.rows_inverse(place, spectrum, grad_x, work, padded);
        }
    }

    fn product<'a>(&'a self, weight: ArrayView3<'a, T>, factor: Factor) -> NaturalProduct<'a, T> {
        NaturalProduct { order: &self.order, weight: Tile::of_complex(weight), factor }
    }
}

impl<X: Stored> Single<X> for Grid<X::Real> {
    fn forward(
        &self,
        x: ArrayView2<'_, X>,
        weight: ArrayView3<'_, X::Real>,
        mut y: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let mut scratch = self.scratch(team.scratch());
        if self.undivided::<X>(x.ncols()) {
            return self.forward_single(x, weight, y, &mut scratch);
        }
        if x.ncols() < self.lanes {
            let room = std::mem::take(&mut scratch.bins[0]);
            let weight = views::padded_bins(weight, self.lanes, room);
            return self.forward_single(x, weight, y, &mut scratch);
        }
        for lanes in self.parts(x.ncols(), self.alone::<X>()) {
            let (part, bins) = (s![.., lanes.clone()], s![.., lanes.clone(), ..]);
            let (x, weight, y) = (x.slice(part), weight.slice(bins), y.slice_mut(part));
            self.forward_single(x, weight, y, &mut scratch);
        }
    }

    fn backward(&self, pass: SingleBackward<'_, X>, team: &mut Team<'_, X::Real>) {
        let mut scratch = self.scratch(team.scratch());
        if self.undivided::<X>(pass.x.ncols()) {
            return self.backward_single(pass, &mut scratch);
        }
        let SingleBackward { grad, x, weight, mut grad_x, mut grad_weight } = pass;
        if x.ncols() < self.lanes {
            let [room, whole] = std::mem::take(&mut scratch.bins);
            let weight = views::padded_bins(weight, self.lanes, room);
            let mut whole = views::bins(whole, self.lanes);
            let of_whole = grad_weight.is_some().then(|| whole.view_mut());
            let pass = SingleBackward { grad, x, weight, grad_x, grad_weight: of_whole };
            self.backward_single(pass, &mut scratch);
            if let Some(grad_weight) = grad_weight {
                views::unpadded_bins(whole.view(), grad_weight);
            }
            return;
        }
        for lanes in self.parts(x.ncols(), self.alone::<X>()) {
            let (part, bins) = (s![.., lanes.clone()], s![.., lanes.clone(), ..]);
            let (grad, x, weight) = (grad.slice(part), x.slice(part), weight.slice(bins));
            let grad_x = grad_x.as_mut().map(|grad_x| grad_x.slice_mut(part));
            let grad_weight = grad_weight.as_mut().map(|gradient| gradient.slice_mut(bins));
            let pass = SingleBackward { grad, x, weight, grad_x, grad_weight };
            self.backward_single(pass, &mut scratch);
        }
    }
}
