//! A weight in natural order to kernel order, and a gradient back.
//!
//! Every place of kernel order is one bin of the half spectrum, or the conjugate of the mirrored bin, times a real number. In
//! columns that a real inverse transform makes Hermitian (DC and Nyquist) it is the mean of the two.

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::simd::{Algorithm, Complex, Element, Isa, Tile, TileMut, Vector};

/// Where the places of kernel order come from.
pub(crate) struct Packing<T> {
    /// Of the first column: the bin and its mirror.
    hermitian: Vec<(usize, usize)>,
    /// Of all others: the bin, and whether it is conjugated.
    plain: Vec<(usize, bool)>,
    weight: Scales<T>,
    gradient: Scales<T>,
}

/// What bins are multiplied by.
pub(crate) struct Scales<T> {
    pub(crate) hermitian: T,
    pub(crate) plain: T,
}

/// A frequency of the full spectrum `(rows, columns)` as a bin of the half spectrum `(rows, columns / 2 + 1)`.
#[derive(Clone, Copy)]
pub(crate) struct Bins {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

impl Bins {
    /// The bin of row frequency `u` and column frequency `v`, at most `columns / 2`, and its mirror in `u`.
    pub(crate) fn with_mirror(self, u: usize, v: usize) -> (usize, usize) {
        let half = self.columns / 2 + 1;
        (u * half + v, (self.rows - u) % self.rows * half + v)
    }

    /// The bin that holds the frequency or its conjugate, and which.
    pub(crate) fn of(self, u: usize, v: usize) -> (usize, bool) {
        if v <= self.columns / 2 {
            (self.with_mirror(u, v).0, false)
        } else {
            (self.with_mirror(u, self.columns - v).1, true)
        }
    }
}

impl<T: Element> Packing<T> {
    pub(crate) fn new(
        hermitian: Vec<(usize, usize)>,
        plain: Vec<(usize, bool)>,
        weight: Scales<T>,
        gradient: Scales<T>,
    ) -> Self {
        Self { hermitian, plain, weight, gradient }
    }

    /// Numbers in a packed weight of one vector of lanes.
    fn packed_len(&self, lanes: usize) -> usize {
        2 * lanes * (self.hermitian.len() + self.plain.len())
    }

    /// `weight` `(bins, lanes, 2)`, of whole vectors, to `packed`, one vector of lanes after the other.
    pub(crate) fn pack(&self, isa: Isa, weight: ArrayView3<'_, T>, packed: &mut [T]) {
        isa.run(Pack { packing: self, weight: Tile::of_complex(weight), packed });
    }

    /// `sum`, packed, to `gradient` `(bins, lanes, 2)`, of whole vectors.
    pub(crate) fn unpack(&self, isa: Isa, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        isa.run(Unpack { packing: self, sum, gradient: TileMut::of_complex(gradient) });
    }
}

/// Bins ahead of the work that are brought to the cache: they are far apart and in no order, so that no processor guesses them.
const AHEAD: usize = 16;

struct Pack<'a, T> {
    packing: &'a Packing<T>,
    weight: Tile<'a, T>,
    packed: &'a mut [T],
}

/// All lanes of a bin, then the next bin: whole runs of memory.
impl<T: Element> Algorithm<T> for Pack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Packing { hermitian, plain, weight: scales, .. } = self.packing;
        let len = self.packing.packed_len(V::LANES);
        let (mean, scale) = (V::splat(scales.hermitian), V::splat(scales.plain));
        for (place, &(bin, mirror)) in hermitian.iter().enumerate() {
            for (i, packed) in self.packed.chunks_exact_mut(len).enumerate() {
                let weight = self.weight.skip_lanes(2 * i * V::LANES);
                let (z, mirror) = (weight.complex::<V>(bin), weight.complex::<V>(mirror));
                let both = [(z.re + mirror.re) * mean, (z.im - mirror.im) * mean];
                TileMut::dense(packed, V::LANES).scatter(2 * place, 1, both);
            }
        }
        for (place, &(bin, conjugate)) in plain.iter().enumerate() {
            let (ahead, _) = plain[(place + AHEAD).min(plain.len() - 1)];
            let im_scale = if conjugate { -scale } else { scale };
            for (i, packed) in self.packed.chunks_exact_mut(len).enumerate() {
                let weight = self.weight.skip_lanes(2 * i * V::LANES);
                weight.prefetch(ahead, 1);
                let z = weight.complex::<V>(bin);
                let place = 2 * (hermitian.len() + place);
                TileMut::dense(packed, V::LANES).scatter(place, 1, [z.re * scale, z.im * im_scale]);
            }
        }
    }
}

struct Unpack<'a, T> {
    packing: &'a Packing<T>,
    sum: &'a [T],
    gradient: TileMut<'a, T>,
}

impl<T: Element> Algorithm<T> for Unpack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let Packing { hermitian, plain, gradient: scales, .. } = self.packing;
        let sums = self.sum.chunks_exact(self.packing.packed_len(V::LANES));
        let sum = |sum, place: usize, scale: T| {
            let [re, im] = Tile::dense(sum, V::LANES).gather::<V, 2>(2 * place, 1);
            Complex::new(re, im).scale(V::splat(scale))
        };
        for (place, &(bin, mirror)) in hermitian.iter().enumerate() {
            for (i, sums) in sums.clone().enumerate() {
                let z = sum(sums, place, scales.hermitian);
                let mut gradient = self.gradient.skip_lanes(2 * i * V::LANES);
                gradient.set_complex(mirror, z.conj());
                gradient.set_complex(bin, z);
            }
        }
        for (place, &(bin, conjugate)) in plain.iter().enumerate() {
            for (i, sums) in sums.clone().enumerate() {
                let z = sum(sums, hermitian.len() + place, scales.plain);
                let mut gradient = self.gradient.skip_lanes(2 * i * V::LANES);
                gradient.set_complex(bin, if conjugate { z.conj() } else { z });
            }
        }
    }
}
