//! The filter on sequences, which are grids of height one: lanes are channels, two vectors of them at a time.
//!
//! Real lines of two vectors are real and imaginary part of one complex line, which is half the work of two. The product takes
//! them apart and joins them again ([`super::columns`], where these are the columns of DC and Nyquist).

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, s};

use super::columns::Columns;
use crate::kernel::{Backward, Kernel, TakesHalf};
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Complex, Element, Isa, Stored, Tile, TileMut, Vector, aligned, complex_vectors,
    slack,
};

/// The plan for sequences of one length.
pub(crate) struct Sequence<T> {
    isa: Isa,
    columns: Columns<T>,
    /// Lanes of two vectors.
    pair: usize,
    length: usize,
}

/// Scratch of one call.
struct Scratch<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
}

impl<T: Element> Sequence<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        let columns = Columns::new(isa, length, 1, true);
        Self { isa, columns, pair: 2 * isa.lanes::<T>(), length }
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> Scratch<'a, T> {
        let (spectrum, rest) = aligned(scratch).split_at_mut(self.columns.len());
        let (other, rest) = rest.split_at_mut(self.columns.len());
        let (work, padded) = rest.split_at_mut(self.columns.work_len());
        Scratch { spectrum, other, work, padded: &mut padded[..self.length * self.pair] }
    }

    /// A sequence `(points, lanes)` to a line; `padded` holds it if it has too few lanes.
    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        line: &mut [T],
        padded: &mut [T],
    ) {
        let (lanes, inputs) = (image.ncols(), self.columns.transform().inputs());
        if lanes < self.pair {
            let mut whole = ArrayViewMut2::from_shape((self.length, self.pair), &mut *padded)
                .expect("room for a tile");
            whole.fill(T::default());
            whole.slice_mut(s![.., ..lanes]).zip_mut_with(&image, |wide, x| *wide = x.widened());
            self.isa.run(Enter { inputs, image: Tile::dense(padded, self.pair), line });
        } else {
            self.isa.run(Enter { inputs, image: Tile::new(image), line });
        }
    }

    /// A line to a sequence `(points, lanes)`, by way of `padded` if it has too few lanes.
    fn leave<X: Stored<Real = T>>(
        &self,
        line: &mut [T],
        mut image: ArrayViewMut2<'_, X>,
        padded: &mut [T],
    ) {
        let (lanes, inputs) = (image.ncols(), self.columns.transform().inputs());
        if lanes < self.pair {
            let whole = TileMut::dense(padded, self.pair);
            self.isa.run(Leave { inputs, image: whole, line });
            let whole =
                ArrayView2::from_shape((self.length, self.pair), padded).expect("room for a tile");
            image.zip_mut_with(&whole.slice(s![.., ..lanes]), |x, &wide| *x = X::nearest_to(wide));
        } else {
            self.isa.run(Leave { inputs, image: TileMut::new(image), line });
        }
    }

    /// What places are multiplied by: those of the weight, of its gradient between DC and Nyquist, and of these two.
    /// The product sees doubled spectra.
    fn scales(&self) -> [T; 3] {
        let norm = 1.0 / self.length as f64;
        [norm / 2.0, norm / 2.0, norm / 4.0].map(T::nearest)
    }
}

impl<X: Stored> Kernel<X> for Sequence<X::Real> {
    fn tile(&self) -> usize {
        self.pair
    }

    fn packed_len(&self, _: usize) -> usize {
        self.columns.packed_len()
    }

    fn scratch_len(&self) -> usize {
        let padded = self.length * self.pair;
        slack::<X::Real>() + 2 * self.columns.len() + self.columns.work_len() + padded
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, X::Real>,
        packed: &mut [X::Real],
        _: &mut Team<'_, X::Real>,
    ) {
        let [scale, ..] = self.scales();
        let length = self.length;
        if weight.len_of(Axis(1)) < self.pair {
            let weight = &padded_bins(weight, self.pair);
            let weight = Tile::of_complex(weight.view());
            self.isa.run(Pack { weight, packed, scale, length });
        } else {
            self.isa.run(Pack { weight: Tile::of_complex(weight), packed, scale, length });
        }
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        packed: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let Scratch { spectrum, work, padded, .. } = self.scratch(team.scratch());
        for (x, y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.enter(x, spectrum, padded);
            self.columns.filter::<false>(spectrum, packed, work);
            self.leave(spectrum, y, padded);
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, packed, mut grad_x, mut grad_sum } = pass;
        let Scratch { spectrum, other, work, padded } = self.scratch(team.scratch());
        for (image, grad) in grad.outer_iter().enumerate() {
            self.enter(grad, spectrum, padded);
            let weight = grad_x.is_some().then_some(packed);
            if let Some(sum) = grad_sum.as_deref_mut() {
                self.enter(x.index_axis(Axis(0), image), other, padded);
                self.columns.gradient(spectrum, other, weight, sum, work);
            } else if let Some(weight) = weight {
                self.columns.filter::<true>(spectrum, weight, work);
            }
            if let Some(grad_x) = &mut grad_x {
                self.leave(spectrum, grad_x.index_axis_mut(Axis(0), image), padded);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        _: &mut Team<'_, X::Real>,
    ) {
        let [_, inside, ends] = self.scales();
        let (bins, lanes, _) = grad_weight.dim();
        let length = self.length;
        if lanes < self.pair {
            let mut whole = Array3::from_elem((bins, self.pair, 2), X::Real::default());
            let gradient = TileMut::of_complex(whole.view_mut());
            self.isa.run(Unpack { sum: grad_sum, gradient, inside, ends, length });
            grad_weight.assign(&whole.slice(s![.., ..lanes, ..]));
        } else {
            let gradient = TileMut::of_complex(grad_weight);
            self.isa.run(Unpack { sum: grad_sum, gradient, inside, ends, length });
        }
    }

    fn takes_half(&self) -> Option<TakesHalf<'_, X::Real>> {
        Some(TakesHalf::Sequence(self))
    }
}

/// `weight` `(bins, lanes, 2)` with zeros up to `lanes` lanes.
fn padded_bins<T: Element>(weight: ArrayView3<'_, T>, lanes: usize) -> Array3<T> {
    let (bins, given, _) = weight.dim();
    let mut whole = Array3::from_elem((bins, lanes, 2), T::default());
    whole.slice_mut(s![.., ..given, ..]).assign(&weight);
    whole
}

struct Enter<'a, X: Stored> {
    inputs: &'a [usize],
    image: Tile<'a, X>,
    line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for Enter<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let line = complex_vectors::<V>(self.line);
        let second = self.image.skip_lanes(V::LANES);
        for (n, &input) in self.inputs.iter().enumerate() {
            self.image.prefetch(n + AHEAD, 1);
            let ([re], [im]) = (self.image.gather(n, 1), second.gather(n, 1));
            line[input] = Complex::new(re, im);
        }
    }
}

/// Points ahead of the work that are brought to the cache.
const AHEAD: usize = 16;

struct Leave<'a, X: Stored> {
    inputs: &'a [usize],
    image: TileMut<'a, X>,
    line: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for Leave<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let line = complex_vectors::<V>(self.line);
        for (n, &input) in self.inputs.iter().enumerate() {
            self.image.reader().prefetch(n + AHEAD, 1);
            self.image.scatter(n, 1, [line[input].re]);
            self.image.skip_lanes(V::LANES).scatter(n, 1, [line[input].im]);
        }
    }
}

/// Bins to places `a(0), b(0), a(1), b(1), ...` of the two vectors; DC and Nyquist are real.
struct Pack<'a, T> {
    weight: Tile<'a, T>,
    packed: &'a mut [T],
    scale: T,
    length: usize,
}

impl<T: Element> Algorithm<T> for Pack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let mut packed = TileMut::dense(self.packed, V::LANES);
        let scale = V::splat(self.scale);
        for bin in 0..=self.length / 2 {
            self.weight.prefetch(bin + AHEAD, 1);
            self.weight.skip_lanes(2 * V::LANES).prefetch(bin + AHEAD, 1);
            let end = 2 * bin % self.length == 0;
            for half in 0..2 {
                let z = self.weight.skip_lanes(2 * half * V::LANES).complex::<V>(bin).scale(scale);
                let im = if end { V::splat(T::default()) } else { z.im };
                packed.scatter(2 * (2 * bin + half), 1, [z.re, im]);
            }
        }
    }
}

/// Undoes the order of [`Pack`].
struct Unpack<'a, T> {
    sum: &'a [T],
    gradient: TileMut<'a, T>,
    inside: T,
    ends: T,
    length: usize,
}

impl<T: Element> Algorithm<T> for Unpack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let sum = Tile::dense(self.sum, V::LANES);
        for bin in 0..=self.length / 2 {
            let end = 2 * bin % self.length == 0;
            let scale = V::splat(if end { self.ends } else { self.inside });
            for half in 0..2 {
                let [re, im] = sum.gather::<V, 2>(2 * (2 * bin + half), 1);
                let z = Complex::new(re, im).scale(scale);
                self.gradient.skip_lanes(2 * half * V::LANES).set_complex(bin, z);
            }
        }
    }
}
